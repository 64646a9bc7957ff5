"""Ranges that no lidar measured: a code where "no return" is meant, and a sweep sent again."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from datasets.types import Recording

_SCANS = 1000
"""Scans looked at; codes are sent all the time."""
_SHARE = 0.005
"""Share of the readings that a code must have to matter."""
_TIMES = 10
"""A wall spreads over many ranges, a code does not: so many times as often as any range of walls nearby,
and as all that is farther."""
_VARIED = 50
"""Fewer different readings than this tell nothing of what walls give."""
_MOVED_M, _MOVED_RAD = 0.05, 0.05
"""A robot that has moved so far by its odometry cannot have measured the very same ranges again."""


def no_return_value(readings: NDArray[np.floating]) -> float:
    """Least range at which beams pile up as no wall makes them [m]; +inf when there is none.

    `readings` (n_scans, n_beams). Such a value, exactly equal each time, stands at the far end of the
    readings and is far more frequent than any other of at least half its range.
    """
    some = readings[:: 1 + len(readings) // _SCANS]
    values, counts = np.unique(some[np.isfinite(some) & (some > 0.0)], return_counts=True)
    found, end = math.inf, len(values)
    if end < _VARIED:
        return found
    frequent = np.flatnonzero(counts >= max(_SHARE * counts.sum(), _TIMES))
    for k in frequent[::-1]:
        # another code may stand right beside
        nearby = counts[(values >= 0.5 * values[k]) & (values < 0.99 * values[k])]
        if counts[k] <= _TIMES * max(nearby.max(initial=1), counts[k + 1 : end].sum()):
            break
        found, end = float(values[k]), int(k)
    return found


def without_repeats(recording: Recording) -> Recording:
    """The recording without what a lidar that hangs sends: the same ranges, to the last bit, while the robot
    moves on. Such scans keep their stamps and lose their ranges; a note says how many they are."""
    odometry, bits = recording.T_odom_base, np.ascontiguousarray(recording.ranges).view(np.uint32)
    measured = recording.lidar.returns(recording.ranges).any(axis=1)
    same = measured & np.concatenate([[False], (bits[1:] == bits[:-1]).all(axis=1)])
    if odometry is None or not same.any():
        return recording
    first = np.maximum.accumulate(np.where(same, 0, np.arange(len(bits))))
    moved = np.abs((odometry[first].inverse() @ odometry).xyt)
    held = same & ((moved[:, :2].max(axis=1) > _MOVED_M) | (moved[:, 2] > _MOVED_RAD))
    if not held.any():
        return recording
    said = f"{held.sum()} scans repeat an earlier one to the last bit while the odometry moves on: not used"
    ranges = np.where(held[:, None], np.float32(np.nan), recording.ranges)
    return replace(recording, ranges=ranges, notes=(*recording.notes, said))
