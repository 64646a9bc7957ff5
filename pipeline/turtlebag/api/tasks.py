"""The tasks of `navigate`, with their options."""

from __future__ import annotations

import os
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Literal

import numpy as np
import yaml

from turtlebag.api.given import PathLike
from turtlebag.datasets.errors import InputError
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

    def _fields(self, folder: Path) -> dict[str, Any]:
        return {"task": "goal", "goal": (self.x, self.y, self.yaw), "timeout": self.timeout}


@dataclass(frozen=True, eq=False)
class Patrol:
    """Drive to one waypoint after another, `laps` times (None: once).

    `waypoints` is a YAML file, poses (x, y) or (x, y, yaw), an array (n, 2) or (n, 3), or None for the
    tutorial's eight. `timeout` is for each of them [simulated s]; None: 60.
    """

    waypoints: PathLike | Sequence[Any] | np.ndarray | None = None
    laps: int | None = None
    timeout: float | None = None

    def _fields(self, folder: Path) -> dict[str, Any]:
        waypoints = self.waypoints
        if waypoints is not None and not isinstance(waypoints, str | os.PathLike):
            poses = [_numbers(one) for one in waypoints]
            if not poses:
                raise InputError("waypoints: is empty; give one or more poses")
            waypoints = _written(poses, folder / "waypoints.yaml")
        return {"task": "patrol", "waypoints": waypoints, "laps": self.laps, "timeout": self.timeout}


@dataclass(frozen=True)
class Avoid:
    """Drive around without a map for `duration` simulated seconds (None: 60). `mode` is "guarded" (also
    None), which uses the robot's shape, or "tutorial", the tutorial's rule."""

    duration: float | None = None
    mode: Literal["guarded", "tutorial"] | None = None

    def _fields(self, folder: Path) -> dict[str, Any]:
        return {"task": "avoid", "duration": self.duration, "mode": self.mode}


@dataclass(frozen=True)
class Explore:
    """Map an unknown place until nothing is left to see, or for `duration` simulated seconds (None: 1800)."""

    duration: float | None = None

    def _fields(self, folder: Path) -> dict[str, Any]:
        return {"task": "explore", "duration": self.duration}


Task = Goal | Patrol | Avoid | Explore


def task_fields(task: Task | type, folder: Path) -> dict[str, Any]:
    """The task and its own fields of a request; what was given as arrays is written to files in the
    folder."""
    return task._fields(folder) if isinstance(task, Task) else {"task": task}


def keepout_field(areas: PathLike | Sequence[Any] | None, folder: Path) -> Path | str | None:
    """The file of keep-out areas, or the word none."""
    if areas is None or isinstance(areas, str | os.PathLike):
        return None if areas is None else Path(areas)
    outlines = [[_numbers(corner) for corner in outline] for outline in areas]
    parse_polygons(outlines, "keepout")
    return _written({"keepout": outlines}, folder / "keepout.yaml") if outlines else "none"


def _numbers(one: Any) -> Any:
    """What YAML can hold of a pose or a corner."""
    given = one.xyt if isinstance(one, SE2) else one
    return given if isinstance(given, dict) else np.asarray(given, dtype=np.float64).tolist()


def _written(content: Any, path: Path) -> Path:
    path.write_text(yaml.safe_dump(content, default_flow_style=None))
    return path
