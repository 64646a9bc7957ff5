"""Lesson 1 solved: wheel odometry by the mid-point rule."""

from __future__ import annotations

import numpy as np

from turtlebag.datasets.se2 import Array


class WheelOdometry:
    """Adds up what the wheels roll."""

    def __init__(self, radius: float, track: float, start: Array) -> None:
        self.radius, self.track = radius, track
        self.x, self.y, self.yaw = start
        self.last: Array | None = None

    def update(self, left: float, right: float) -> Array:
        """The pose (3,)."""
        angles = np.array([left, right])
        rolled_left, rolled_right = self.radius * (angles - (angles if self.last is None else self.last))
        self.last = angles
        ahead, turn = (rolled_left + rolled_right) / 2, (rolled_right - rolled_left) / self.track
        self.x += ahead * np.cos(self.yaw + turn / 2)
        self.y += ahead * np.sin(self.yaw + turn / 2)
        self.yaw += turn
        return np.array([self.x, self.y, self.yaw])
