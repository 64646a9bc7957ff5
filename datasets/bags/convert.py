"""Convert recordings to rosbag2 (mcap or sqlite3): bags of ROS 1 and 2, and CARMEN logs."""

from __future__ import annotations

import sqlite3
from functools import partial
from pathlib import Path
from typing import Any, cast

from rosbags.rosbag2 import StoragePlugin, Writer
from rosbags.rosbag2.metadata import parse_qos

from turtlebag.datasets.bags.copying import Copier, Untranslatable, Write, as_ros2, into_mcap
from turtlebag.datasets.bags.folder import BagFolder
from turtlebag.datasets.bags.selection import EVERYTHING, Selection
from turtlebag.datasets.bags.source import Bag, open_bag
from turtlebag.datasets.bags.topics import Topic, qos_profiles
from turtlebag.datasets.bags.writer import BagWriter
from turtlebag.datasets.errors import InputError
from turtlebag.datasets.types import Odometry, Recording, Twist


def to_mcap(path: Path, folder: Path, selection: Selection = EVERYTHING) -> tuple[int, list[str]]:
    """Copy a bag into a new rosbag2 folder with mcap storage; returns the message count and notes."""
    bag = open_bag(path)
    with BagFolder(folder, custom=bag.custom_data()) as out:
        return _copied(bag, into_mcap(out), selection)


def to_sqlite3(path: Path, folder: Path, selection: Selection = EVERYTHING) -> tuple[int, list[str]]:
    """Copy a bag into a new rosbag2 folder with sqlite3 storage; returns the message count and notes."""
    bag = open_bag(path)
    try:
        with Writer(folder, version=9, storage_plugin=StoragePlugin.SQLITE3) as writer:
            for key, value in bag.custom_data().items():
                writer.set_custom_data(key, value)
            return _copied(bag, Copier(partial(_register, writer)), selection)
    except sqlite3.Error as error:  # SQLite's words for a full disk
        raise InputError(f"{folder}: cannot be written ({error})") from None


def _register(writer: Writer, topic: Topic) -> Write:
    topic, translate = as_ros2(topic)
    if not topic.definition or topic.encoding != "cdr":
        raise Untranslatable(f"{topic.name}: {topic.msgtype} has no definition, or is not CDR")
    connection = writer.add_connection(
        topic.name,
        topic.msgtype,
        msgdef=topic.definition,
        rihs01=topic.type_hash or "RIHS01_" + "0" * 64,
        offered_qos_profiles=parse_qos(cast(Any, qos_profiles(topic.qos))),
    )
    return lambda message: writer.write(connection, message.log_time_ns, translate(message.data))


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


def _copied(bag: Bag, copier: Copier, selection: Selection) -> tuple[int, list[str]]:
    for message in selection.messages(bag):
        copier.write(message)
    return copier.count, [*bag.notes, *copier.notes()]


def require_messages(path: Path, count: int, notes: list[str]) -> None:
    """InputError when nothing was copied."""
    if not count:
        raise InputError(f"{path}: no message could be converted ({'; '.join(notes) or 'the bag is empty'})")
