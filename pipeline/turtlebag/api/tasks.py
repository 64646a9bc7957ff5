"""The tasks of `navigate`, with their options."""

from __future__ import annotations

import os
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Literal

import numpy as np
import yaml

from turtlebag.api import given
from turtlebag.api.given import PathLike
from turtlebag.datasets.errors import InputError
from turtlebag.datasets.parts import is_own
from turtlebag.datasets.se2 import SE2
from turtlebag.planners.tasks.waypoints import parse_polygons


@dataclass(frozen=True)
class Goal:
    """Drive to x, y [m] and turn to yaw [rad], in the map's frame; without a map, in the odometry's."""

    x: float
    y: float
    yaw: float = 0.0
    timeout: float | None = None
    """Simulated seconds; None: 600."""

    def _options(self, folder: Path) -> dict[str, Any]:
        goal = given.pose((self.x, self.y, self.yaw), "goal")
        return {"task": "goal", "goal": goal, "timeout": _seconds(self.timeout, "timeout")}


@dataclass(frozen=True, eq=False)
class Patrol:
    """Drive to one waypoint after another, `laps` times (None: once).

    `waypoints` is a YAML file, poses (x, y) or (x, y, yaw), an array (n, 2) or (n, 3), or None for the
    tutorial's eight. `timeout` is for each of them [simulated s]; None: 60.
    """

    waypoints: PathLike | Sequence[Any] | np.ndarray | None = None
    laps: int | None = None
    timeout: float | None = None

    def _options(self, folder: Path) -> dict[str, Any]:
        if self.laps is not None and (not isinstance(self.laps, int) or self.laps < 1):
            raise InputError(f"laps: expected a whole number, 1 or more, not {self.laps!r}")
        waypoints, timeout = self.waypoints, _seconds(self.timeout, "timeout")
        if isinstance(waypoints, str | os.PathLike):
            waypoints = given.path(waypoints, "waypoints")
        elif waypoints is not None:
            poses = [_numbers(one, "waypoints") for one in given.items(waypoints, "waypoints")]
            if not poses:
                raise InputError("waypoints: is empty; give one or more poses")
            waypoints = _written(poses, folder / "waypoints.yaml")
        return {"task": "patrol", "waypoints": waypoints, "laps": self.laps, "timeout": timeout}


@dataclass(frozen=True)
class Avoid:
    """Drive around without a map for `duration` simulated seconds (None: 60). `mode` is "guarded" (also
    None), which uses the robot's shape, or "tutorial", the tutorial's rule."""

    duration: float | None = None
    mode: Literal["guarded", "tutorial"] | None = None

    def _options(self, folder: Path) -> dict[str, Any]:
        return {"task": "avoid", "duration": _seconds(self.duration, "duration"), "mode": self.mode}


@dataclass(frozen=True)
class Explore:
    """Map an unknown place until nothing is left to see, or for `duration` simulated seconds (None: 1800)."""

    duration: float | None = None

    def _options(self, folder: Path) -> dict[str, Any]:
        return {"task": "explore", "duration": _seconds(self.duration, "duration")}


Task = Goal | Patrol | Avoid | Explore


def task_options(task: Task | str, folder: Path) -> dict[str, Any]:
    """The task and its own options; what was given as arrays is written to files in the folder."""
    if isinstance(task, Task):
        return task._options(folder)
    if isinstance(task, str) and is_own(task):
        return {"task": task}
    shown = given.in_a_line(task)
    raise InputError(f"task: expected Patrol(), Goal(x, y, yaw), Avoid(), Explore() or a class, not {shown}")


def keepout_option(areas: PathLike | Sequence[Any] | None, folder: Path) -> str | None:
    """The file of keep-out areas, or the word none."""
    if areas is None or isinstance(areas, str | os.PathLike):
        return None if areas is None else given.text(areas, "keepout", "a path")
    listed = [given.items(outline, "keepout") for outline in given.items(areas, "keepout")]
    outlines = [[_numbers(corner, "keepout") for corner in outline] for outline in listed]
    parse_polygons(outlines, "keepout")
    return os.fspath(_written({"keepout": outlines}, folder / "keepout.yaml")) if outlines else "none"


def _seconds(value: float | None, what: str) -> float | None:
    return None if value is None else given.number(value, what, "a positive number of seconds", 0.0)


def _numbers(one: Any, what: str) -> Any:
    """What YAML can hold of a pose or a corner."""
    if isinstance(one, SE2):
        one = one.xyt
    try:
        return one if isinstance(one, dict) else np.asarray(one, dtype=np.float64).tolist()
    except (TypeError, ValueError, OverflowError):
        raise InputError(f"{what}: expected numbers, not {given.in_a_line(one)}") from None


def _written(content: Any, path: Path) -> Path:
    path.write_text(yaml.safe_dump(content, default_flow_style=None))
    return path
