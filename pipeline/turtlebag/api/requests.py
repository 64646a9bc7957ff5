"""What `navigate` is asked in Python, as the stage and the command line take it."""

from __future__ import annotations

import math
import os
from collections.abc import Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, Literal

import numpy as np
import yaml

from turtlebag.api.making import (
    PathLike,
    Pose,
    TemporaryFolder,
    in_a_line,
    list_of,
    path_if,
    pose_of,
    require_seed,
    text_of,
)
from turtlebag.api.outputs import as_map
from turtlebag.api.tasks import Avoid, Explore, Goal, Patrol, Task
from turtlebag.datasets.errors import InputError
from turtlebag.datasets.parts import is_own
from turtlebag.datasets.se2 import SE2
from turtlebag.pipeline.navigation.setup import Request
from turtlebag.planners.tasks.waypoints import load_keepout, parse_polygons


@dataclass(frozen=True)
class Asked:
    """A run that is asked for: for the stage, and by the options of the command line.

    `settings` are those that the task stands for; `files` holds what was given as arrays.
    """

    world: str
    robot: str | None
    request: Request
    options: dict[str, Any]
    settings: list[str]
    files: TemporaryFolder


@dataclass(frozen=True)
class _Told:
    """What a task says: fields of the request, options, settings."""

    fields: dict[str, Any]
    options: dict[str, Any]
    settings: list[str] = field(default_factory=list)


def asked_for(
    map: PathLike | None,
    task: Task | str,
    *,
    world: PathLike | None,
    robot: PathLike | None,
    seed: int,
    start: Pose | None,
    initial_pose: Pose | Literal["start", "global"] | None,
    wiggle: bool,
    takeover: PathLike | None,
    keepout: PathLike | Sequence[Any] | None,
) -> Asked:
    """The run that the arguments of `turtlebag.navigate` ask for; InputError where they do not fit."""
    files, on = TemporaryFolder(), None if map is None else as_map(map)
    own = isinstance(task, str) and is_own(task)
    told = _Told({}, {}) if own else _of_task(task, files.path)
    name = str(task) if own else type(task).__name__.lower()
    if on is None and isinstance(task, Patrol):
        raise InputError("map: a patrol needs one; give the map to drive by")
    if isinstance(task, Avoid | Explore) and (on is not None or wiggle or keepout is not None):
        raise InputError(f"{name}: works without map, wiggle and keepout; leave them out")
    scene = world if world is not None or on is None else on.world
    if scene is None:
        raise InputError("world: name the world to drive in; this map does not tell where it was made")
    by = robot if robot is not None or on is None else on.robot
    areas = _keepout(keepout, files.path)
    start_pose = None if start is None else pose_of(start, "start")
    guess = None if on is None else told_pose(initial_pose, "start", "global")
    request = Request(
        task=name,
        seed=require_seed(seed),
        map_path=None if on is None else on.yaml,
        start=start_pose,
        initial_pose=guess,  # type: ignore[arg-type]
        wiggle=wiggle,
        takeover=path_if(takeover, "takeover"),
        keepout=None if areas is None else () if areas == "none" else load_keepout(Path(areas)),
        keepout_path=None if areas in (None, "none") else Path(areas),
        **told.fields,
    )
    options = {
        "world": text_of(scene, "world"),
        "robot": None if by is None else text_of(by, "robot"),
        "task": name,
        "map": request.map_path,
        "start": start_pose,
        "initial_pose": guess,
        "seed": seed,
        **told.options,
        "wiggle": wiggle,
        "takeover": takeover,
        "keepout": areas,
    }
    return Asked(options["world"], options["robot"], request, options, told.settings, files)


def told_pose(value: Pose | str | None, *words: str) -> SE2 | str | None:
    """What the robot is told of its place: a pose, one of the words, or nothing."""
    if value is None or (isinstance(value, str) and value in words):
        return value
    if isinstance(value, str):
        raise InputError(f"initial_pose: expected x, y, yaw or {' or '.join(words)}, not {value!r}")
    return pose_of(value, "initial_pose")


def _of_task(task: Task | str, folder: Path) -> _Told:
    if isinstance(task, Goal):
        goal, timeout = pose_of((task.x, task.y, task.yaw), "goal"), _seconds(task.timeout, "timeout")
        return _Told({"goal": goal, "timeout_s": timeout}, {"goal": goal, "timeout": timeout})
    if isinstance(task, Patrol):
        if task.laps is not None and (not isinstance(task.laps, int) or task.laps < 1):
            raise InputError(f"laps: expected a whole number, 1 or more, not {task.laps!r}")
        path, timeout = _waypoints(task.waypoints, folder), _seconds(task.timeout, "timeout")
        fields = {"waypoints_path": path, "laps": task.laps, "timeout_s": timeout}
        return _Told(fields, {"waypoints": path, "laps": task.laps, "timeout": timeout})
    if isinstance(task, Avoid):
        duration = _seconds(task.duration, "duration")
        settings = [] if task.mode is None else [f"avoid.mode={task.mode}"]
        return _Told({"duration_s": duration}, {"duration": duration, "mode": task.mode}, settings)
    if isinstance(task, Explore):
        duration = _seconds(task.duration, "duration")
        return _Told({"duration_s": duration}, {"duration": duration})
    raise InputError(
        f"task: expected Patrol(), Goal(x, y, yaw), Avoid(), Explore() or a class, not {in_a_line(task)}"
    )


def _seconds(value: float | None, what: str) -> float | None:
    if value is None:
        return None
    if not isinstance(value, int | float | np.number) or not (math.isfinite(value) and value > 0.0):
        raise InputError(f"{what}: expected a positive number of seconds, not {value!r}")
    return float(value)


def _waypoints(given: Any, folder: Path) -> Path | None:
    """The file of a patrol's waypoints, written where they are given as numbers."""
    if given is None or isinstance(given, str | os.PathLike):
        return path_if(given, "waypoints")
    poses = [_numbers(one, "waypoints") for one in list_of(given, "waypoints")]
    if not poses:
        raise InputError("waypoints: is empty; give one or more poses")
    return _written(poses, folder / "waypoints.yaml")


def _keepout(given: PathLike | Sequence[Any] | None, folder: Path) -> str | None:
    """The file of areas to keep out of, or the word none."""
    if given is None or isinstance(given, str | os.PathLike):
        return None if given is None else text_of(given, "keepout", "a path")
    areas = [list_of(outline, "keepout") for outline in list_of(given, "keepout")]
    outlines = [[_numbers(corner, "keepout") for corner in outline] for outline in areas]
    parse_polygons(outlines, "keepout")
    return os.fspath(_written({"keepout": outlines}, folder / "keepout.yaml")) if outlines else "none"


def _numbers(one: Any, what: str) -> Any:
    """What YAML can hold of a pose or a corner."""
    if isinstance(one, SE2):
        one = one.xyt
    try:
        return one if isinstance(one, dict) else np.asarray(one, dtype=np.float64).tolist()
    except (TypeError, ValueError):
        raise InputError(f"{what}: expected numbers, not {in_a_line(one)}") from None


def _written(content: Any, path: Path) -> Path:
    path.write_text(yaml.safe_dump(content, default_flow_style=None))
    return path
