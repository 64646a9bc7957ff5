"""What is known of a robot's motion from stamps and odometry: between scans, and during the sweep of one."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from turtlebag.datasets.durations import nanoseconds, seconds
from turtlebag.datasets.se2 import SE2, Array
from turtlebag.datasets.types import Recording

# Number of instants, evenly spaced, at which the motion within a sweep is kept: a robot may stop turning
# within one.
KNOTS = 8
# No robot drives faster than this many times what it hardly ever exceeds; any robot may drive and turn this
# fast [m/s, rad/s], however rarely it does.
FASTER, NEARLY_ALWAYS = 1.3, 0.98
ANY_ROBOT = (1.0, 4.0)
# Between scans further apart than this many usual periods, nothing is known.
GAP_PERIODS = 10
# Stamps may be out of order, or come in a burst, among so many.
STAMPS_NEAR = 12


def fastest(moved: Array, seconds: Array) -> Array:
    """Speeds (2,) [m/s, rad/s] that a robot never exceeds, from its motions (n, 2) over intervals (n,)
    [s]."""
    usual = np.quantile(moved / seconds[:, None], NEARLY_ALWAYS, axis=0)
    return np.asarray(np.maximum(FASTER * usual, ANY_ROBOT))


def usual_wait_s(waits_s: Array) -> float:
    """The usual time between two scans [s] in a log with these times between scans (n,), over several scans
    where there are enough; 0 if the clock stands still."""
    several = min(max(len(waits_s) // 4, 1), STAMPS_NEAR)
    stamps = np.concatenate([[0.0], np.cumsum(waits_s)])
    means = (stamps[several:] - stamps[:-several]) / several
    ordered = np.sort(means[means > 0.0])  # np.median takes ten times as long for a few
    n = len(ordered)
    return float(ordered[(n - 1) // 2] + ordered[n // 2]) / 2.0 if n else 0.0


def gap_s(waits_s: Array) -> float:
    """The time between two scans [s], negative or not, beyond which nothing is known of the motion, in a log
    with these times between scans (n,)."""
    return GAP_PERIODS * usual_wait_s(waits_s)


def without_gap(waits_s: Array) -> NDArray[np.bool_]:
    """Which times between the scans of a log (n,) [s] are known and short enough to know the motion."""
    return (waits_s > 0.0) & (waits_s < gap_s(waits_s))


def gaps_between(stamps_ns: NDArray[np.int64], saw: NDArray[np.bool_]) -> NDArray[np.int64]:
    """Pairs (n, 2) of successive scans that `saw` something, with a long time between them in which none
    did."""
    usable = np.flatnonzero(saw)
    stamps = seconds(stamps_ns[usable])
    if len(stamps) < 2:
        return np.zeros((0, 2), dtype=np.int64)
    # stamps out of order make false gaps, so the latest before is compared with the earliest after
    padded = np.pad(stamps, STAMPS_NEAR, mode="edge")
    near = np.lib.stride_tricks.sliding_window_view(padded, STAMPS_NEAR)
    waits = near[STAMPS_NEAR + 1 : -1].min(axis=1) - near[1 : len(stamps)].max(axis=1)
    long = np.flatnonzero(waits > gap_s(np.diff(stamps)))
    return np.stack([usable[long], usable[long + 1]], axis=1)


def way_and_turn(steps: Array) -> Array:
    """Distance [m] and turn [rad] of motions (n, 3), both unsigned, (n, 2)."""
    return np.column_stack([np.hypot(steps[:, 0], steps[:, 1]), np.abs(steps[:, 2])])


def sweep_motion(recording: Recording) -> SE2 | None:
    """Base poses (n, KNOTS) during each sweep relative to its start, by odometry; None without a stream or
    where a sweep takes no time. The last one is that at the end of the sweep. Where the odometry jumps, the
    motion of the previous sweep is used."""
    if recording.others:
        return _of_each_lidar(
            recording, [sweep_motion(part) if len(part) else None for _, part in recording.parts()]
        )
    sweep_s = recording.lidar.sweep_s
    if recording.odometry is None or len(recording.odometry) < 2 or sweep_s == 0.0:
        return None
    after_ns = nanoseconds(np.arange(KNOTS + 1) / KNOTS * sweep_s)
    during = recording.odometry.at((recording.stamps_ns[:, None] + after_ns).ravel())
    T_odom_knots = SE2(during.xyt.reshape(-1, KNOTS + 1, 3))
    # a jump may end within a sweep and move its end only a little, so each part is checked
    moved = way_and_turn((T_odom_knots[:, :-1].inverse() @ T_odom_knots[:, 1:]).xyt.reshape(-1, 3))
    part_s = np.full(len(moved), sweep_s / KNOTS)
    too_far = moved > fastest(moved, part_s) * part_s[:, None]
    jumps = too_far.reshape(len(T_odom_knots), -1).any(axis=1)
    motion = T_odom_knots[:, :1].inverse() @ T_odom_knots[:, 1:]
    return motion[np.maximum.accumulate(np.where(jumps, 0, np.arange(len(motion))))]


def sweep_motion_by_track(recording: Recording, T_track_base: SE2) -> SE2:
    """As `sweep_motion`, from the poses of the scans themselves (n,), for logs without odometry.

    A scan that is not corrected yet has the pose of the middle of its sweep, so the speed during the sweep is
    the mean of those before and after.
    """
    if recording.others:
        parts = [(part, T_track_base[rows]) for rows, part in recording.parts()]
        by_track = [sweep_motion_by_track(*part) if len(part[0]) else None for part in parts]
        return _of_each_lidar(recording, by_track) or no_motion(len(recording))
    sweep_s = recording.lidar.sweep_s
    waits = seconds(np.diff(recording.stamps_ns))
    steps = T_track_base.steps()
    known = without_gap(waits)
    speed = np.where(known[:, None], steps / np.where(known, waits, 1.0)[:, None], 0.0)
    around = np.concatenate([speed[:1], speed, speed[-1:]])
    whole = 0.5 * (around[:-1] + around[1:]) * sweep_s
    return SE2(whole[:, None] * (np.arange(1, KNOTS + 1) / KNOTS)[:, None])


def known_motion(recording: Recording, motion: SE2 | None = None) -> SE2:
    """`motion` (n, KNOTS), or that by odometry if it is None; zero where it is unknown, or where the lidar
    takes all beams at once."""
    if sweeps(recording):
        motion = sweep_motion(recording) if motion is None else motion
        if motion is not None:
            return motion
    return no_motion(len(recording))


def sweeps(recording: Recording) -> bool:
    """Whether the beams of some scans are taken one after another."""
    return any(lidar.spec.time_increment != 0.0 for lidar in recording.lidars)


def no_motion(n: int) -> SE2:
    """The motion (n, KNOTS) of a base that stands still, or whose motion is unknown."""
    return SE2(np.zeros((n, KNOTS, 3)))


def _of_each_lidar(recording: Recording, parts: list[SE2 | None]) -> SE2 | None:
    """The motion during all sweeps, from that during the sweeps of each lidar."""
    if all(motion is None for motion in parts):
        return None
    xyt = no_motion(len(recording)).xyt
    for (rows, _), motion in zip(recording.parts(), parts, strict=True):
        if motion is not None:
            xyt[rows] = motion.xyt
    return SE2(xyt)
