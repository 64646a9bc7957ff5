"""The storage files of bags: mcap, ROS 1 and sqlite3, each giving its messages one after the other."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any, NamedTuple, Protocol

from turtlebag.datasets.bags.mcap_scan import McapChannel, McapScan
from turtlebag.datasets.bags.ros1_scan import Ros1Connection, Ros1Scan
from turtlebag.datasets.bags.topics import TOPICS, metadata_text
from turtlebag.datasets.errors import InputError

if TYPE_CHECKING:
    from rosbags.interfaces import Connection


@dataclass(frozen=True, slots=True)
class Topic:
    """A recorded topic: ROS 2 type name and, where the file has them, definition and quality of service."""

    name: str
    msgtype: str
    definition: str = ""
    definition_format: str = ""
    qos: str = ""
    type_hash: str = ""
    encoding: str = "cdr"


class Message(NamedTuple):
    """One message: its topic, log time [ns] and serialised bytes."""

    topic: Topic
    log_time_ns: int
    data: bytes


Wanted = Callable[[Topic], bool]


class BagFile(Protocol):
    """One storage file."""

    def messages(self, wanted: Wanted | None, notes: list[str], *, step_over: bool) -> Iterator[Message]:
        """Messages of the wanted topics in file order; problems are appended to `notes`."""


class _ScannedFile:
    """A file that is read front to back; `topic_of` says what one of its channels carries."""

    def __init__(self, scan: McapScan | Ros1Scan, topic_of: Callable[[Any], Topic]) -> None:
        self.scan, self._topic_of = scan, topic_of

    def messages(self, wanted: Wanted | None, notes: list[str], *, step_over: bool) -> Iterator[Message]:
        topics: dict[int, Topic] = {}

        def known(channel: object) -> Topic:
            if id(channel) not in topics:
                topics[id(channel)] = self._topic_of(channel)
            return topics[id(channel)]

        chosen = None if wanted is None else lambda channel: wanted(known(channel))
        for channel, time, data in self.scan.messages(chosen, step_over=step_over):
            yield Message(topics.get(id(channel)) or known(channel), time, data)
        _note_problems(self.scan.path, self.scan.state.problems, self.scan.state.stopped, notes)


def _mcap_topic(channel: McapChannel) -> Topic:
    schema, metadata = channel.schema, channel.metadata
    qos, type_hash = (metadata.get(key, "") for key in ("offered_qos_profiles", "topic_type_hash"))
    name = full_type(schema.name)
    return Topic(channel.topic, name, schema.text, schema.encoding, qos, type_hash, channel.encoding)


def _ros1_topic(connection: Ros1Connection) -> Topic:
    qos = metadata_text(TOPICS["/map"].qos()) if connection.latching else ""
    name = full_type(connection.msgtype)
    return Topic(connection.topic, name, connection.definition, "ros1msg", qos, "", "ros1")


class _Rosbag2File:
    """sqlite3 storage, read by rosbags."""

    def __init__(self, path: Path) -> None:
        self.path = path

    def messages(self, wanted: Wanted | None, notes: list[str], *, step_over: bool) -> Iterator[Message]:
        from rosbags.rosbag2 import Reader  # slow to import, and most bags are mcap

        count = 0
        try:
            with Reader(self.path) as reader:
                topics = {connection.id: self._topic(connection) for connection in reader.connections}
                chosen = [c for c in reader.connections if wanted is None or wanted(topics[c.id])]
                for connection, time, data in reader.messages(chosen) if chosen else ():
                    yield Message(topics[connection.id], time, bytes(data))
                    count += 1
        except (InputError, GeneratorExit):
            raise
        except Exception as error:
            # rosbags raises whatever its parsers stumble over: struct, key and type errors too.
            what = " ".join(str(error).split())[:120] or type(error).__name__
            if not count:
                raise InputError(f"{self.path}: damaged bag ({what}); fetch or record it again") from None
            _note_problems(self.path, [f"damaged after {count} messages ({what})"], True, notes)

    def _topic(self, connection: Connection) -> Topic:
        from rosbags.interfaces import ConnectionExtRosbag2
        from rosbags.rosbag2.metadata import dump_qos_v9

        qos = ""
        if isinstance(connection.ext, ConnectionExtRosbag2) and connection.ext.offered_qos_profiles:
            qos = metadata_text(dump_qos_v9(connection.ext.offered_qos_profiles))
        form, text = connection.msgdef.format.name.lower(), connection.msgdef.data
        return Topic(
            connection.topic, full_type(connection.msgtype), text, "ros2" + form, qos, connection.digest
        )


def _note_problems(path: Path, problems: list[str], stopped: bool, notes: list[str]) -> None:
    notes.extend(f"{path.name}: {problem}" for problem in problems)
    if stopped:
        notes.append(f"{path.name}: read up to there; `turtlebag bag recover` saves what comes after, too")


READERS: dict[str, Callable[[Path], BagFile]] = {
    "mcap": lambda path: _ScannedFile(McapScan(path), _mcap_topic),
    "ros1": lambda path: _ScannedFile(Ros1Scan(path), _ros1_topic),
    "sqlite3": _Rosbag2File,
}


def full_type(msgtype: str) -> str:
    """Type name with the middle part that ROS 1 leaves out."""
    parts = msgtype.split("/")
    return f"{parts[0]}/msg/{parts[1]}" if len(parts) == 2 else msgtype
