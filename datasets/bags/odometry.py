"""Odometry of a bag at the stamps of its scans, and a sensor's pose on the robot."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from turtlebag.datasets.bags import decode
from turtlebag.datasets.bags.plausibility import ARM_M, CLOCK_NS, FAR_M, driven_in_millimetres, stands_still
from turtlebag.datasets.bags.streams import OdometryColumns, Streams
from turtlebag.datasets.bags.tf_frames import BASES, FrameTree
from turtlebag.datasets.errors import InputError
from turtlebag.datasets.plurals import counted
from turtlebag.datasets.se2 import SE2, Array
from turtlebag.datasets.types import Stamps, Trajectory

_DRIVEN = (0.1, 0.1, 0.2)
"""Twists that lead farther than this [m, m, rad] are of a robot that drives, not of noise."""


@dataclass(frozen=True, eq=False, slots=True)
class OdometrySource:
    """Where the odometry comes from: its poses by stamp, by log time, and the frame they move."""

    base: str
    poses: Trajectory | None = None
    by_log_time: Trajectory | None = None


def find_odometry(streams: Streams, scan_frame: str, notes: list[str]) -> OdometrySource:
    """Odometry from /odom, from the only odometry topic, or from /tf."""
    names = list(streams.odometry)
    chosen = "/odom" if "/odom" in names else (names[0] if len(names) == 1 else None)
    if chosen:
        columns = streams.read_odometry(chosen)
        if len(columns.stamps_ns):
            if streams.frames.lookup(columns.child, scan_frame) is None:
                streams.follow_tf()
            if columns.others:
                left = ", ".join(f"{count} of {link}" for link, count in columns.others.items())
                notes.append(f"{chosen}: poses of several frames; {left} left out")
            base = columns.child or streams.frames.base()
            xyt = _filled_in(columns, chosen, notes)
            return _source(base, columns.stamps_ns, columns.log_times_ns, xyt, chosen, notes)
    if len(names) > 1:
        notes.append(f"several odometry topics and no /odom ({', '.join(names)}): /tf is used")
    streams.follow_tf()
    frames = streams.frames
    links = [link for link in frames.moving if "odom" in link[0]]
    # one that leads to the lidar, else whichever: where the lidar sits is another question
    links.sort(key=lambda link: frames.lookup(link[1], scan_frame) is None)
    if links:
        parent, child = links[0]
        notes.append(f"odometry from /tf ({parent} -> {child})")
        moving = frames.moving[parent, child]
        stamps = np.array([transform.stamp_ns for transform in moving], dtype=np.int64)
        times = np.array([transform.log_time_ns for transform in moving], dtype=np.int64)
        rows = np.array([(t.xyz[0], t.xyz[1], decode.yaw_of(t.quaternion)) for t in moving])
        return _source(child, stamps, times, rows, "/tf", notes)
    notes.append("no odometry: neither an Odometry topic nor odom -> base in /tf")
    return OdometrySource(frames.base())


def _filled_in(columns: OdometryColumns, name: str, notes: list[str]) -> Array:
    """The poses (n, 3); where a driver fills in its twists alone, those that they lead to."""
    if not never_changes(columns.xyt):
        return columns.xyt
    start = SE2.from_array(np.nan_to_num(columns.xyt[0]))
    xyt = integrated(running(columns.stamps_ns, columns.log_times_ns, name, []), columns.twists, start)
    if not (np.abs(xyt - start.xyt) > _DRIVEN).any():
        return columns.xyt
    notes.append(f"{name}: the pose never changes but the twist does: the path is integrated from the twist")
    return xyt


def never_changes(xyt: Array) -> bool:
    """Whether all poses (n, 3) are one, as those that a driver does not fill in."""
    return np.array_equal(xyt, np.broadcast_to(xyt[0], xyt.shape), equal_nan=True)


def integrated(stamps: Stamps, twists: Array, start: SE2) -> Array:
    """Poses (n, 3) that twists (n, 3) [m/s, m/s, rad/s] lead to from `start` on, in the order of the input.

    Each step is taken with the mean of the twists at its ends, in the direction halfway; absurd ones
    and those that are no numbers count as 0.
    """
    order = np.argsort(stamps, kind="stable")
    speeds = np.where(np.abs(twists[order]) < FAR_M, twists[order], 0.0)
    steps = 0.5 * (speeds[1:] + speeds[:-1]) * (np.diff(stamps[order]) * 1e-9)[:, None]
    turned = np.cumsum(steps[:, 2])
    halfway = turned - 0.5 * steps[:, 2]
    dx = steps[:, 0] * np.cos(halfway) - steps[:, 1] * np.sin(halfway)
    dy = steps[:, 0] * np.sin(halfway) + steps[:, 1] * np.cos(halfway)
    path = np.zeros((len(stamps), 3))
    path[1:] = np.column_stack([np.cumsum(dx), np.cumsum(dy), turned])
    xyt = np.empty_like(path)
    xyt[order] = (start @ SE2.from_array(path)).xyt
    return xyt


def _source(
    base: str, stamps: Stamps, times: Stamps, xyt: Array, name: str, notes: list[str]
) -> OdometrySource:
    """The poses (n, 3) that are such, in metres, by stamp and by log time [ns]."""
    with np.errstate(invalid="ignore"):
        places = (np.abs(xyt) < FAR_M).all(axis=1)
    if not places.all():
        what = "are not finite or implausibly far away, and left out"
        notes.append(f"{name}: {np.count_nonzero(~places)} poses {what}")
        stamps, times, xyt = stamps[places], times[places], xyt[places]
    if not len(stamps):
        return OdometrySource(base)
    stamps = running(stamps, times, name, notes)
    if driven_in_millimetres(stamps, xyt[:, :2]):
        notes.append(f"{name}: the robot would be implausibly fast; read as millimetres")
        xyt = xyt * (1e-3, 1e-3, 1.0)
    by_stamp, by_log_time = _increasing(stamps, xyt, name, notes), _increasing(times, xyt, name, [])
    return OdometrySource(
        base, without_repeats(by_stamp, name, notes), without_repeats(by_log_time, name, [])
    )


def running(stamps: Stamps, log_times: Stamps, name: str, notes: list[str]) -> Stamps:
    """The stamps, or for a clock that never ran the times of recording, with a note."""
    if not stands_still(stamps) or stands_still(log_times):
        return stamps
    notes.append(f"{name}: every stamp is {stamps[0] * 1e-9:.6f}; the recording times are used instead")
    return log_times


def in_file_order(stamps: Sequence[int], log_times: Stamps, name: str, notes: list[str]) -> Stamps:
    """The stamps of scans, `running`; a note says how often they go back."""
    found = running(np.array(stamps, dtype=np.int64), log_times, name, notes)
    if backwards := int(np.count_nonzero(np.diff(found) < 0)):
        notes.append(f"{name}: stamps go back {counted(backwards, 'time')}; file order kept")
    return found


def _increasing(stamps: Stamps, xyt: Array, name: str, notes: list[str]) -> Trajectory:
    """Poses in order of their stamps, each stamp once."""
    backwards = int(np.count_nonzero(np.diff(stamps) < 0))
    if backwards:
        notes.append(f"{name}: stamps go back {counted(backwards, 'time')}; sorted")
    stamps, first = np.unique(stamps, return_index=True)
    return Trajectory(stamps, SE2.from_array(xyt[first]))


def without_repeats(odometry: Trajectory, name: str, notes: list[str]) -> Trajectory:
    """The poses without those that a driver repeats until it has a new one: the robot moved evenly between
    new poses, rather than standing still and jumping. During a longer standstill, repeated poses are kept."""
    new = np.append(True, (np.diff(odometry.poses.xyt, axis=0) != 0.0).any(axis=1))
    first = np.flatnonzero(new)
    # the last run has no end; a robot that hardly moves says nothing of how often a pose is sent
    runs = np.diff(first)
    usual = int(np.median(runs)) if len(runs) else 1
    if usual < 2:
        return odometry
    following = np.append(first, len(new) + usual)[np.cumsum(new)]
    keep = new | (following - np.arange(len(new)) >= usual)
    notes.append(f"{name}: each pose is sent about {usual} times; used once")
    return Trajectory(odometry.stamps_ns[keep], odometry.poses[keep])


def sensor_matrix(path: Path, frames: FrameTree, base: str, sensor: str, notes: list[str]) -> Array:
    """`T_base_sensor` (4, 4); identity, with a note, when no fixed links connect them.

    InputError when they put the sensor further from the robot than any is large.
    """
    if sensor == base:
        return np.eye(4)
    for start in (base, *BASES):
        T = frames.lookup(start, sensor)
        if T is not None:
            if (arm := float(np.linalg.norm(T[:3, 3]))) > ARM_M:
                what = f"the transforms put the laser '{sensor}' {arm:.4g} m from '{start}' (millimetres?)"
                raise InputError(f"{path}: {what}; --laser X,Y,YAW sets its pose")
            return T
    known = ", ".join(sorted(frames.frames())) or "none"
    notes.append(
        f"no fixed transform {base} -> {sensor} (frames in /tf and /tf_static: {known}): assuming an "
        "upright laser at the robot's centre; --laser X,Y,YAW[,upside-down] sets its pose"
    )
    return np.eye(4)


def odometry_at(odometry: OdometrySource, stamps: Stamps, log_times: Stamps, notes: list[str]) -> SE2 | None:
    """Odometry at the stamp of each scan."""
    poses = odometry.poses
    if poses is None:
        return None
    first, last = int(poses.stamps_ns[0]), int(poses.stamps_ns[-1])
    if stamps.min() > last + CLOCK_NS or stamps.max() < first - CLOCK_NS:
        if odometry.by_log_time is None:
            notes.append("scans and odometry have different clocks; odometry not used")
            return None
        notes.append("scans and odometry have different clocks; matched by their recording times")
        return odometry.by_log_time.at(log_times)
    outside = int(np.count_nonzero((stamps < first - 10**8) | (stamps > last + 10**8)))
    if outside:
        notes.append(f"{outside} scans lie outside the odometry's time; its nearest pose is used")
    gap = int(np.diff(poses.stamps_ns).max(initial=0))
    if gap > 10**9:
        notes.append(f"odometry has a gap of {gap * 1e-9:.1f} s, interpolated")
    return poses.at(stamps)
