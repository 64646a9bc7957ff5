"""The messages of a bag that mapping and `bag doctor` read, collected in one pass."""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from typing import TypeVar

import numpy as np

from turtlebag.datasets.bags import decode
from turtlebag.datasets.bags.columns import POSES, SAMPLES, Columns
from turtlebag.datasets.bags.frames import FrameTree
from turtlebag.datasets.bags.source import TRUTH_PREFIX, Bag
from turtlebag.datasets.bags.stamps import check_order
from turtlebag.datasets.bags.topics import (
    CLOUD,
    IMU,
    JOINTS,
    MAPPED,
    ODOMETRY,
    SCAN,
    TOPICS,
    TRANSFORMS,
    Topic,
    typestore,
)
from turtlebag.datasets.findings import Finding
from turtlebag.datasets.plurals import counted, listed
from turtlebag.datasets.se2 import Array
from turtlebag.datasets.types import ImuLog, Stamps

Decoded = TypeVar("Decoded")
Raw = list[tuple[int, bytes]]
"""Undecoded messages of one topic with their log times [ns]."""
Timed = list[tuple[int, Decoded]]


@dataclass(frozen=True, eq=False, slots=True)
class OdometryColumns:
    """nav_msgs/Odometry of one topic: stamps and log times (n,), planar poses (n, 3), twists (n, 3) of the
    child frame [m/s, m/s, rad/s] and its name.

    If several robots or nodes write to it, only the most frequent frames are kept; `links` counts the
    messages of each.
    """

    stamps_ns: Stamps
    log_times_ns: Stamps
    xyt: Array
    twists: Array
    child: str
    links: Counter[tuple[str, ...]]


