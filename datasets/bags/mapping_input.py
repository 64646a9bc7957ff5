"""A bag as mapping and localisation see it: scans, odometry, the laser's place. Never truth."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from datasets.bags import decode
from datasets.bags.frames import FrameTree
from datasets.bags.scans import assemble, turned_over
from datasets.bags.source import Bag
from datasets.bags.streams import Streams
from datasets.errors import InputError
from datasets.se2 import SE2, Array
from datasets.types import Recording, Stamps, Trajectory

_BASES = ("base_footprint", "base_link")
_CLOCK_NS = 1_000_000_000
"""Scans this far outside the odometry's time are taken to carry another clock."""


@dataclass(frozen=True, eq=False, slots=True)
class _Source:
    """Where the odometry comes from: its poses by stamp, by log time, and the frame they move."""

    base: str
    poses: Trajectory | None = None
    by_log_time: Trajectory | None = None


def read_for_mapping(bag: Bag, *, T_base_lidar: SE2 | None = None) -> Recording:
    """Recording of a bag; InputError when it has no scan to map with."""
    streams = Streams(bag)
    notes = bag.notes
    topic = _scan_topic(streams)
    scans = streams.scans[topic]
    try:
        ranges, lidar = assemble(scans, notes)
    except ValueError as error:
        raise InputError(f"{bag.path}: {topic}: {error}; nothing to map with") from None
    stamps = np.array([scan.stamp_ns for scan in scans], dtype=np.int64)
    backwards = int(np.count_nonzero(np.diff(stamps) < 0))
    if backwards:
        notes.append(f"{topic}: stamps go back {backwards} times; file order kept")
    odometry = _odometry(streams, scans[0].frame, notes)
    if T_base_lidar is None:
        T_base_lidar, over = _laser_pose(streams.frames, odometry.base, scans[0].frame, notes)
        if over:
            ranges, lidar = turned_over(ranges, lidar)
            stamps = stamps - round((lidar.n_beams - 1) * lidar.time_increment * 1e9)
    log_times = np.array(streams.scan_times[topic], dtype=np.int64)
    T_odom_base = _at_scans(odometry, stamps, log_times, notes)
    imu = streams.read_imu()
    if streams.bad:
        notes.append(f"{streams.bad} damaged messages skipped")
    return Recording(
        source=str(bag.path),
        stamps_ns=stamps,
        ranges=ranges,
        lidar=lidar,
        T_base_lidar=T_base_lidar,
        T_odom_base=T_odom_base,
        odometry=odometry.poses,
        imu=imu,
        notes=tuple(notes),
    )


def _scan_topic(streams: Streams) -> str:
    path, names = streams.bag.path, list(streams.scans)
    preferred = (
        [name for name in names if name == "/scan"] or [n for n in names if n.endswith("/scan")] or names
    )
    if len(preferred) == 1:
        return preferred[0]
    if names:
        raise InputError(f"{path}: no /scan, and several LaserScan topics to choose from: {', '.join(names)}")
    why = next((note for note in streams.bag.notes if "damaged" in note or "cut off" in note), None)
    if why:
        raise InputError(f"{path}: no /scan could be read: {why}")
    topics = ", ".join(sorted(streams.seen)[:12]) or "none"
    raise InputError(f"{path}: no /scan (sensor_msgs/LaserScan) messages in this bag; its topics: {topics}")


