"""A bag as mapping and localisation see it: scans, odometry, the laser's place. Never truth."""

from __future__ import annotations

import numpy as np

from datasets.bags import decode
from datasets.bags.frames import FrameTree
from datasets.bags.scans import assemble, turned_over
from datasets.bags.source import TRUTH_PREFIX, Bag, Topic
from datasets.errors import InputError
from datasets.se2 import SE2, Array
from datasets.types import ImuLog, Recording, Stamps, Trajectory

SCAN, ODOMETRY = "sensor_msgs/msg/LaserScan", "nav_msgs/msg/Odometry"
TRANSFORMS = ("tf2_msgs/msg/TFMessage", "tf/msg/tfMessage")
IMU = "sensor_msgs/msg/Imu"
_WANTED = (SCAN, ODOMETRY, *TRANSFORMS, IMU)
_BASES = ("base_footprint", "base_link")


class _Streams:
    """Decoded messages by topic, with their log times."""

    def __init__(self) -> None:
        self.scans: dict[str, list[decode.RawScan]] = {}
        self.scan_times: dict[str, list[int]] = {}
        self.odometry: dict[str, list[decode.RawPose]] = {}
        self.odometry_times: dict[str, list[int]] = {}
        self.imu: dict[str, list[decode.RawImu]] = {}
        self.frames = FrameTree()
        self.seen: set[str] = set()
        self.bad = 0


def read_for_mapping(bag: Bag, *, T_base_lidar: SE2 | None = None) -> Recording:
    """Recording of a bag; InputError when it has no scan to map with."""
    streams = _read(bag)
    notes = bag.notes
    if streams.bad:
        notes.append(f"{streams.bad} damaged messages skipped")
    topic = _scan_topic(bag, streams)
    scans = streams.scans[topic]
    try:
        ranges, lidar = assemble(scans, notes)
    except ValueError as error:
        raise InputError(f"{bag.path}: {topic}: {error}; nothing to map with") from None
    stamps = np.array([scan.stamp_ns for scan in scans], dtype=np.int64)
    backwards = int(np.count_nonzero(np.diff(stamps) < 0))
    if backwards:
        notes.append(f"{topic}: stamps go back {backwards} times; file order kept")
    odometry, base = _odometry(streams, scans[0].frame, notes)
    if T_base_lidar is None:
        T_base_lidar, over = _laser_pose(streams.frames, base, scans[0].frame, notes)
        if over:
            ranges, lidar = turned_over(ranges, lidar)
            stamps = stamps - round((lidar.n_beams - 1) * lidar.time_increment * 1e9)
    log_times = np.array(streams.scan_times[topic], dtype=np.int64)
    return Recording(
        source=str(bag.path),
        stamps_ns=stamps,
        ranges=ranges,
        lidar=lidar,
        T_base_lidar=T_base_lidar,
        T_odom_base=_at_scans(odometry, streams, stamps, log_times, notes),
        odometry=odometry,
        imu=_imu(streams),
        notes=tuple(notes),
    )


def _read(bag: Bag) -> _Streams:
    """One pass over the bag."""
    streams = _Streams()

    def wanted(topic: Topic) -> bool:
        streams.seen.add(topic.name)
        return topic.msgtype in _WANTED and not topic.name.startswith(TRUTH_PREFIX)

    for topic, log_time, data in bag.messages(wanted):
        try:
            cursor = bag.cursor(data)
            name = topic.name
            if topic.msgtype == SCAN:
                streams.scans.setdefault(name, []).append(decode.laser_scan(cursor))
                streams.scan_times.setdefault(name, []).append(log_time)
            elif topic.msgtype == ODOMETRY:
                streams.odometry.setdefault(name, []).append(decode.odometry(cursor))
                streams.odometry_times.setdefault(name, []).append(log_time)
            elif topic.msgtype == IMU:
                streams.imu.setdefault(name, []).append(decode.imu(cursor))
            else:
                for transform in decode.transforms(cursor):
                    streams.frames.add(transform, static=name.endswith("tf_static"))
        except decode.BadMessage:
            streams.bad += 1
    return streams


