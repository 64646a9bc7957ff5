"""Detects scans that a stuck lidar sends again while the robot moves, and those of one that always reads the
same range."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from turtlebag.datasets.plurals import counted, verb
from turtlebag.datasets.se2 import SE2
from turtlebag.datasets.types import Recording
from turtlebag.pipeline.slam.scans.range_noise import range_noise

# A robot that has moved this far by its odometry cannot measure exactly the same ranges again [m], [rad].
MOVED = 0.05
# Where it has moved this far [m], it cannot see a circle of the same radius round itself, to within FLAT_M,
# with a lidar that sees at least this angle [rad].
CIRCLE_M, FLAT_M, WIDE_RAD = 0.2, 0.05, 1.5


def without_repeats(recording: Recording, usable_range: float) -> Recording:
    """The recording without the scans of a stuck lidar: while the robot moves on, the same ranges, to the
    last bit, or one range in all directions.

    Such scans keep their stamps and lose their ranges; a note gives their number. A lidar without noise, such
    as a simulated one, may measure the same again; its scans are kept.
    """
    odometry, bits = recording.T_odom_base, np.ascontiguousarray(recording.ranges).view(np.uint32)
    if odometry is None or not len(recording):
        return recording
    circles = _circles(recording, odometry)
    if circles.any():
        return _without(recording, circles, "one range in all directions")
    measured = recording.lidar.returns(recording.ranges).any(axis=1)
    same = measured & np.concatenate([[False], (bits[1:] == bits[:-1]).all(axis=1)])
    if not same.any() or _exact(recording, usable_range):
        return recording
    first = np.maximum.accumulate(np.where(same, 0, np.arange(len(bits))))
    moved = np.abs((odometry[first].inverse() @ odometry).xyt)
    return _without(recording, same & (moved.max(axis=1) > MOVED), "exact copies of an earlier one")


def _without(recording: Recording, held: NDArray[np.bool_], what: str) -> Recording:
    """The recording without the ranges of the scans (n,) that a stuck lidar sent."""
    if not held.any():
        return recording
    many = int(held.sum())
    said = f"{counted(many, 'scan')} {verb(many, 'is', 'are')} {what} although the odometry moves: not used"
    ranges = np.where(held[:, None], np.float32(np.nan), recording.ranges)
    return replace(recording, ranges=ranges, notes=(*recording.notes, said))


def _circles(recording: Recording, T_odom_base: SE2) -> NDArray[np.bool_]:
    """Which scans (n,) see a circle round the robot that moves along with it."""
    lidar, ranges = recording.lidar, recording.ranges
    back = lidar.returns(ranges)
    enough = 2 * back.sum(axis=1) > lidar.n_beams
    if not enough.any() or lidar.n_beams * abs(lidar.angle_increment) < WIDE_RAD:
        return np.zeros(len(ranges), dtype=bool)
    near, far = (
        edge.astype(np.float64) for edge in (np.where(back, ranges, np.inf), np.where(back, ranges, 0))
    )
    near, far = near.min(axis=1), far.max(axis=1)
    flat = enough & (far - near < FLAT_M)
    first = int(flat.argmax())
    away = np.linalg.norm(T_odom_base.xy - T_odom_base.xy[first], axis=1) > CIRCLE_M
    return np.asarray(flat & away & (np.abs(far - far[first]) < FLAT_M))


def _exact(recording: Recording, usable_range: float) -> bool:
    """Whether the ranges have no more noise than the least assumed for any lidar."""
    return range_noise(recording, usable_range).least
