"""Implausible times, positions and units: the limits that `bag doctor` reports and mapping corrects."""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import ArrayLike, NDArray

from turtlebag.datasets.se2 import Array
from turtlebag.datasets.types import Stamps

FAR_M = 1e8
"""Larger than any distance on Earth; coordinates of national grids are smaller."""
ARM_M = 30.0
"""No sensor sits as far from its robot's centre: 30 mm do."""
CLOCK_NS = 1_000_000_000
"""Stamps this far apart are of two clocks."""
_FAST = 50.0
"""No wheeled robot drives as fast [m/s]: 5 cm/s in millimetres are."""
_LONG_M = 50.0
"""At most nine readings in ten are as long as this [m]; in millimetres, those of every room are."""
_LARGEST_LIMIT_M = 1000.0
"""No planar lidar sees as far [m]; its limits are in millimetres too."""
_STEP_NS = 1_000_000_000


def directed(angle_min: float, step: float, n: int) -> bool:
    """Whether n beams from an angle on, a step apart [rad], have directions."""
    if not (math.isfinite(angle_min) and math.isfinite(step) and n > 0):
        return False
    return abs(angle_min) < 100.0 and (n == 1 or 1e-5 <= abs(step) <= math.pi)


def stands_still(stamps: ArrayLike) -> bool:
    """Whether several messages carry one and the same stamp: their clock never ran."""
    found = np.asarray(stamps, dtype=np.int64)
    return len(found) > 1 and bool((found == found[0]).all())


def far_away(xyz: ArrayLike) -> bool:
    """Whether a position [m] is implausibly far away, or not finite."""
    return not bool((np.abs(np.asarray(xyz, dtype=np.float64)) < FAR_M).all())


def ranges_in_millimetres(ranges: NDArray[np.floating], range_max: float) -> bool:
    """Whether readings are thousands of what a lidar can see; one code again and again is not."""
    limit = range_max if range_max > _LARGEST_LIMIT_M else np.inf
    with np.errstate(invalid="ignore"):
        found = ranges[np.isfinite(ranges) & (ranges > 0.0) & (ranges < limit)]
    if not len(found):
        return False
    short, long = np.quantile(found, (0.1, 0.9))
    beyond = limit < np.inf or short > range_max
    return bool(beyond and short > _LONG_M and long > 1.05 * short and long < 1000.0 * _LARGEST_LIMIT_M)


def limits_in_millimetres(range_max: float) -> bool:
    """Whether a lidar's own limits are no metres either."""
    return range_max > _LARGEST_LIMIT_M


def driven_in_millimetres(stamps_ns: Stamps, xy: Array) -> bool:
    """Whether positions (n, 2) are of a robot faster than any, measured over a second at a time."""
    order = np.argsort(stamps_ns, kind="stable")
    stamps, xy = stamps_ns[order], xy[order]
    if len(stamps) < 2 or stamps[-1] - stamps[0] < _STEP_NS:
        return False
    nearest = np.searchsorted(stamps, np.arange(stamps[0], stamps[-1] + 1, _STEP_NS))
    rows = np.unique(np.minimum(nearest, len(stamps) - 1))
    elapsed = np.diff(stamps[rows]) * 1e-9
    speeds = np.linalg.norm(np.diff(xy[rows], axis=0), axis=1) / elapsed
    return bool(np.quantile(speeds, 0.9) > _FAST) if len(speeds) else False
