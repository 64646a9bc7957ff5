"""Goal checker: position and heading within tolerance, standing still, for a while."""

from __future__ import annotations

import math
from typing import Literal

from pydantic import Field

from turtlebag.datasets.durations import Seconds, nanoseconds
from turtlebag.datasets.se2 import SE2, wrapped
from turtlebag.datasets.settings import Settings
from turtlebag.datasets.types import Twist

Preset = Literal["default", "tutorial"]
TOLERANCES: dict[str, tuple[float, float]] = {"default": (0.03, 0.05), "tutorial": (0.05, 0.17)}


HYSTERESIS = 1.2
"""Once inside, the tolerances are this much wider until the goal counts as reached (not measured)."""
STOPPED_V, STOPPED_W = 0.01, 0.06
"""Below these speeds the robot stands still [m/s, rad/s]."""


class GoalCheckerConfig(Settings, allow_inf_nan=False):
    """Tolerances by preset: `default` 0.03 m and 0.05 rad, `tutorial` 0.05 m and 0.17 rad."""

    preset: Preset = "default"
    """`default`: 0.03 m and 0.05 rad; `tutorial`: 0.05 m and 0.17 rad."""
    xy_goal_tolerance: float | None = Field(default=None, gt=0.0)
    """Distance from the goal [m]; None: by the preset."""
    yaw_goal_tolerance: float | None = Field(default=None, gt=0.0)
    """Angle off the goal's heading [rad]; None: by the preset."""
    hold: Seconds = 0.3
    """Seconds for which the pose must hold."""
    stop: bool = True
    """Whether the robot must stand still there; otherwise passing by is enough."""

    def tolerances(self) -> tuple[float, float]:
        """Position [m] and heading [rad]."""
        xy, yaw = TOLERANCES[self.preset]
        return self.xy_goal_tolerance or xy, self.yaw_goal_tolerance or yaw


PASSING = GoalCheckerConfig(xy_goal_tolerance=0.2, yaw_goal_tolerance=math.pi, stop=False, hold=0.0)
"""Viewpoints are passed, in any heading."""


class GoalChecker:
    """Watches one goal."""

    def __init__(self, config: GoalCheckerConfig, T_map_goal: SE2) -> None:
        self.config = config
        self.goal = T_map_goal
        self._since_ns: int | None = None

    def reached(self, now_ns: int, T_map_base: SE2, twist: Twist) -> bool:
        """Whether the goal has been held long enough, by the estimated pose and measured speed."""
        xy, yaw = self.config.tolerances()
        slack = 1.0 if self._since_ns is None else HYSTERESIS
        near = math.dist(T_map_base.xy, self.goal.xy) <= xy * slack
        turned = abs(wrapped(float(T_map_base.yaw - self.goal.yaw))) <= yaw * slack
        still = abs(twist.v) <= STOPPED_V and abs(twist.w) <= STOPPED_W
        if not (near and turned and (still or not self.config.stop)):
            self._since_ns = None
            return False
        if self._since_ns is None:
            self._since_ns = now_ns
        return now_ns - self._since_ns >= nanoseconds(self.config.hold)
