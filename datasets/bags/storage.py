"""The storage files of bags (mcap, ROS 1, sqlite3), each as an iterator of messages."""

from __future__ import annotations

import sqlite3
from collections.abc import Iterator
from contextlib import closing
from pathlib import Path
from typing import TYPE_CHECKING

from turtlebag.datasets.bags.mcap_sequential import McapReader
from turtlebag.datasets.bags.message import Message, Topic, Wanted, full_type
from turtlebag.datasets.bags.ros1_sequential import Ros1Reader
from turtlebag.datasets.bags.topics import metadata_text, qos_profiles
from turtlebag.datasets.errors import InputError

if TYPE_CHECKING:
    from rosbags.interfaces import Connection


def messages_of(
    path: Path, kind: str, wanted: Wanted | None, notes: list[str], *, step_over: bool
) -> Iterator[Message]:
    """Messages of the wanted topics of a file of that kind, in its order.

    Problems are appended to `notes`; damage ends the reading or, where that can be, is stepped over.
    """
    if kind == "sqlite3":
        yield from _sqlite3_messages(path, wanted, notes)
        return
    file = McapReader(path) if kind == "mcap" else Ros1Reader(path)
    yield from file.messages(wanted, step_over=step_over)
    _note_problems(path, file.state.problems, file.state.stopped, notes)


def _sqlite3_messages(path: Path, wanted: Wanted | None, notes: list[str]) -> Iterator[Message]:
    """sqlite3 storage, read by rosbags."""
    from rosbags.rosbag2 import Reader  # slow to import, and most bags are mcap

    count = 0
    try:
        _require_readable_qos(path)
        with Reader(path) as reader:
            topics = {connection.id: _sqlite3_topic(connection) for connection in reader.connections}
            chosen = [c for c in reader.connections if wanted is None or wanted(topics[c.id])]
            for connection, time, data in reader.messages(chosen) if chosen else ():
                yield Message(topics[connection.id], time, bytes(data))
                count += 1
    except (InputError, GeneratorExit):
        raise
    except Exception as error:
        # rosbags raises whatever its parsers stumble over: struct, key and type errors too.
        if not count:
            raise InputError(f"{path}: damaged bag ({one_line(error)}); fetch or record it again") from None
        _note_problems(path, [f"damaged after {count} messages ({one_line(error)})"], True, notes)
    else:
        with path.open("rb") as file:
            page = int.from_bytes(file.read(18)[16:], "big")
        if path.stat().st_size % (page if page > 1 else 1 << 16):  # SQLite takes what is missing for zeros
            notes.append(f"{path.name}: cut off inside its last page: messages may be missing or damaged")


def _require_readable_qos(path: Path) -> None:
    """yaml.YAMLError or ValueError unless rosbags, which reads it without a bound, can read what the topics
    offer."""
    with closing(sqlite3.connect(f"{path.absolute().as_uri()}?immutable=1", uri=True)) as file:
        if any(column[1] == "offered_qos_profiles" for column in file.execute("PRAGMA table_info(topics)")):
            for (qos,) in file.execute("SELECT offered_qos_profiles FROM topics"):
                qos_profiles(qos)


def one_line(error: Exception) -> str:
    """An error's message in one line, for a note."""
    return " ".join(str(error).split())[:120] or type(error).__name__


def _sqlite3_topic(connection: Connection) -> Topic:
    from rosbags.interfaces import ConnectionExtRosbag2
    from rosbags.rosbag2.metadata import dump_qos_v9

    qos = ""
    if isinstance(connection.ext, ConnectionExtRosbag2) and connection.ext.offered_qos_profiles:
        qos = metadata_text(dump_qos_v9(connection.ext.offered_qos_profiles))
    form, text = connection.msgdef.format.name.lower(), connection.msgdef.data
    return Topic(connection.topic, full_type(connection.msgtype), text, "ros2" + form, qos, connection.digest)


def _note_problems(path: Path, problems: list[str], stopped: bool, notes: list[str]) -> None:
    notes.extend(f"{path.name}: {problem}" for problem in problems)
    if stopped:
        notes.append(f"{path.name}: read up to there; `turtlebag bag recover` also saves what follows")
