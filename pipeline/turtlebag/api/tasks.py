"""What a run is to do: the tasks of `navigate`."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any, Literal

import numpy as np

from turtlebag.api.making import PathLike


@dataclass(frozen=True)
class Goal:
    """Drive to x, y [m] and turn to yaw [rad], in the map's frame; without a map in that of the odometry."""

    x: float
    y: float
    yaw: float = 0.0
    timeout: float | None = None
    """Simulated seconds; None: 600."""


@dataclass(frozen=True, eq=False)
class Patrol:
    """Drive to one waypoint after another, `laps` times (None: once).

    `waypoints` is a YAML file, poses (x, y) or (x, y, yaw), an array (n, 2) or (n, 3), or None for the
    tutorial's eight. `timeout` is for each of them [simulated s]; None: 60.
    """

    waypoints: PathLike | Sequence[Any] | np.ndarray | None = None
    laps: int | None = None
    timeout: float | None = None


@dataclass(frozen=True)
class Avoid:
    """Drive about without a map for `duration` simulated seconds (None: 60).

    `mode` is "guarded" (None too), which keeps the robot's shape clear, or "tutorial", the tutorial's rule.
    """

    duration: float | None = None
    mode: Literal["guarded", "tutorial"] | None = None


@dataclass(frozen=True)
class Explore:
    """Map an unknown place until there is nothing left to see, or for `duration` simulated s (None: 1800)."""

    duration: float | None = None


Task = Goal | Patrol | Avoid | Explore
