"""Lesson 8 solved: drive where there is room, turn where there is none."""

from __future__ import annotations

import numpy as np

from turtlebag.datasets.se2 import Array

WIDTH_M, STOP_M, SLOW_M = 0.26, 0.45, 1.0
"""Half of the way to keep free; distance at which to stop, and at which to slow down."""


class Avoider:
    """Looks at what lies in its way, as wide as itself, and turns to the side with more room."""

    def __init__(self, angles: Array, max_v: float, max_w: float) -> None:
        self.ahead, self.aside = np.cos(angles), np.sin(angles)
        self.max_v, self.max_w = max_v, max_w
        self.side = 0.0

    def command(self, ranges: Array) -> Array:
        """Speed ahead and turning speed, (2,)."""
        near = np.where(np.isnan(ranges), np.inf, np.maximum(ranges, 0.12))
        finite = np.minimum(near, 3.5)
        x, y = finite * self.ahead, finite * self.aside
        in_the_way = (x > 0.0) & (np.abs(y) < WIDTH_M)
        free = float(np.min(x[in_the_way], initial=3.5))
        left, right = (float(np.mean(finite[(self.ahead > 0.0) & (s * self.aside > 0.2)])) for s in (1, -1))
        if free < STOP_M:
            self.side = self.side or (1.0 if left > right else -1.0)
            return np.array([0.0, 0.9 * self.side])
        self.side = 0.0
        speed = min(1.0, (free - STOP_M) / (SLOW_M - STOP_M))
        turn = 0.5 * (left - right) / (left + right) * (1.0 if free < 2.0 else 0.2)
        return np.array([self.max_v * max(0.3, speed), turn])
