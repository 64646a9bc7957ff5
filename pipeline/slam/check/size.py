"""How well the size of a map is known: lidar and wheels each measure distances, and may disagree."""

from __future__ import annotations

import math
from dataclasses import dataclass

from turtlebag.pipeline.slam.sensors.setup_estimate import SensorSetup

# Standard deviations of the distances that lidars and wheels measure, as shares: lidars by their data sheets;
# the wheels of six public logs were up to 3.4 % off. Wheels are never off by twice theirs.
LIDAR, WHEELS = 0.01, 0.02


@dataclass(frozen=True)
class Size:
    """The true size of a map as a share of its own, `value`, with standard deviation `sigma`; `apart` is by
    how much the distances of lidar and wheels differ for certain, as a share."""

    value: float = 1.0
    sigma: float = LIDAR
    apart: float = 0.0

    @property
    def known_to(self) -> float:
        """The share to which the size is known, at 95 %."""
        return abs(self.value - 1.0) + 1.96 * self.sigma

    @property
    def doubt(self) -> str | None:
        """What to say of the size, if lidar and wheels differ by more than wheels are ever off."""
        if self.apart <= 2.0 * WHEELS:
            return None
        return (
            f"shape good, size known to {100.0 * self.known_to:.0f} %: lidar and wheels disagree about "
            f"distances by {100.0 * self.apart:.1f} %, and nothing tells which of them is right"
        )

    def as_metrics(self) -> dict[str, object]:
        """`scale` of the self-check."""
        interval = [self.value - 1.96 * self.sigma, self.value + 1.96 * self.sigma]
        return {"scale": {"value": self.value, "interval_95": interval, "said": self.doubt}}


def size_of(setup: SensorSetup) -> Size:
    """The size of a map whose distances are the lidar's, by lidar and wheels together.

    Where they disagree by more than expected, both are less sure by that ratio (Birge 1932).
    """
    wheels = next((one for one in setup.quantities if one.name == "wheel_scale" and one.observable), None)
    if wheels is None:
        return Size()
    # a metre of the wheels is so many of the lidar
    apart, usual = wheels.value - 1.0, math.hypot(LIDAR, WHEELS)
    ratio = max(1.0, abs(apart) / usual)
    sure = max(0.0, abs(apart) - 1.96 * wheels.sigma)
    return Size(1.0 - apart * (LIDAR / usual) ** 2, ratio * LIDAR * WHEELS / usual, sure)
