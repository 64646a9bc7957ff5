"""Single streams of a bag: poses, commands and particles; and a bag's contents."""

from __future__ import annotations

from collections.abc import Callable, Collection, Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass, field
from pathlib import Path
from typing import TypeVar

import numpy as np

from turtlebag.datasets.bags import decode
from turtlebag.datasets.bags.columns import POSES, Columns
from turtlebag.datasets.bags.decode import BadMessage, Cursor, yaws_of
from turtlebag.datasets.bags.source import open_bag
from turtlebag.datasets.bags.topics import Topic, Wanted
from turtlebag.datasets.errors import InputError
from turtlebag.datasets.findings import lines_of
from turtlebag.datasets.plurals import listed
from turtlebag.datasets.se2 import SE2, Array
from turtlebag.datasets.types import Stamps, Trajectory

Decoded = TypeVar("Decoded")

_TWISTS = {
    "geometry_msgs/msg/Twist": decode.twist,
    "geometry_msgs/msg/TwistStamped": decode.twist_stamped,
}
_JOINTS = "sensor_msgs/msg/JointState"
_ARRAYS = {"geometry_msgs/msg/PoseArray": decode.pose_array}


@dataclass(frozen=True, slots=True)
class TopicInfo:
    """One topic of a bag: its message count and the log times of the first and last message [ns]."""

    name: str
    msgtype: str
    count: int
    start_ns: int
    end_ns: int
    longest_gap_ns: int

    def rate_hz(self) -> float:
        """Mean rate; 0 for a single message."""
        span = self.end_ns - self.start_ns
        return (self.count - 1) * 1e9 / span if span > 0 else 0.0


@dataclass(frozen=True, slots=True)
class BagInfo:
    """What a bag holds, counted message by message."""

    path: Path
    kind: str
    files: tuple[Path, ...]
    topics: tuple[TopicInfo, ...]
    notes: tuple[str, ...]
    custom: Mapping[str, str] = field(default_factory=dict)

    @property
    def count(self) -> int:
        """Number of messages."""
        return sum(topic.count for topic in self.topics)

    @property
    def start_ns(self) -> int:
        """Log time of the first message."""
        return min((topic.start_ns for topic in self.topics), default=0)

    @property
    def end_ns(self) -> int:
        """Log time of the last message."""
        return max((topic.end_ns for topic in self.topics), default=0)

    def duration(self) -> float:
        """Span of the log times [s]."""
        return (self.end_ns - self.start_ns) * 1e-9


def read_poses(path: Path, topic: str) -> Trajectory:
    """Poses of an Odometry, PoseStamped or PoseWithCovarianceStamped topic, by header stamp, in file order.

    Damaged messages are left out. InputError when the topic is not there or of another type.
    """
    bag = open_bag(path)
    seen: dict[str, str] = {}
    columns: Columns | None = None
    for message in bag.messages(_wanted(topic, POSES, seen)):
        columns = columns or Columns(POSES[message.topic.msgtype], bag.cursor)
        columns.add(message.log_time_ns, message.data)
    if columns is None or not len((arrays := columns.arrays())[0]):
        raise InputError(f"{path}: {_missing(topic, seen, 'poses')}")
    stamps, _, _, numbers = arrays
    return Trajectory(stamps, SE2.from_array(np.column_stack([numbers[:, :2], yaws_of(numbers[:, 2:6])])))


def read_commands(path: Path) -> tuple[Stamps, Array, Array]:
    """Log times [ns], forward [m/s] and yaw speeds [rad/s] of /cmd_vel (Twist or TwistStamped)."""
    return _commands(_decoded(path, "/cmd_vel", _TWISTS, "commands"))


def read_drive(path: Path) -> tuple[tuple[Stamps, Array, Array] | None, Array | None]:
    """The commands of a bag, as `read_commands` has them, and the angles (n, joints) [rad] of /joint_states.

    These are of the joints that the first message names, in its order; None for what is not there.
    """
    bag, speeds, joints = open_bag(path), [], []

    def wanted(topic: Topic) -> bool:
        return (topic.name, topic.msgtype) == ("/joint_states", _JOINTS) or (
            topic.name == "/cmd_vel" and topic.msgtype in _TWISTS
        )

    for message in bag.messages(wanted):
        with suppress(BadMessage):
            cursor = bag.cursor(message.data)
            if message.topic.name == "/cmd_vel":
                speeds.append((message.log_time_ns, _TWISTS[message.topic.msgtype](cursor)))
            else:
                joints.append(decode.joint_state(cursor)[1:])
    rows = [angles for names, angles in joints if names == joints[0][0] and len(angles) == len(names) > 0]
    return _commands(speeds) if speeds else None, np.array(rows) if rows else None


def _commands(found: Sequence[tuple[int, tuple[float, float]]]) -> tuple[Stamps, Array, Array]:
    v, w = np.array([speeds for _, speeds in found]).T
    return np.array([time for time, _ in found], dtype=np.int64), v, w


def read_particles(path: Path) -> list[tuple[int, SE2]]:
    """(stamp [ns], poses (n,)) of each message of /particlecloud; may be empty."""
    found = _decoded(path, "/particlecloud", _ARRAYS)
    return [(stamp, SE2.from_array(rows)) for _, (stamp, rows) in found]


def _decoded(
    path: Path, topic: str, decoders: Mapping[str, Callable[[Cursor], Decoded]], needed: str = ""
) -> list[tuple[int, Decoded]]:
    """(log time, content) of a topic's intact messages; InputError without one where it is `needed`."""
    bag, found = open_bag(path), []
    seen: dict[str, str] = {}
    for message in bag.messages(_wanted(topic, decoders, seen)):
        with suppress(BadMessage):
            found.append((message.log_time_ns, decoders[message.topic.msgtype](bag.cursor(message.data))))
    if needed and not found:
        raise InputError(f"{path}: {_missing(topic, seen, needed)}")
    return found


def _wanted(topic: str, kinds: Collection[str], seen: dict[str, str]) -> Wanted:
    """Asks for a topic if it is of one of these types, and notes the types of all in `seen`."""

    def wanted(candidate: Topic) -> bool:
        seen[candidate.name] = candidate.msgtype
        return candidate.name == topic and candidate.msgtype in kinds

    return wanted


def _missing(topic: str, seen: dict[str, str], what: str) -> str:
    if topic in seen:
        return f"{topic} holds no {what} (its type is {seen[topic]})"
    return f"no {topic} in this bag; its topics: {listed(seen)}"


def bag_info(path: Path) -> BagInfo:
    """Topics, counts, rates and gaps, by reading every message."""
    bag = open_bag(path)
    times: dict[tuple[str, str], list[int]] = {}
    for message in bag.messages():
        times.setdefault((message.topic.name, message.topic.msgtype), []).append(message.log_time_ns)
    topics = []
    for (name, msgtype), stamps in sorted(times.items()):
        ordered = np.sort(np.array(stamps, dtype=np.int64))
        gap = int(np.diff(ordered).max(initial=0))
        topics.append(TopicInfo(name, msgtype, len(stamps), int(ordered[0]), int(ordered[-1]), gap))
    return BagInfo(path, bag.kind, tuple(bag.files), tuple(topics), lines_of(bag.findings), bag.custom_data())
