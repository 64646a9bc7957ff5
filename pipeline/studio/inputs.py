"""Everything that a person can ask of a session: one model for each input, `do` says which it is."""

from __future__ import annotations

from typing import Annotated, Any, Literal, get_args

from pydantic import Field, TypeAdapter, ValidationError

from turtlebag.datasets.errors import InputError
from turtlebag.datasets.settings import Settings

Name = Annotated[str, Field(pattern=r"^[A-Za-z0-9][A-Za-z0-9_-]{0,63}$")]
Coordinate = Annotated[float, Field(strict=True, ge=-1e4, le=1e4, allow_inf_nan=False)]
Speed = Annotated[float, Field(strict=True, ge=-100.0, le=100.0, allow_inf_nan=False)]
Point = tuple[Coordinate, Coordinate]
Pose = tuple[Coordinate, Coordinate, Coordinate]
"""x, y [m] and yaw [rad] in the map frame."""
Outline = Annotated[list[Point], Field(min_length=3, max_length=200)]
MOST_WAYPOINTS = 500


class Drive(Settings):
    """Someone asks for a speed [m/s, rad/s], until another is asked for."""

    do: Literal["drive"] = "drive"
    v: Speed = 0.0
    w: Speed = 0.0


class Stop(Settings):
    """Someone asks to stand still."""

    do: Literal["stop"] = "stop"


class Release(Settings):
    """Nobody drives by hand any more: the task goes on."""

    do: Literal["release"] = "release"


class Record(Settings):
    """Begin a bag, `bags/NAME`."""

    do: Literal["record"] = "record"
    name: Name


class RecordStop(Settings):
    """Finish the bag."""

    do: Literal["record_stop"] = "record_stop"


class MapStart(Settings):
    """Begin a new map."""

    do: Literal["map_start"] = "map_start"


class MapStop(Settings):
    """Add nothing more to the map."""

    do: Literal["map_stop"] = "map_stop"


class MapSave(Settings):
    """Write `maps/NAME.pgm` and `.yaml` of the map made here, or of the one that is loaded."""

    do: Literal["map_save"] = "map_save"
    name: Name


class MapLoad(Settings):
    """Go by a map that was saved here; without a name, by the one that the session was started with."""

    do: Literal["map_load"] = "map_load"
    name: Name | Literal[""] = ""


class PoseEstimate(Settings):
    """Tell the robot where it is."""

    do: Literal["pose_estimate"] = "pose_estimate"
    pose: Pose


class LocaliseGlobal(Settings):
    """Let the robot find out where it is."""

    do: Literal["localise_global"] = "localise_global"


class SetGoal(Settings):
    """Go there."""

    do: Literal["goal"] = "goal"
    pose: Pose


class Stopover(Settings):
    """A place of a patrol, and how long to stay there [s]; without `wait`, as long as patrols do."""

    pose: Pose
    wait: Annotated[float, Field(strict=True, ge=0.0, le=3600.0, allow_inf_nan=False)] | None = None


Stopovers = Annotated[list[Stopover], Field(min_length=1, max_length=MOST_WAYPOINTS)]


class Patrol(Settings):
    """Go to one place after the other."""

    do: Literal["patrol"] = "patrol"
    waypoints: Stopovers
    laps: Annotated[int, Field(strict=True, ge=1, le=1000)] = 1


class WaypointsSave(Settings):
    """Write `waypoints/NAME.yaml`."""

    do: Literal["waypoints_save"] = "waypoints_save"
    name: Name
    waypoints: Stopovers


class WaypointsLoad(Settings):
    """Show the waypoints that were saved under a name; without one, the tutorial's."""

    do: Literal["waypoints_load"] = "waypoints_load"
    name: Name | Literal[""] = ""


class Avoid(Settings):
    """Drive about and touch nothing, until something else is asked for."""

    do: Literal["avoid"] = "avoid"


class Explore(Settings):
    """Map what there is to see."""

    do: Literal["explore"] = "explore"


class TurnToAndFro(Settings):
    """Turn to and fro until the particles have drawn together."""

    do: Literal["wiggle"] = "wiggle"


