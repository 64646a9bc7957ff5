"""Detects scans that a stuck lidar sends again while the robot moves."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from turtlebag.datasets.types import Recording
from turtlebag.pipeline.slam.scans.range_noise import range_noise

# A robot that has moved this far by its odometry cannot measure exactly the same ranges again [m], [rad].
MOVED = 0.05


def without_repeats(recording: Recording, usable_range: float) -> Recording:
    """The recording without the scans of a stuck lidar: the same ranges, to the last bit, while the robot
    moves on.

    Such scans keep their stamps and lose their ranges; a note gives their number. A lidar without noise, such
    as a simulated one, may measure the same again; its scans are kept.
    """
    odometry, bits = recording.T_odom_base, np.ascontiguousarray(recording.ranges).view(np.uint32)
    measured = recording.lidar.returns(recording.ranges).any(axis=1)
    same = measured & np.concatenate([[False], (bits[1:] == bits[:-1]).all(axis=1)])
    if odometry is None or not same.any() or _exact(recording, usable_range):
        return recording
    first = np.maximum.accumulate(np.where(same, 0, np.arange(len(bits))))
    moved = np.abs((odometry[first].inverse() @ odometry).xyt)
    held = same & (moved.max(axis=1) > MOVED)
    if not held.any():
        return recording
    said = f"{held.sum()} scans are exact copies of an earlier one although the odometry moves: not used"
    ranges = np.where(held[:, None], np.float32(np.nan), recording.ranges)
    return replace(recording, ranges=ranges, notes=(*recording.notes, said))


def _exact(recording: Recording, usable_range: float) -> bool:
    """Whether the ranges have no more noise than the least assumed for any lidar."""
    return range_noise(recording, usable_range).least
