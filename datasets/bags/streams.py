"""Collect the messages of a bag that mapping may use, in one pass. Ground truth is not read."""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable
from dataclasses import dataclass
from typing import TypeVar

import numpy as np

from turtlebag.datasets.bags import decode
from turtlebag.datasets.bags.message import Topic
from turtlebag.datasets.bags.source import TRUTH_PREFIX, Bag
from turtlebag.datasets.bags.tf_frames import FrameTree
from turtlebag.datasets.bags.topics import CLOUD, IMU, MAPPED, ODOMETRY, SCAN, TOPICS, typestore
from turtlebag.datasets.se2 import Array
from turtlebag.datasets.types import ImuLog, Stamps

Decoded = TypeVar("Decoded")
Raw = list[tuple[int, bytes]]
"""Undecoded messages of one topic with their log times [ns]."""


@dataclass(frozen=True, eq=False, slots=True)
class OdometryColumns:
    """nav_msgs/Odometry of one topic: stamps and log times (n,), planar poses (n, 3), twists (n, 3) of the
    child frame [m/s, m/s, rad/s] and its name.

    If several robots or nodes write to it, only the most frequent frames are kept; `others` counts the rest
    by frame.
    """

    stamps_ns: Stamps
    log_times_ns: Stamps
    xyt: Array
    twists: Array
    child: str
    others: dict[str, int]


class Streams:
    """Decoded scans; all else is kept as bytes until needed.

    Point clouds are large: where a function to `note_cloud` is given, each is handed to it (topic, log
    time, bytes) and not kept.
    """

    def __init__(self, bag: Bag, *, note_cloud: Callable[[str, int, bytes], None] | None = None) -> None:
        self.bag = bag
        self._types = (*MAPPED, CLOUD) if note_cloud is not None else MAPPED
        self.scans: dict[str, list[tuple[int, decode.RawScan]]] = {}
        self.odometry: dict[str, Raw] = {}
        self.imu: dict[str, Raw] = {}
        self.frames = FrameTree()
        self.seen: dict[str, str] = {}
        self.bad = 0
        self._moving: Raw = []
        for topic, log_time, data in bag.messages(self._wanted):
            if topic.msgtype == SCAN:
                for pair in self._decoded([(log_time, data)], decode.laser_scan):
                    self.scans.setdefault(topic.name, []).append(pair)
            elif topic.msgtype == ODOMETRY:
                self.odometry.setdefault(topic.name, []).append((log_time, data))
            elif topic.msgtype == IMU:
                self.imu.setdefault(topic.name, []).append((log_time, data))
            elif topic.msgtype == CLOUD and note_cloud is not None:
                note_cloud(topic.name, log_time, data)
            elif topic.name.endswith("tf_static"):
                self._transforms([(log_time, data)], static=True)
            else:
                self._moving.append((log_time, data))

    def _wanted(self, topic: Topic) -> bool:
        self.seen[topic.name] = topic.msgtype
        return topic.msgtype in self._types and not topic.name.startswith(TRUTH_PREFIX)

    def note_left_out(self, notes: list[str]) -> None:
        """Name the transforms that are no places and the topics of no standard type; count the damaged."""
        for parent, child in sorted(self.frames.far):
            notes.append(f"the transform {parent} -> {child} is implausibly far away and left out")
        ours = {*MAPPED, *(topic.msgtype for topic in TOPICS.values())}
        others = {name: msgtype for name, msgtype in self.seen.items() if msgtype not in ours}
        # asked last: the definitions of all standard types take long to load
        unknown = [f"{name} ({kind})" for name, kind in others.items() if kind not in typestore().fielddefs]
        if unknown:
            notes.append(f"topics of unknown types skipped: {', '.join(sorted(unknown))}")
        if self.bad:
            notes.append(f"{self.bad} damaged messages skipped")

    def _transforms(self, raw: Raw, *, static: bool) -> None:
        for log_time, transforms in self._decoded(raw, decode.transforms):
            for transform in transforms:
                self.frames.add(transform._replace(log_time_ns=log_time), static=static)

    def follow_tf(self) -> None:
        """Decode /tf as well; needed only where topics and /tf_static do not say enough."""
        self._transforms(self._moving, static=False)
        self._moving = []

    def read_odometry(self, name: str) -> OdometryColumns:
        """Decoded poses of an odometry topic."""
        found = self._decoded(self.odometry[name], decode.odometry)
        links = Counter((pose.frame, pose.child) for _, pose in found)
        (main, _), *rest = links.most_common() or [(("", ""), 0)]
        ours = [(time, pose) for time, pose in found if (pose.frame, pose.child) == main]
        rows = np.array([(pose.x, pose.y, *pose.quaternion) for _, pose in ours]).reshape(-1, 6)
        return OdometryColumns(
            np.array([pose.stamp_ns for _, pose in ours], dtype=np.int64),
            np.array([time for time, _ in ours], dtype=np.int64),
            np.column_stack([rows[:, :2], decode.yaws_of(rows[:, 2:])]),
            np.array([pose.twist for _, pose in ours]).reshape(-1, 3),
            main[1],
            {f"{parent} -> {child}": count for (parent, child), count in rest},
        )

    def read_imu(self) -> ImuLog | None:
        """Samples of /imu or of the only IMU."""
        name = "/imu" if "/imu" in self.imu else next(iter(self.imu), None)
        if name is None or (name != "/imu" and len(self.imu) > 1):
            return None
        samples = [sample for _, sample in self._decoded(self.imu[name], decode.imu)]
        return ImuLog(
            np.array([sample.stamp_ns for sample in samples], dtype=np.int64),
            np.array([sample.angular for sample in samples], dtype=np.float64).reshape(-1, 3),
            np.array([sample.linear for sample in samples], dtype=np.float64).reshape(-1, 3),
        )

    def _decoded(self, raw: Raw, read: Callable[[decode.Cursor], Decoded]) -> list[tuple[int, Decoded]]:
        """The intact messages with their log times [ns]; the others are counted."""
        found = []
        for log_time, data in raw:
            try:
                found.append((log_time, read(self.bag.cursor(data))))
            except decode.BadMessage:
                self.bad += 1
        return found
