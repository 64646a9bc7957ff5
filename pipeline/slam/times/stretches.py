"""Short stretches of a drive whose scans are tracked alone, to be compared with what the odometry says.

Deskewing depends on the odometry and on the times of the beams, so a stretch is tracked anew for each belief
about either.
"""

from __future__ import annotations

from dataclasses import replace
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from turtlebag.datasets.durations import nanoseconds, seconds
from turtlebag.datasets.motion import fastest, known_motion, usual_wait_s, way_and_turn, without_gap
from turtlebag.datasets.se2 import Array, wrap
from turtlebag.datasets.types import Recording, Trajectory
from turtlebag.pipeline.slam.odometry.line_icp import Lines
from turtlebag.pipeline.slam.odometry.track import Track, TrackingConfig
from turtlebag.pipeline.slam.odometry.tracker import Tracker
from turtlebag.pipeline.slam.scans.clouds import Clouds
from turtlebag.pipeline.slam.scans.range_noise import RangeNoise
from turtlebag.pipeline.slam.scans.scans import Scans

# Number of stretches, scans of each, and their least distance [s].
STRETCHES, SCANS, PERIOD_S = 24, 8, 0.2


class Stretch(NamedTuple):
    """Some scans of a log, tracked alone: their points and lines, their poses, and the beam of each point."""

    clouds: Clouds
    track: Track
    beams: NDArray[np.int64]


def tracked_alone(
    recording: Recording, rows: NDArray[np.int64], noise: RangeNoise, late_s: float = 0.0
) -> Stretch:
    """Some scans (n,) tracked alone, each sweep deskewed by an odometry this late."""
    stamps_ns = recording.stamps_ns[rows]
    late = replace(recording, stamps_ns=stamps_ns + nanoseconds(late_s))
    alone = replace(
        recording,
        stamps_ns=stamps_ns,
        ranges=recording.ranges[rows],
        T_odom_base=None,
        odometry=None,
        imu=None,
    )
    clouds = Scans(alone, alone.lidar.range_max, noise, known_motion(late)).clouds()
    tracker = Tracker(clouds, alone, TrackingConfig(), alone.lidar.range_max, Lines)
    for wait_s in seconds(np.diff(stamps_ns)).tolist():
        tracker.step(wait_s)
    seen = recording.lidar.returns(alone.ranges)
    return Stretch(clouds, tracker.track(), np.nonzero(seen)[1])


def turning(scans: Recording) -> list[NDArray[np.int64]]:
    """The scans of the stretches in which the turning changes most, and the odometry does not jump."""
    assert scans.T_odom_base is not None
    waits, moved = seconds(np.diff(scans.stamps_ns)), way_and_turn(scans.T_odom_base.steps())
    known = without_gap(waits)
    starts = np.arange(0, len(scans) - SCANS, SCANS)
    if not len(starts) or not known.any():
        return []
    jumped = known & (moved > fastest(moved[known], waits[known]) * waits[:, None]).any(axis=1)
    rate = np.where(known, wrap(np.diff(scans.T_odom_base.yaw)) / np.where(known, waits, 1.0), 0.0)
    change = np.add.reduceat(np.minimum(np.abs(np.diff(rate, append=rate[-1:])), 1.0), starts)
    return _best(starts, np.where(np.logical_or.reduceat(jumped, starts), -np.inf, change))


def straight(scans: Recording) -> list[NDArray[np.int64]]:
    """Scans of each of the stretches in which, by the odometry, the robot drives farthest and turns least."""
    T, starts = scans.T_odom_base, np.arange(0, len(scans) - SCANS, SCANS)
    assert T is not None
    x, y, turn = (T[starts].inverse() @ T[starts + SCANS - 1]).xyt.T
    return _best(starts, np.hypot(x, y) * np.cos(np.clip(2.0 * turn, -np.pi, np.pi)))


def _best(starts: NDArray[np.int64], worth: Array) -> list[NDArray[np.int64]]:
    """The scans of the stretches, of those that begin at `starts` (n,), that are worth most, (n,)."""
    order = np.argsort(-worth, kind="stable")[:STRETCHES]
    chosen = starts[np.sort(order[np.isfinite(worth[order])])]
    return [start + np.arange(SCANS) for start in chosen]


def odometry_stream(recording: Recording) -> Trajectory:
    """The odometry at its own rate, or else that of the scans."""
    if recording.odometry is not None:
        return recording.odometry
    assert recording.T_odom_base is not None
    stamps, first = np.unique(recording.stamps_ns, return_index=True)
    return Trajectory(stamps, recording.T_odom_base[first])


def thinning(recording: Recording) -> int:
    """Every so many scans are PERIOD_S apart."""
    return max(1, round(PERIOD_S / usual_period(recording)))


def thinned_scans(recording: Recording) -> Recording:
    """The recording with scans at least PERIOD_S apart, and its odometry as a stream."""
    some = slice(None, None, thinning(recording))
    return replace(
        recording,
        stamps_ns=recording.stamps_ns[some],
        ranges=recording.ranges[some],
        T_odom_base=None if recording.T_odom_base is None else recording.T_odom_base[some],
        odometry=odometry_stream(recording),
    )


def usual_period(recording: Recording) -> float:
    """The usual time between scans [s]; PERIOD_S if the clock stands still."""
    return usual_wait_s(seconds(np.diff(recording.stamps_ns))) or PERIOD_S
