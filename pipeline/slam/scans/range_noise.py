"""Range noise of a lidar, estimated from its own log.

In polar coordinates a wall's 1 / r is a cosine of the bearing, so for three neighbouring beams on one wall
`u(-d) + u(d) - 2 cos(d) u(0)` with u = 1 / r is zero, whatever the wall's pose.
Its actual value is noise, by the median over all triples: those across an edge are too few to affect it.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from turtlebag.datasets.robust import PER_MEDIAN, not_negative
from turtlebag.datasets.se2 import Array
from turtlebag.datasets.types import Recording

# No range is more accurate than this [m]: logs are rounded to centimetres, and walls are rough.
LEAST_M = 0.003
# Number of scans used; ratio of successive bins of ranges; triples that make a bin count.
SCANS, BIN_FACTOR, LEAST_TRIPLES = 400, 1.5, 100


@dataclass(frozen=True)
class RangeNoise:
    """Standard deviation of a range r [m]: sqrt(floor_m^2 + (per_m r)^2 + (per_m2 r^2)^2).

    Electronics give a floor, times of flight and tolerances grow with the range, triangulation with its
    square.
    """

    floor_m: float = 0.01
    per_m: float = 0.0
    per_m2: float = 0.0
    others: tuple[RangeNoise, ...] = ()
    """Those of further lidars."""

    def of(self, number: int) -> RangeNoise:
        """That of one of the lidars."""
        return (self, *self.others)[number]

    def variance(self, ranges: Array) -> Array:
        """Variance [m^2] of ranges of any shape [m]."""
        return self.floor_m**2 + (self.per_m * ranges) ** 2 + (self.per_m2 * ranges**2) ** 2

    @property
    def least(self) -> bool:
        """Whether a metre is as accurate as any range can be."""
        return bool(self.variance(np.array(1.0)) <= 1.1 * LEAST_M**2)


def range_noise(recording: Recording, usable_range: float) -> RangeNoise:
    """The noise of a recording's ranges; the usual centimetre if there are too few beams."""
    if recording.others:
        first, *others = (range_noise(part, usable_range) for _, part in recording.parts())
        return replace(first, others=tuple(others))
    step = max(1, len(recording) // SCANS)
    lidar, ranges = recording.lidar, recording.ranges[::step]
    valid, r = lidar.returns(ranges) & (ranges <= usable_range), ranges.astype(np.float64)
    d = recording.stride
    whole = valid[:, : -2 * d] & valid[:, d:-d] & valid[:, 2 * d :]
    u = 1.0 / np.where(valid, r, 1.0)
    twice_cos = 2.0 * np.cos(d * lidar.angle_increment)
    e = np.abs(u[:, : -2 * d] + u[:, 2 * d :] - twice_cos * u[:, d:-d])[whole]
    middle = r[:, d:-d][whole]
    sigma = PER_MEDIAN * e * middle**2 / np.sqrt(2.0 + twice_cos**2)
    bins = np.floor(np.log(middle) / np.log(BIN_FACTOR)).astype(int)
    rows, wanted = [], []
    for k in np.unique(bins):
        inside = bins == k
        if np.count_nonzero(inside) >= LEAST_TRIPLES:
            # the error of a bin is a share of its variance, which falls with the number of triples
            variance = max(float(np.median(sigma[inside])), LEAST_M) ** 2
            share, at = np.sqrt(np.count_nonzero(inside)) / variance, float(np.median(middle[inside]))
            rows.append([share, share * at**2, share * at**4])
            wanted.append(share * variance)
    if not rows:
        return RangeNoise()
    floor, slope, square = np.sqrt(not_negative(np.array(rows), np.array(wanted)))
    return RangeNoise(max(float(floor), LEAST_M), float(slope), float(square))