def _odometry(streams: Streams, scan_frame: str, notes: list[str]) -> _Source:
    """Odometry from /odom, from the only odometry topic, or from /tf."""
    names = list(streams.odometry)
    chosen = "/odom" if "/odom" in names else (names[0] if len(names) == 1 else None)
    if chosen:
        columns = streams.read_odometry(chosen)
        if len(columns.stamps_ns):
            if streams.frames.lookup(columns.child, scan_frame) is None:
                streams.follow_tf()
            times = np.array(streams.odometry[chosen].times, dtype=np.int64)[columns.kept]
            return _Source(
                columns.child or _base_of(streams.frames),
                _increasing(columns.stamps_ns, columns.xyt, chosen, notes),
                _increasing(times, columns.xyt, chosen, []),
            )
    if len(names) > 1:
        notes.append(f"several odometry topics and no /odom ({', '.join(names)}): /tf is used")
    streams.follow_tf()
    for (parent, child), moving in streams.frames.moving.items():
        if parent == "odom" and (child == scan_frame or streams.frames.lookup(child, scan_frame) is not None):
            notes.append(f"odometry from /tf ({parent} -> {child})")
            stamps = np.array([transform.stamp_ns for transform in moving], dtype=np.int64)
            rows = np.array([(t.xyz[0], t.xyz[1], decode.yaw_of(t.quaternion)) for t in moving])
            return _Source(child, _increasing(stamps, rows, "/tf", notes))
    notes.append("no odometry: neither /odom nor odom -> base in /tf")
    return _Source(_base_of(streams.frames))


def _base_of(frames: FrameTree) -> str:
    known = frames.frames()
    return next((frame for frame in _BASES if frame in known), _BASES[0])


def _increasing(stamps: Stamps, xyt: Array, name: str, notes: list[str]) -> Trajectory | None:
    """Poses in order of their stamps, each stamp once, finite."""
    finite = np.isfinite(xyt).all(axis=1)
    if not finite.all():
        notes.append(f"{name}: {np.count_nonzero(~finite)} poses are not finite and left out")
        stamps, xyt = stamps[finite], xyt[finite]
    if not len(stamps):
        return None
    backwards = int(np.count_nonzero(np.diff(stamps) < 0))
    if backwards:
        notes.append(f"{name}: stamps go back {backwards} times; sorted")
    stamps, first = np.unique(stamps, return_index=True)
    return Trajectory(stamps, SE2.from_array(xyt[first]))


def _laser_pose(frames: FrameTree, base: str, scan_frame: str, notes: list[str]) -> tuple[SE2, bool]:
    """Planar pose of the laser on the robot and whether it hangs upside down."""
    if scan_frame == base:
        return SE2.identity(), False
    T = frames.lookup(base, scan_frame)
    if T is None:
        for other in _BASES:
            T = frames.lookup(other, scan_frame) if T is None else T
    if T is None:
        notes.append(f"no transform {base} -> {scan_frame}: the laser is taken to sit at the robot's centre")
        return SE2.identity(), False
    up = float(T[2, 2])
    if abs(up) < 0.98:
        notes.append(f"the laser is tilted by {np.degrees(np.arccos(np.clip(abs(up), 0, 1))):.0f} degrees")
    if up < 0.0:
        notes.append("the laser hangs upside down; its scans were turned over")
    return SE2.from_xyt(T[0, 3], T[1, 3], np.arctan2(T[1, 0], T[0, 0])), up < 0.0


def _at_scans(odometry: _Source, stamps: Stamps, log_times: Stamps, notes: list[str]) -> SE2 | None:
    """Odometry at the stamp of each scan."""
    poses = odometry.poses
    if poses is None:
        return None
    first, last = int(poses.stamps_ns[0]), int(poses.stamps_ns[-1])
    if stamps.min() > last + _CLOCK_NS or stamps.max() < first - _CLOCK_NS:
        if odometry.by_log_time is None:
            notes.append("scans and odometry carry different clocks; odometry not used")
            return None
        notes.append("scans and odometry carry different clocks; joined by the time they were recorded")
        return odometry.by_log_time.at(log_times)
    outside = int(np.count_nonzero((stamps < first - 10**8) | (stamps > last + 10**8)))
    if outside:
        notes.append(f"{outside} scans lie outside the odometry's time; its end poses are held")
    gap = int(np.diff(poses.stamps_ns).max(initial=0))
    if gap > 10**9:
        notes.append(f"odometry has a gap of {gap * 1e-9:.1f} s, interpolated")
    return poses.at(stamps)
