"""The messages of a page, by their `do`; inputs with the same fields share a model.

Inputs go to the session and can be replayed from `session.yaml`; controls go to the server: pace of time,
what to send, who drives.
"""

from __future__ import annotations

import json
from typing import Annotated, Any, Literal, get_args

from pydantic import AfterValidator, Field, TypeAdapter, ValidationError, model_validator

from turtlebag.datasets.errors import InputError
from turtlebag.datasets.settings import Settings
from turtlebag.datasets.yaml_files import plain_message

MESSAGE_BYTES = 64 * 1024
Name = Annotated[str, Field(pattern=r"^[A-Za-z0-9][A-Za-z0-9_-]{0,63}$")]
Coordinate = Annotated[float, Field(strict=True, ge=-1e4, le=1e4, allow_inf_nan=False)]
Velocity = Annotated[float, Field(strict=True, ge=-100.0, le=100.0, allow_inf_nan=False)]
Point = tuple[Coordinate, Coordinate]
Pose = tuple[Coordinate, Coordinate, Coordinate]
"""x, y [m] and yaw [rad] in the map frame."""
Outline = Annotated[list[Point], Field(min_length=3, max_length=200)]
ScanNumber = Annotated[int, Field(strict=True, ge=0, le=10**8)]
MOST_WAYPOINTS = 500
LONGEST_BAG_S = 1e7
DRIVING = ("drive", "stop", "release")
"""Inputs that hold until the next one: intervals in `session.yaml`; all others have a time."""


class Drive(Settings):
    """Teleop at this speed [m/s, rad/s]; `stop`: at zero speed; `release`: end of teleop."""

    do: Literal["drive"] = "drive"
    v: Velocity = 0.0
    w: Velocity = 0.0


class Plain(Settings):
    """An input without other fields.

    `map_build` maps the whole bag as `turtlebag map` does, `edits_clear` drops all edits, `wall_undo` that of
    the last wall, `wiggle` turns back and forth until the particles converge, `reset` restarts the session
    and keeps what was saved.
    """

    do: Literal[
        "stop", "release", "record_stop", "map_start", "map_stop", "localise_global", "avoid", "explore",
        "wiggle", "cancel", "map_build", "wall_undo", "edits_clear", "reset", "end",
    ]  # fmt: skip


class Save(Settings):
    """A bag or a map under a name: `bags/NAME`, `maps/NAME.pgm` and `.yaml`."""

    do: Literal["record", "map_save"]
    name: Name


class Load(Settings):
    """Something saved under a name; without a name, the initial map or the tutorial's waypoints."""

    do: Literal["map_load", "waypoints_load"]
    name: Name | Literal[""] = ""


class At(Settings):
    """A pose estimate, a goal, or the true pose to which the robot is kidnapped, unnoticed by its wheels."""

    do: Literal["pose_estimate", "goal", "kidnap"]
    pose: Pose


class Stopover(Settings):
    """A waypoint of a patrol, and the time to stay there [s]; None: the patrol's default."""

    pose: Pose
    wait: Annotated[float, Field(strict=True, ge=0.0, le=3600.0, allow_inf_nan=False)] | None = None


Stopovers = Annotated[list[Stopover], Field(min_length=1, max_length=MOST_WAYPOINTS)]


class Waypoints(Settings):
    """The waypoints being edited, replacing earlier ones: every page shows them."""

    do: Literal["waypoints"]
    waypoints: Annotated[list[Stopover], Field(max_length=MOST_WAYPOINTS)]


class Patrol(Settings):
    """A patrol of waypoints."""

    do: Literal["patrol"]
    waypoints: Stopovers
    laps: Annotated[int, Field(strict=True, ge=1, le=1000)] = 1


class WaypointsSave(Settings):
    """Write `waypoints/NAME.yaml`."""

    do: Literal["waypoints_save"]
    name: Name
    waypoints: Stopovers


class DropBox(Settings):
    """Drop an axis-aligned square box into the true world: its centre and side [m]."""

    do: Literal["box"]
    xy: Point
    size: Annotated[float, Field(strict=True, ge=0.05, le=2.0, allow_inf_nan=False)] = 0.3


class Keepout(Settings):
    """Keep-out areas, replacing earlier ones."""

    do: Literal["keepout"]
    outlines: Annotated[list[Outline], Field(max_length=100)]


class Seek(Settings):
    """Continue the bag from this time after its start [s]."""

    do: Literal["seek"] = "seek"
    t: Annotated[float, Field(strict=True, ge=0.0, le=LONGEST_BAG_S, allow_inf_nan=False)]


