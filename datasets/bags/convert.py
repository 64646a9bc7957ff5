"""Between the kinds of recordings: ROS 1 .bag, rosbag2 in mcap or sqlite3, and CARMEN into rosbag2."""

from __future__ import annotations

from collections.abc import Callable, Collection
from pathlib import Path

from rosbags.rosbag1 import Writer as Writer1
from rosbags.rosbag2 import StoragePlugin
from rosbags.rosbag2 import Writer as Writer2
from rosbags.rosbag2.metadata import parse_qos

from datasets.bags.copying import (
    TopicCopier,
    Untranslatable,
    completed,
    is_latched,
    store_of,
    to_ros1,
    to_ros2,
)
from datasets.bags.folder import BagFolder
from datasets.bags.source import Bag, open_bag
from datasets.bags.storage import Message, Topic
from datasets.bags.writer import BagWriter
from datasets.errors import InputError
from datasets.types import Odometry, Recording, Twist

Skipped = dict[str, str]


def to_mcap(path: Path, folder: Path, *, exclude: Collection[str] = ()) -> tuple[int, list[str]]:
    """Copy a bag into a new rosbag2 folder with mcap storage; returns the message count and notes."""
    bag = open_bag(path)
    with BagFolder(folder, custom={}) as out:
        copier = TopicCopier(out)
        for message in bag.messages(_kept(exclude)):
            copier.write(message)
    return copier.count, _notes(bag, copier.skipped)


def to_sqlite3(path: Path, folder: Path, *, exclude: Collection[str] = ()) -> tuple[int, list[str]]:
    """Copy a bag into a new rosbag2 folder with sqlite3 storage; returns the message count and notes."""
    bag = open_bag(path)
    with Writer2(folder, version=9, storage_plugin=StoragePlugin.SQLITE3) as writer:

        def register(topic: Topic) -> Callable[[Message], None]:
            translate = None
            if topic.encoding == "ros1":
                topic, translate = to_ros2(topic)
            topic = completed(topic)
            if not topic.definition:
                raise Untranslatable(f"{topic.name}: the definition of {topic.msgtype} is not known")
            connection = writer.add_connection(
                topic.name,
                topic.msgtype,
                msgdef=topic.definition,
                rihs01=topic.type_hash or "RIHS01_" + "0" * 64,
                offered_qos_profiles=parse_qos(topic.qos),
            )

            def write(message: Message) -> None:
                data = translate(message.data) if translate else message.data
                writer.write(connection, message.log_time_ns, data)

            return write

        return _copy(bag, exclude, register)


def to_ros1_bag(path: Path, file: Path, *, exclude: Collection[str] = ()) -> tuple[int, list[str]]:
    """Copy a bag into a new ROS 1 .bag; returns the message count and notes."""
    bag = open_bag(path)
    with Writer1(file) as writer:

        def register(topic: Topic) -> Callable[[Message], None]:
            text, digest, translate = _as_ros1(topic)
            connection = writer.add_connection(
                topic.name,
                topic.msgtype,
                msgdef=text,
                md5sum=digest,
                latching=1 if is_latched(topic) else 0,
            )
            return lambda message: writer.write(connection, message.log_time_ns, translate(message.data))

        return _copy(bag, exclude, register)


def carmen_to_mcap(recording: Recording, folder: Path) -> tuple[int, list[str]]:
    """Write a CARMEN recording as a rosbag2 folder: /scan, /odom, /tf, /tf_static in file order."""
    count = 0
    x, y, yaw = recording.T_base_lidar.xyt.tolist()
    with BagWriter(folder, custom={"source": Path(recording.source).name}) as writer:
        first = int(recording.stamps_ns[0])
        writer.static_transforms(first, [("base_footprint", "base_scan", (x, y, 0.0), yaw)])
        for index in range(len(recording)):
            scan = recording.scan(index)
            if recording.T_odom_base is not None:
                writer.odometry(Odometry(scan.stamp_ns, recording.T_odom_base[index], Twist()))
                count += 2
            writer.scan(scan.stamp_ns, scan)
            count += 1
    return count + 1, list(recording.notes)


def _as_ros1(topic: Topic) -> tuple[str, str, Callable[[bytes], bytes]]:
    if topic.encoding != "ros1":
        return to_ros1(topic)
    store = store_of(topic, ros2_header=False)
    return topic.definition, store.generate_msgdef(topic.msgtype)[1], lambda data: data


def _kept(exclude: Collection[str]) -> Callable[[Topic], bool]:
    return lambda topic: topic.name not in exclude


def _copy(
    bag: Bag, exclude: Collection[str], register: Callable[[Topic], Callable[[Message], None]]
) -> tuple[int, list[str]]:
    """Write every kept message through what `register` returns for its topic."""
    writers: dict[tuple[str, str], Callable[[Message], None] | None] = {}
    skipped: Skipped = {}
    count = 0
    for message in bag.messages(_kept(exclude)):
        key = message.topic.name, message.topic.msgtype
        if key not in writers:
            try:
                writers[key] = register(message.topic)
            except Untranslatable as error:
                writers[key], skipped[message.topic.name] = None, str(error)
        write = writers[key]
        if write:
            write(message)
            count += 1
    return count, _notes(bag, skipped)


def _notes(bag: Bag, skipped: Skipped) -> list[str]:
    return [*bag.notes, *(f"skipped {text}" for text in skipped.values())]


def require_messages(path: Path, count: int, notes: list[str]) -> None:
    """InputError when nothing was copied."""
    if not count:
        raise InputError(f"{path}: no message could be converted ({'; '.join(notes) or 'the bag is empty'})")
