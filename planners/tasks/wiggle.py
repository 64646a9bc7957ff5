"""The tutorial's wiggle: turn back and forth until the particle cloud has converged."""

from __future__ import annotations

import math

from turtlebag.datasets.durations import seconds
from turtlebag.datasets.types import Twist
from turtlebag.planners.tasks.recovery import ROTATE_W

ANGLE = 1.2
"""It turns this far [rad] to the left, twice as far to the right, and so on."""
LEAST_S, MOST_S = 3.0, 25.0
"""Minimum and maximum duration, whatever the cloud does (not measured)."""


class Wiggle:
    """One wiggle; time starts with the first question."""

    def __init__(self) -> None:
        self.gave_up = False
        self._start_ns: int | None = None

    def command(self, now_ns: int, settled: bool) -> Twist | None:
        """The turn of this tick; None when the cloud is `settled` or the time is over."""
        if self._start_ns is None:
            self._start_ns = now_ns
        t = seconds(now_ns - self._start_ns)
        if t >= MOST_S:
            self.gave_up = not settled
            return None
        if settled and t >= LEAST_S:
            return None
        # A triangle wave of heading: a quarter up, a half down, a quarter up.
        return Twist(0.0, math.copysign(ROTATE_W, math.cos(0.5 * math.pi * t * ROTATE_W / ANGLE)))