class _Pair(Settings):
    """Two different scans."""

    scan: ScanNumber
    place: ScanNumber

    @model_validator(mode="after")
    def _of_two(self) -> _Pair:
        if self.scan == self.place:
            raise ValueError("scan and place are the same scan")
        return self


class Scans(_Pair):
    """Two scans of a loop, to be overlaid, or rejected as different places."""

    do: Literal["loop_show", "loop_reject"]


class LoopAdd(_Pair):
    """Two scans of the same place: `scan` is roughly at `pose` relative to `place`."""

    do: Literal["loop_add"]
    pose: Pose


class Wall(Settings):
    """A stroke on the map of the whole bag: its corners and its width [m]."""

    do: Literal["wall_draw", "wall_erase"]
    points: Annotated[list[Point], Field(min_length=1, max_length=200)]
    width: Annotated[float, Field(strict=True, ge=0.0, le=100.0)] = 0.0


Input = (
    Drive | Plain | Save | Load | At | Patrol | Waypoints | WaypointsSave | DropBox | Keepout | Seek | Scans
    | LoopAdd | Wall
)  # fmt: skip


def _zero_or_more_than_a_tenth(factor: float) -> float:
    if 0.0 < factor < 0.1:
        raise ValueError("must be 0 or from 0.1 to 100")
    return factor


class Button(Settings):
    """Pause or resume the simulation, run one tick while paused, or take control."""

    do: Literal["pause", "resume", "step", "take_control"]


class Speed(Settings):
    """Simulated seconds per second; 0: as fast as possible."""

    do: Literal["speed"]
    factor: Annotated[
        float, Field(ge=0.0, le=100.0, allow_inf_nan=False), AfterValidator(_zero_or_more_than_a_tenth)
    ]


class Layers(Settings):
    """The layers to send to this client. The page has other layers of its own: unknown names are ignored."""

    do: Literal["layers"]
    layers: Annotated[list[Annotated[str, Field(max_length=64)]], Field(max_length=64)]


Control = Button | Speed | Layers

_INPUTS: TypeAdapter[Input] = TypeAdapter(Annotated[Input, Field(discriminator="do")])
_CONTROLS: TypeAdapter[Control] = TypeAdapter(Annotated[Control, Field(discriminator="do")])


def _names(models: Any) -> tuple[str, ...]:
    return tuple(do for model in get_args(models) for do in get_args(model.model_fields["do"].annotation))


KNOWN = _names(Input)
"""The known values of `do`."""
CONTROLS = _names(Control)


class Malformed(Exception):
    """An invalid message."""


def parse_message(message: str | bytes) -> Control | Input:
    """What a client's message asks for.

    Malformed for what no page of ours sends; InputError, in one line, for values that cannot be.
    """
    if not isinstance(message, str):
        raise Malformed("messages must be text")
    if len(message.encode()) > MESSAGE_BYTES:
        raise Malformed(f"messages are limited to {MESSAGE_BYTES // 1024} KiB")
    try:
        data: Any = json.loads(message)
    except (ValueError, RecursionError):
        raise Malformed("a message must be a JSON object") from None
    do = data.get("do") if isinstance(data, dict) else None
    if not isinstance(do, str) or do not in (*CONTROLS, *KNOWN):
        raise Malformed("a message needs a known `do`")
    if do in KNOWN:
        return parse_input(data, where="page")
    try:
        return _CONTROLS.validate_python(data)
    except ValidationError as error:
        raise InputError(f"{do}: {plain_message(error.errors(include_input=False)[0])}") from None


def parse_input(data: Any, where: str = "input") -> Input:
    """An input from plain values (a mapping with `do`); InputError in one line for anything else."""
    do = data.get("do") if isinstance(data, dict) else None
    if not isinstance(do, str) or do not in KNOWN:
        said = f"'{do}'" if isinstance(do, str) and do.isidentifier() and len(do) < 64 else "that"
        raise InputError(f"{where}: {said} is not an input; `do` must be one of {', '.join(KNOWN)}")
    try:
        return _INPUTS.validate_python(data)
    except ValidationError as error:
        first = error.errors(include_input=False, include_url=False)[0]
        # The first part of the place is `do` itself.
        place = ".".join(str(part)[:64] for part in first["loc"][1:])
        said = "unknown key" if first["type"] == "extra_forbidden" else plain_message(first)
        raise InputError(" ".join(": ".join(filter(None, (where, do, place, said))).split())) from None
