"""A bag as input of mapping and localisation: scans, odometry, the laser's pose. Never ground truth."""

from __future__ import annotations

from collections import Counter

import numpy as np

from turtlebag.datasets.bags.decode import RawScan
from turtlebag.datasets.bags.odometry import find_odometry, in_file_order, odometry_at, sensor_matrix
from turtlebag.datasets.bags.plausibility import stands_still
from turtlebag.datasets.bags.scans import TURNED_OVER, assemble, turned_over
from turtlebag.datasets.bags.source import Bag
from turtlebag.datasets.bags.streams import Streams
from turtlebag.datasets.bags.topics import CLOUD, SCAN, way_out
from turtlebag.datasets.errors import InputError
from turtlebag.datasets.se2 import SE2, Array
from turtlebag.datasets.types import Recording, Stamps


class NoScans(InputError):
    """The bag has no planar scans to map with; `clouds` names point cloud topics that would do."""

    def __init__(self, message: str, clouds: list[str]) -> None:
        super().__init__(message)
        self.clouds = clouds


def read_for_mapping(bag: Bag, *, T_base_lidar: SE2 | None = None, topic: str | None = None) -> Recording:
    """Recording of a bag; InputError (NoScans) when it has no scan to map with.

    `topic` chooses among its LaserScan topics; without it /scan, or the only one.
    """
    streams = Streams(bag)
    notes = bag.notes
    topic = _scan_topic(streams, topic)
    scans, log_times = _of_one_laser(topic, streams.scans[topic], notes)
    try:
        ranges, lidar = assemble(scans, notes)
    except ValueError as error:
        raise InputError(f"{bag.path}: {topic}: {error}; there is nothing to map") from None
    stamps = in_file_order([scan.stamp_ns for scan in scans], log_times, topic, notes)
    if stands_still(stamps):
        what = f"{topic}: all scans have the same stamp and the same recording time"
        raise InputError(f"{bag.path}: {what}; without times no map can be made")
    odometry = find_odometry(streams, scans[0].frame, notes)
    if T_base_lidar is None:
        T_base_lidar, over = _planar(
            sensor_matrix(bag.path, streams.frames, odometry.base, scans[0].frame, notes), notes
        )
        if over:
            lidar = turned_over(lidar)
    T_odom_base = odometry_at(odometry, stamps, log_times, notes)
    imu = streams.read_imu()
    streams.note_left_out(notes)
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


def _of_one_laser(
    topic: str, found: list[tuple[int, RawScan]], notes: list[str]
) -> tuple[list[RawScan], Stamps]:
    """The scans of the most frequent frame and their log times: two lasers do not sit at one place."""
    (main, count), *others = Counter(scan.frame for _, scan in found).most_common()
    if others:
        left = ", ".join(f"{number} of '{name}'" for name, number in others)
        notes.append(f"{topic}: scans of several lasers; {count} of '{main}' used, {left} left out")
    ours = [(time, scan) for time, scan in found if scan.frame == main]
    return [scan for _, scan in ours], np.array([time for time, _ in ours], dtype=np.int64)


def _scan_topic(streams: Streams, wanted: str | None) -> str:
    path, names = streams.bag.path, list(streams.scans)
    if wanted is not None:
        return _wanted_topic(streams, wanted)
    preferred = (
        [name for name in names if name == "/scan"] or [n for n in names if n.endswith("/scan")] or names
    )
    if len(preferred) == 1:
        return preferred[0]
    if names:
        listed = ", ".join(names)
        raise InputError(f"{path}: no /scan, and several LaserScan topics; choose one with --topic: {listed}")
    why = next((note for note in streams.bag.notes if "damaged" in note or "cut off" in note), None)
    if why:
        raise InputError(f"{path}: no /scan could be read: {why}")
    topics = way_out(streams.seen) or f"its topics: {', '.join(sorted(streams.seen)[:12]) or 'none'}"
    message = f"{path}: no /scan (sensor_msgs/LaserScan) messages in this bag; {topics}"
    raise NoScans(message, [name for name, msgtype in streams.seen.items() if msgtype == CLOUD])


def _wanted_topic(streams: Streams, wanted: str) -> str:
    if wanted in streams.scans:
        return wanted
    msgtype = streams.seen.get(wanted)
    found = "not in this bag" if msgtype is None else f"of type {msgtype}"
    if msgtype == SCAN:
        found = "without a readable message"
    topics = f"its topics: {', '.join(sorted(streams.seen)[:12]) or 'none'}"
    told = way_out({wanted: msgtype} if msgtype is not None else {}) or topics
    message = f"{streams.bag.path}: --topic {wanted} is {found}; {told}"
    raise NoScans(message, [wanted] if msgtype == CLOUD else [])


def _planar(T_base_lidar: Array, notes: list[str]) -> tuple[SE2, bool]:
    """Planar pose of the laser on the robot and whether it hangs upside down."""
    T, up = T_base_lidar, float(T_base_lidar[2, 2])
    if abs(up) < 0.98:
        notes.append(f"the laser is tilted by {np.degrees(np.arccos(np.clip(abs(up), 0, 1))):.0f} degrees")
    if up < 0.0:
        notes.append(TURNED_OVER)
    return SE2.from_xyt(T[0, 3], T[1, 3], np.arctan2(T[1, 0], T[0, 0])), up < 0.0