class Contents:
    """Decoded scans; all else is kept as bytes until needed, and then decoded once.

    Point clouds are large: where a function to `note_cloud` is given, each is handed to it (topic, log time,
    bytes) and not kept. Ground truth is not read; `bag doctor`, which wants `everything`, has it in `others`,
    with joint states.
    """

    def __init__(
        self,
        bag: Bag,
        *,
        note_cloud: Callable[[str, int, bytes], None] | None = None,
        everything: bool = False,
    ) -> None:
        self.bag = bag
        self.scans: dict[str, Timed[decode.RawScan]] = {}
        self.odometry: dict[str, Columns] = {}
        self.imu: dict[str, Columns] = {}
        self.others: dict[str, Raw] = {}
        self.frames = FrameTree()
        self.types: dict[str, dict[str, Topic]] = {}
        """The topics of each name by their type."""
        self._everything = everything
        self._note_cloud = note_cloud
        self._damaged: dict[str, Finding] = {}
        self._moving: dict[str, Raw] = {}
        raw_scans: dict[str, Raw] = {}
        static: dict[str, Raw] = {}
        for topic, log_time, data in bag.messages(self._wanted):
            raw = (log_time, data)
            if topic.name.startswith(TRUTH_PREFIX) or topic.msgtype == JOINTS:
                self.others.setdefault(topic.name, []).append(raw)
            elif topic.msgtype == SCAN:
                raw_scans.setdefault(topic.name, []).append(raw)
            elif topic.msgtype == ODOMETRY:
                if topic.name not in self.odometry:
                    self.odometry[topic.name] = Columns(POSES[ODOMETRY], bag.cursor)
                self.odometry[topic.name].add(*raw)
            elif topic.msgtype == IMU:
                if topic.name not in self.imu:
                    self.imu[topic.name] = Columns(SAMPLES, bag.cursor)
                self.imu[topic.name].add(*raw)
            elif topic.msgtype == CLOUD and note_cloud is not None:
                note_cloud(topic.name, log_time, data)
            elif topic.msgtype in TRANSFORMS:
                links = static if topic.name.endswith("tf_static") else self._moving
                links.setdefault(topic.name, []).append(raw)
        for name, messages in raw_scans.items():
            if scans := self._decoded(name, messages, decode.laser_scan):
                self.scans[name] = scans
        self._transforms(static, static=True)

    def _wanted(self, topic: Topic) -> bool:
        self.types.setdefault(topic.name, {})[topic.msgtype] = topic
        if self._everything:
            return True
        read = topic.msgtype in MAPPED or (topic.msgtype == CLOUD and self._note_cloud is not None)
        return read and not topic.name.startswith(TRUTH_PREFIX)

    def read_headers(self, name: str) -> tuple[Stamps, Stamps]:
        """Stamps and log times [ns] of one of the `others`."""
        headers = self._decoded(name, self.others[name], decode.header)
        stamps = np.array([stamp for _, (stamp, _) in headers], dtype=np.int64)
        return stamps, np.array([time for time, _ in headers], dtype=np.int64)

    def _transforms(self, topics: dict[str, Raw], *, static: bool) -> None:
        for name, raw in topics.items():
            for log_time, transforms in self._decoded(name, raw, decode.transforms):
                for transform in transforms:
                    self.frames.add(transform._replace(log_time_ns=log_time), static=static)

    def follow_tf(self) -> None:
        """Decode /tf as well; needed only where topics and /tf_static do not say enough."""
        self._transforms(self._moving, static=False)
        self._moving = {}

    def read_odometry(self, name: str) -> OdometryColumns:
        """Decoded poses of an odometry topic."""
        columns = self.odometry[name]
        stamps, times, at, numbers = self._read(name, columns)
        counts = np.bincount(at, minlength=len(columns.texts)).tolist()
        links = Counter(dict(zip(columns.texts, counts, strict=True)))
        main = links.most_common(1)[0][0] if links else ("", "")
        ours = np.array([texts == main for texts in columns.texts], dtype=bool)[at]
        poses = np.column_stack([numbers[:, :2], decode.yaws_of(numbers[:, 2:6])])
        return OdometryColumns(stamps[ours], times[ours], poses[ours], numbers[ours, 6:], main[1], links)

    def read_imu(self, findings: list[Finding]) -> ImuLog | None:
        """Samples of /imu or of the only IMU."""
        name = "/imu" if "/imu" in self.imu else next(iter(self.imu), None)
        if name is None or (name != "/imu" and len(self.imu) > 1):
            return None
        stamps, times, _, numbers = self._read(name, self.imu[name])
        findings += check_order(name, stamps, times)
        return ImuLog(stamps, numbers[:, :3], numbers[:, 3:])

    def imu_times(self, name: str) -> tuple[Stamps, Stamps]:
        """Stamps and log times [ns] of the intact samples of an IMU."""
        return self._read(name, self.imu[name])[:2]

    def _read(self, name: str, columns: Columns) -> tuple[Stamps, Stamps, Stamps, Array]:
        """The arrays of a topic's intact messages; the others become a finding."""
        arrays = columns.arrays()
        if columns.damaged:
            self.note_damaged(name, columns.damaged, len(arrays[0]) + len(columns.damaged))
        return arrays

    def _decoded(self, name: str, raw: Raw, read: Callable[[decode.Cursor], Decoded]) -> Timed[Decoded]:
        """The intact messages of a topic with their log times [ns]; the others become a finding."""
        intact, damaged = [], []
        for log_time, data in raw:
            try:
                intact.append((log_time, read(self.bag.cursor(data))))
            except decode.BadMessage:
                damaged.append(log_time)
        if damaged:
            self.note_damaged(name, damaged, len(raw))
        return intact

    def note_damaged(self, name: str, log_times: list[int], total: int) -> None:
        """Note that of all messages of a topic, those of some log times [ns] cannot be decoded."""
        what = f"{len(log_times)} of {counted(total, 'message')} cannot be decoded"
        self._damaged[name] = Finding("damaged messages", name, what, len(log_times), log_times[0], "skipped")

    def findings(self) -> Iterator[Finding]:
        """What is wrong with what has been decoded so far, and which topics cannot be."""
        yield from self._damaged.values()
        yield from self.frames.findings()
        for name, types in self.types.items():
            if len(types) > 1:
                what = f"messages of {len(types)} types: {', '.join(sorted(types))}"
                yield Finding("two types", name, what, len(types))
        ours = {*MAPPED, *(topic.msgtype for topic in TOPICS.values())}
        others = {name: kind for name, types in self.types.items() for kind in types if kind not in ours}
        # asked last: the definitions of all standard types take long to load
        unknown = [f"{name} ({kind})" for name, kind in others.items() if kind not in typestore().fielddefs]
        if unknown:
            what = f"topics of unknown types: {listed(unknown)}"
            yield Finding("unknown types", "", what, len(unknown), remedy="skipped")
