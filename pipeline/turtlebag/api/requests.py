"""What `navigate` and `localise` are told in Python, as options of the command line."""

from __future__ import annotations

import math
import os
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np
import yaml

from turtlebag.api.making import PathLike, Pose, in_a_line, list_of, path_if, pose_of, text_of
from turtlebag.api.tasks import Avoid, Explore, Goal, Patrol, Task
from turtlebag.datasets.errors import InputError
from turtlebag.datasets.parts import is_own
from turtlebag.datasets.se2 import SE2
from turtlebag.planners.tasks.waypoints import parse_polygons


def told_pose(value: Pose | str | None, *words: str) -> SE2 | str | None:
    """What the robot is told of its place: a pose, one of the words, or nothing."""
    if value is None or (isinstance(value, str) and value in words):
        return value
    if isinstance(value, str):
        raise InputError(f"initial_pose: expected x, y, yaw or {' or '.join(words)}, not {value!r}")
    return pose_of(value, "initial_pose")


def task_options(task: Task | str, folder: Path) -> dict[str, Any]:
    """The task and its own options; what was given as arrays is written to files in the folder."""
    if isinstance(task, str) and is_own(task):
        return {"task": task}
    name = {"task": type(task).__name__.lower()}
    if isinstance(task, Goal):
        goal = pose_of((task.x, task.y, task.yaw), "goal")
        return name | {"goal": goal, "timeout": _seconds(task.timeout, "timeout")}
    if isinstance(task, Patrol):
        if task.laps is not None and (not isinstance(task.laps, int) or task.laps < 1):
            raise InputError(f"laps: expected a whole number, 1 or more, not {task.laps!r}")
        waypoints = _waypoints(task.waypoints, folder)
        return name | {
            "waypoints": waypoints,
            "laps": task.laps,
            "timeout": _seconds(task.timeout, "timeout"),
        }
    if isinstance(task, Avoid):
        return name | {"duration": _seconds(task.duration, "duration"), "mode": task.mode}
    if isinstance(task, Explore):
        return name | {"duration": _seconds(task.duration, "duration")}
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


def keepout_option(given: PathLike | Sequence[Any] | None, folder: Path) -> str | None:
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
