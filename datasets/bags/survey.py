"""One pass over a bag that collects the data for `bag doctor`."""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable
from dataclasses import dataclass, field
from pathlib import Path
from typing import Literal

import numpy as np
from numpy.typing import NDArray

from turtlebag.datasets.bags import decode
from turtlebag.datasets.bags.message import Topic
from turtlebag.datasets.bags.source import Bag, open_bag
from turtlebag.datasets.bags.tf_frames import BASES, FrameTree
from turtlebag.datasets.bags.topics import IMU, ODOMETRY, SCAN, TRANSFORMS

_SOME = 200


@dataclass(frozen=True, slots=True)
class Finding:
    """One defect: severity, check, observation and consequence."""

    severity: Literal["error", "warning"]
    check: str
    what: str
    breaks: str


@dataclass(slots=True)
class TopicSurvey:
    """Times of one topic and, where its type is known, what the headers say."""

    topic: Topic
    log_times: list[int] = field(default_factory=list)
    stamps: list[int] = field(default_factory=list)
    places: list[tuple[float, float]] = field(default_factory=list)
    frames: Counter[str] = field(default_factory=Counter)
    children: Counter[str] = field(default_factory=Counter)
    undecodable: int = 0


@dataclass(slots=True)
class ScanSurvey:
    """Geometry and content of the scans of one topic."""

    geometries: Counter[tuple[tuple[float, ...], int]] = field(default_factory=Counter)
    readings: int = 0
    zeros: int = 0
    all_nan: int = 0
    no_return: int = 0
    some: list[NDArray[np.float32]] = field(default_factory=list)
    """The first scans, to tell their unit by."""


@dataclass(slots=True)
class Survey:
    """Everything gathered from a bag."""

    path: Path
    kind: str
    topics: dict[str, TopicSurvey] = field(default_factory=dict)
    scans: dict[str, ScanSurvey] = field(default_factory=dict)
    frames: FrameTree = field(default_factory=FrameTree)
    parents: dict[str, set[str]] = field(default_factory=dict)
    link_stamps: dict[tuple[str, str], list[int]] = field(default_factory=dict)
    bad_rotations: Counter[str] = field(default_factory=Counter)
    notes: list[str] = field(default_factory=list)

    def of_type(self, *msgtypes: str) -> list[TopicSurvey]:
        """Topics of the given types."""
        return [topic for topic in self.topics.values() if topic.topic.msgtype in msgtypes]

    def base(self) -> str:
        """The robot's base frame, if the bag contains it."""
        odometry = [topic for topic in self.of_type(ODOMETRY) if topic.topic.name == "/odom"]
        child = odometry[0].children.most_common(1)[0][0] if odometry and odometry[0].children else ""
        return child if child in self.frames.frames() else self.frames.base(child or BASES[0])


def survey(path: Path) -> Survey:
    """Read the whole bag once; InputError when it cannot be opened."""
    bag = open_bag(path)
    found = Survey(path, bag.kind)
    for message in bag.messages():
        name = message.topic.name
        topic = found.topics.get(name)
        if topic is None:
            topic = found.topics[name] = TopicSurvey(message.topic)
        topic.log_times.append(message.log_time_ns)
        examine = _EXAMINERS.get(message.topic.msgtype)
        if examine:
            try:
                examine(found, topic, bag, message.data)
            except decode.BadMessage:
                topic.undecodable += 1
    found.notes = bag.notes
    return found


def _scan(found: Survey, topic: TopicSurvey, bag: Bag, data: bytes) -> None:
    scan = decode.laser_scan(bag.cursor(data))
    topic.stamps.append(scan.stamp_ns)
    topic.frames[scan.frame] += 1
    summary = found.scans.setdefault(topic.topic.name, ScanSurvey())
    summary.geometries[scan.geometry, len(scan.ranges)] += 1
    summary.readings += len(scan.ranges)
    if len(summary.some) < _SOME:
        summary.some.append(scan.ranges)
    summary.zeros += int(np.count_nonzero(scan.ranges == 0.0))
    if np.isnan(scan.ranges).all():
        summary.all_nan += 1
    elif not (np.isfinite(scan.ranges) & (scan.ranges > 0.0)).any():
        summary.no_return += 1


def _odometry(found: Survey, topic: TopicSurvey, bag: Bag, data: bytes) -> None:
    pose = decode.odometry(bag.cursor(data))
    topic.stamps.append(pose.stamp_ns)
    topic.frames[pose.frame] += 1
    topic.children[pose.child] += 1
    topic.places.append((pose.x, pose.y))
    if not np.isfinite(pose.yaw):
        found.bad_rotations[topic.topic.name] += 1


def _imu(found: Survey, topic: TopicSurvey, bag: Bag, data: bytes) -> None:
    sample = decode.imu(bag.cursor(data))
    topic.stamps.append(sample.stamp_ns)
    topic.frames[sample.frame] += 1


def _joints(found: Survey, topic: TopicSurvey, bag: Bag, data: bytes) -> None:
    topic.stamps.append(decode.joint_state(bag.cursor(data))[0])


def _transforms(found: Survey, topic: TopicSurvey, bag: Bag, data: bytes) -> None:
    static = topic.topic.name.endswith("tf_static")
    for transform in decode.transforms(bag.cursor(data)):
        norm = float(np.linalg.norm(transform.quaternion))
        if not abs(norm - 1.0) < 0.01:
            found.bad_rotations[topic.topic.name] += 1
        found.frames.add(transform, static=static)
        found.parents.setdefault(transform.child, set()).add(transform.parent)
        if not static:
            topic.stamps.append(transform.stamp_ns)
            found.link_stamps.setdefault((transform.parent, transform.child), []).append(transform.stamp_ns)


_EXAMINERS: dict[str, Callable[[Survey, TopicSurvey, Bag, bytes], None]] = {
    SCAN: _scan,
    ODOMETRY: _odometry,
    IMU: _imu,
    "sensor_msgs/msg/JointState": _joints,
    **dict.fromkeys(TRANSFORMS, _transforms),
}
