"""The tutorial's advice as a behaviour: turn to and fro until the particle cloud has shrunk."""

from __future__ import annotations

import math

from pydantic import Field

from turtlebag.datasets.settings import Settings
from turtlebag.datasets.spans import Seconds
from turtlebag.datasets.types import Twist


class WiggleConfig(Settings, allow_inf_nan=False):
    """Radians and seconds."""

    angle: float = Field(default=1.2, gt=0.0)
    """It turns this far to the left, twice as far to the right, and so on."""
    w: float = Field(default=0.7, gt=0.0)
    least: Seconds = 3.0
    """It goes on at least so long."""
    most: Seconds = Field(default=25.0, gt=0.0)
    """And stops after so long, whatever the cloud does."""


class Wiggle:
    """One wiggle; time starts with the first question."""

    def __init__(self, config: WiggleConfig) -> None:
        self.config = config
        self.gave_up = False
        self._start_ns: int | None = None

    def command(self, now_ns: int, settled: bool) -> Twist | None:
        """The turn of this tick; None when the cloud is `settled` or the time is over."""
        if self._start_ns is None:
            self._start_ns = now_ns
        t = (now_ns - self._start_ns) * 1e-9
        if t >= self.config.most:
            self.gave_up = not settled
            return None
        if settled and t >= self.config.least:
            return None
        # A triangle wave of heading: a quarter up, a half down, a quarter up.
        phase = (t * self.config.w / (4.0 * self.config.angle)) % 1.0
        return Twist(0.0, math.copysign(self.config.w, 1.0 if phase < 0.25 or phase >= 0.75 else -1.0))
