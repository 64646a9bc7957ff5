"""Requests for drives: recorded, or to do a task."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated, Literal, Self

from pydantic import Field, model_validator

from turtlebag.datasets.errors import InputError
from turtlebag.datasets.parts import is_own, part_of
from turtlebag.pipeline.stages.parser import count, positive
from turtlebag.pipeline.stages.requests.options import (
    POSE,
    RAD,
    XYT,
    ConfigFile,
    Count,
    MapFile,
    Name,
    Option,
    OrOwn,
    Overrides,
    Pose,
    Positive,
    Robot,
    Seed,
    Start,
    World,
    file,
    flag,
    flag_of,
    on_map,
    pose_or,
)
from turtlebag.pipeline.stages.requests.request import Request

TASKS = ("goal", "patrol", "avoid", "explore")


class RecordRequest(Request):
    """A drive through a simulated world, recorded."""

    VERB = "record"
    EXAMPLE = "turtlebag record --world turtlebot3_world --teleop tour --seed 1 --out data/records/world"

    world: World
    robot: Robot = None
    seed: Seed = 1
    start: Start = None
    teleop: Annotated[
        Name,
        Option("SCRIPT", "teleop script: a name, a YAML file, or a bag whose /cmd_vel is replayed", "tour"),
    ] = "tour"
    config: ConfigFile = None
    settings: Overrides = Field({})

    def files(self) -> list[Path]:
        """World, robot and settings if they are files, and the bag whose commands are replayed."""
        from turtlebag.sim.teleop_scripts import script_names

        bag = Path(self.teleop)
        replayed = self.teleop not in script_names() and bag.is_dir()
        return [*super().files(), *([bag] if replayed else [])]


class KeyboardRequest(Request):
    """A drive with the keyboard, recorded."""

    VERB = "teleop"
    EXAMPLE = "turtlebag teleop --world turtlebot3_world --out data/records/mine"

    world: World
    robot: Robot = None
    seed: Seed = 1
    start: Start = None
    style: Annotated[
        Literal["keys", "turtlebot3"],
        Option(
            "",
            "keys: W A S D; turtlebot3: the keys of turtlebot3_teleop",
            "keys",
            choices=("keys", "turtlebot3"),
        ),
    ] = "keys"
    speed: Annotated[Positive, Option("X", "speed relative to real time", "0.5", read=positive)] = 1.0
    config: ConfigFile = None
    settings: Overrides = Field({})


TAKEN_BY = {
    "map": ("goal", "patrol"),
    "initial_pose": ("goal", "patrol"),
    "wiggle": ("goal", "patrol"),
    "keepout": ("goal", "patrol"),
    "timeout": ("goal", "patrol"),
    "goal": ("goal",),
    "waypoints": ("patrol",),
    "laps": ("patrol",),
    "duration": ("avoid", "explore"),
    "mode": ("avoid",),
}
"""Fields of a run that some tasks only take; all others go with every task."""
ON_A_MAP = ("initial_pose", "wiggle", "keepout")
"""Those among them that a goal without a map cannot use."""


class NavigateRequest(Request):
    """A task, driven in closed loop."""

    VERB = "navigate"
    EXAMPLE = (
        "turtlebag navigate --world turtlebot3_world --map data/maps/map_world.yaml --task patrol "
        "--initial-pose start --seed 1 --out data/runs/patrol"
    )

    world: World
    robot: Robot = None
    seed: Seed = 1
    start: Start = None
    task: Annotated[
        str,
        part_of(*TASKS),
        Option("", "task to run, or your own class (module:Class)", "goal", choices=OrOwn(TASKS)),
    ]
    map: Annotated[MapFile | None, on_map("navigate")] = None
    initial_pose: Annotated[
        XYT | Literal["start", "global"] | None,
        pose_or("start", "global"),
        Option(
            f"{POSE}|start|global",
            "initial pose given to the robot: a pose, its true start, or global localisation",
            "start",
            RAD,
        ),
    ] = None
    goal: Annotated[Pose | None, Option(POSE, "goal of --task goal", "1.5,1.5,0", RAD)] = None
    waypoints: Annotated[
        Path | None,
        file("FILE", "YAML file with the patrol's waypoints (default: the tutorial's)", "points.yaml"),
    ] = None
    laps: Annotated[Count | None, Option("N", "laps of the patrol (default: 1)", "2", read=count)] = None
    timeout: Annotated[
        Positive | None,
        Option(
            "S",
            "simulated time for each goal (default: 60 in a patrol, 600 for --task goal)",
            "90",
            "s",
            read=positive,
        ),
    ] = None
    duration: Annotated[
        Positive | None,
        Option(
            "S",
            "simulated time: the length of avoid (default: 60), or the limit for explore (default: 1800)",
            "30",
            "s",
            read=positive,
        ),
    ] = None
    mode: Annotated[
        Literal["guarded", "tutorial"] | None,
        Option(
            "",
            "for --task avoid: guarded (default) uses the robot's shape; tutorial is the tutorial's rule",
            "tutorial",
            choices=("guarded", "tutorial"),
        ),
    ] = None
    wiggle: Annotated[bool, flag("first turn back and forth until the particles converge")] = False
    teleop_override: Annotated[
        Path | Literal["keyboard"] | None,
        Option(
            "keyboard|FILE",
            "override cmd_vel by keyboard, or by a YAML list of intervals with begin, end, v and w",
            "keyboard",
        ),
    ] = None
    keepout: Annotated[
        Path | Literal["none"] | None,
        Option(
            "FILE|none",
            "YAML file with keep-out polygons, or a map yaml as a mask (default: the world's own)",
            "none",
        ),
    ] = None
    config: ConfigFile = None
    settings: Overrides = Field({})

    @model_validator(mode="after")
    def _only_what_the_task_uses(self) -> Self:
        """InputError for the first field that the task does not use; a user's own task may use any."""
        for name, tasks in {} if is_own(self.task) else TAKEN_BY.items():
            if getattr(self, name) in (None, False):
                continue
            if self.task not in tasks:
                told = f"not for --task {self.task}, only for {' and '.join(tasks)}; remove it"
                raise InputError(f"{flag_of(name)}: {told}")
            if self.task == "goal" and self.map is None and name in ON_A_MAP:
                raise InputError(f"{flag_of(name)}: needs a map; give --map or remove it")
        return self