class Cancel(Settings):
    """End the task."""

    do: Literal["cancel"] = "cancel"


class Kidnap(Settings):
    """Carry the robot to a true pose; its wheels notice nothing."""

    do: Literal["kidnap"] = "kidnap"
    pose: Pose


class DropBox(Settings):
    """Put a box, square and unturned, on the floor of the true world: its middle and its side [m]."""

    do: Literal["box"] = "box"
    xy: Point
    size: Annotated[float, Field(strict=True, ge=0.05, le=2.0, allow_inf_nan=False)] = 0.3


class Keepout(Settings):
    """Places to keep out of, in place of those there were."""

    do: Literal["keepout"] = "keepout"
    outlines: Annotated[list[Outline], Field(max_length=100)]


class Seek(Settings):
    """Go on with the bag from this time after its start [s]."""

    do: Literal["seek"] = "seek"
    t: Annotated[float, Field(strict=True, ge=0.0, le=1e7, allow_inf_nan=False)]


class MapBuild(Settings):
    """Map the whole bag, as `turtlebag map` does, and show its loops."""

    do: Literal["map_build"] = "map_build"


ScanNumber = Annotated[int, Field(strict=True, ge=0, le=10**8)]


class LoopShow(Settings):
    """Lay the two scans of a loop on each other."""

    do: Literal["loop_show"] = "loop_show"
    scan: ScanNumber
    place: ScanNumber


class LoopReject(Settings):
    """These scans did not see the same place."""

    do: Literal["loop_reject"] = "loop_reject"
    scan: ScanNumber
    place: ScanNumber


class LoopAdd(Settings):
    """These scans did: `scan` lies at `pose`, roughly, seen from `place`."""

    do: Literal["loop_add"] = "loop_add"
    scan: ScanNumber
    place: ScanNumber
    pose: Pose


class EditsClear(Settings):
    """Forget the loop edits."""

    do: Literal["edits_clear"] = "edits_clear"


class Reset(Settings):
    """Begin anew, with what was saved."""

    do: Literal["reset"] = "reset"


class End(Settings):
    """End the session."""

    do: Literal["end"] = "end"


Driving = Drive | Stop | Release
"""What holds for a while: `session.yaml` has it as intervals."""
Action = (
    Record
    | RecordStop
    | MapStart
    | MapStop
    | MapSave
    | MapLoad
    | PoseEstimate
    | LocaliseGlobal
    | SetGoal
    | Patrol
    | WaypointsSave
    | WaypointsLoad
    | Avoid
    | Explore
    | TurnToAndFro
    | Cancel
    | Kidnap
    | DropBox
    | Keepout
    | Seek
    | MapBuild
    | LoopShow
    | LoopReject
    | LoopAdd
    | EditsClear
    | Reset
    | End
)
"""What happens at once: `session.yaml` has it with its time."""
Input = Driving | Action

_INPUTS: TypeAdapter[Input] = TypeAdapter(Annotated[Input, Field(discriminator="do")])
KNOWN = tuple(model.model_fields["do"].default for model in get_args(Input))
"""What `do` may say."""


def parse_input(data: Any, where: str = "input") -> Input:
    """An input from plain values (a mapping with `do`); InputError in one line for anything else."""
    do = data.get("do") if isinstance(data, dict) else None
    if not isinstance(do, str) or do not in KNOWN:
        said = f"'{do}'" if isinstance(do, str) and do.isidentifier() and len(do) < 64 else "that"
        raise InputError(f"{where}: {said} is no input; `do` is one of {', '.join(KNOWN)}")
    try:
        return _INPUTS.validate_python(data)
    except ValidationError as error:
        first = error.errors(include_input=False, include_url=False)[0]
        # The first part of the place is `do` itself.
        place = ".".join(str(part)[:64] for part in first["loc"][1:])
        said = "unknown key" if first["type"] == "extra_forbidden" else first["msg"]
        raise InputError(" ".join(f"{where}: {do}: {place}: {said}".split())) from None