def _scan_topic(bag: Bag, streams: _Streams) -> str:
    names = [name for name, scans in streams.scans.items() if scans]
    preferred = (
        [name for name in names if name == "/scan"] or [n for n in names if n.endswith("/scan")] or names
    )
    if len(preferred) == 1:
        return preferred[0]
    if names:
        raise InputError(
            f"{bag.path}: no /scan, and several LaserScan topics to choose from: {', '.join(names)}"
        )
    why = next((note for note in bag.notes if "damaged" in note or "cut off" in note), None)
    if why:
        raise InputError(f"{bag.path}: no /scan could be read: {why}")
    topics = ", ".join(sorted(streams.seen)[:12]) or "none"
    raise InputError(
        f"{bag.path}: no /scan (sensor_msgs/LaserScan) messages in this bag; its topics: {topics}"
    )


def _odometry(streams: _Streams, scan_frame: str, notes: list[str]) -> tuple[Trajectory | None, str]:
    """Full-rate odometry and the name of the base frame: from /odom, the only odometry topic, or /tf."""
    names = [name for name, poses in streams.odometry.items() if poses]
    chosen = "/odom" if "/odom" in names else (names[0] if len(names) == 1 else None)
    known = streams.frames.frames()
    default = next((frame for frame in _BASES if frame in known), "base_footprint")
    if chosen:
        poses = streams.odometry[chosen]
        base = poses[0].child or default
        stamps = np.array([pose.stamp_ns for pose in poses], dtype=np.int64)
        return _increasing(stamps, np.array([pose[3:6] for pose in poses]), chosen, notes), base
    if names:
        notes.append(f"several odometry topics and no /odom ({', '.join(names)}): /tf is used")
    for (parent, child), moving in streams.frames.moving.items():
        if parent == "odom" and (child == scan_frame or streams.frames.lookup(child, scan_frame) is not None):
            notes.append(f"odometry from /tf ({parent} -> {child})")
            stamps = np.array([transform.stamp_ns for transform in moving], dtype=np.int64)
            rows = [(t.xyz[0], t.xyz[1], decode.yaw_of(t.quaternion)) for t in moving]
            return _increasing(stamps, np.array(rows), "/tf", notes), child
    notes.append("no odometry: neither /odom nor odom -> base in /tf")
    return None, default


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


def _at_scans(
    odometry: Trajectory | None, streams: _Streams, stamps: Stamps, log_times: Stamps, notes: list[str]
) -> SE2 | None:
    """Odometry at the stamp of each scan."""
    if odometry is None:
        return None
    first, last = int(odometry.stamps_ns[0]), int(odometry.stamps_ns[-1])
    if stamps.min() > last + 10**9 or stamps.max() < first - 10**9:
        topic = "/odom" if "/odom" in streams.odometry else next(iter(streams.odometry), None)
        if topic is None or len(streams.odometry_times[topic]) != len(odometry):
            notes.append("scans and odometry carry different clocks; odometry not used")
            return None
        notes.append("scans and odometry carry different clocks; joined by the time they were recorded")
        times = np.array(streams.odometry_times[topic], dtype=np.int64)
        unique, index = np.unique(times, return_index=True)
        return Trajectory(unique, odometry.poses[index]).at(log_times)
    outside = int(np.count_nonzero((stamps < first - 10**8) | (stamps > last + 10**8)))
    if outside:
        notes.append(f"{outside} scans lie outside the odometry's time; its end poses are held")
    gap = int(np.diff(odometry.stamps_ns).max(initial=0))
    if gap > 10**9:
        notes.append(f"odometry has a gap of {gap * 1e-9:.1f} s, interpolated")
    return odometry.at(stamps)


def _imu(streams: _Streams) -> ImuLog | None:
    name = "/imu" if "/imu" in streams.imu else (next(iter(streams.imu)) if len(streams.imu) == 1 else None)
    if name is None:
        return None
    samples = streams.imu[name]
    return ImuLog(
        np.array([sample.stamp_ns for sample in samples], dtype=np.int64),
        np.array([sample.angular for sample in samples], dtype=np.float64),
        np.array([sample.linear for sample in samples], dtype=np.float64),
    )
