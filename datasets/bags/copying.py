"""Copy messages from one bag to another: the same bytes, or translated from ROS 1 to ROS 2."""

from __future__ import annotations

import struct
from collections import Counter
from collections.abc import Callable
from dataclasses import replace
from functools import lru_cache

import yaml
from rosbags.interfaces.typing import Typesdict
from rosbags.serde import SerdeError
from rosbags.typesys import Stores, TypesysError, get_types_from_idl, get_types_from_msg, get_typestore
from rosbags.typesys.store import Typestore

from turtlebag.datasets.bags.folder import BagFolder
from turtlebag.datasets.bags.topics import Message, Topic, definition, qos_profiles, typestore

RENAMED = {"tf/msg/tfMessage": "tf2_msgs/msg/TFMessage"}
_HEADER, _TIME = "std_msgs/msg/Header", "builtin_interfaces/msg/Time"


DAMAGED = (SerdeError, struct.error, ValueError, IndexError, OverflowError)
"""What rosbags raises for a message that is not as its definition says."""


class Untranslatable(ValueError):
    """The definition of a type is unknown or cannot be expressed in ROS 2's layout."""


def completed(topic: Topic) -> Topic:
    """The topic with its ROS 2 definition, from the standard types where the bag has none."""
    if topic.definition or topic.msgtype not in typestore().fielddefs:
        return topic
    text, type_hash = definition(topic.msgtype)
    return replace(
        topic, definition=text, definition_format="ros2msg", type_hash=topic.type_hash or type_hash
    )


def _store_of(topic: Topic) -> Typestore:
    """Types of one topic's definition, with the header of ROS 2."""
    store = get_typestore(Stores.EMPTY)
    try:
        if not topic.definition:
            types = dict(typestore().fielddefs)
        elif topic.definition_format == "ros2idl":
            types = _types_from_idl(topic.definition)
        else:
            types = dict(get_types_from_msg(topic.definition, topic.msgtype))
        types[_HEADER] = typestore().fielddefs[_HEADER]
        types.setdefault(_TIME, typestore().fielddefs[_TIME])
        store.register(types)
    except (TypesysError, KeyError, IndexError) as error:
        reason = " ".join(str(error).split())[:80]
        raise Untranslatable(f"{topic.name}: {topic.msgtype} ({reason})") from None
    if topic.msgtype not in store.fielddefs:
        raise Untranslatable(f"{topic.name}: unknown message definition of {topic.msgtype}")
    return store


def _types_from_idl(text: str) -> Typesdict:
    types: Typesdict = {}
    for part in text.split("=" * 80 + "\n"):
        types.update(get_types_from_idl(part.split("\n", 1)[1] if part.startswith("IDL: ") else part))
    return types


def to_ros2(topic: Topic) -> tuple[Topic, Callable[[bytes], bytes]]:
    """The topic as ROS 2 has it, and the translation of its messages from ROS 1's layout."""
    store = _store_of(topic)
    text, _ = store.generate_msgdef(topic.msgtype, ros_version=2)
    msgtype = RENAMED.get(topic.msgtype, topic.msgtype)
    renamed = Topic(topic.name, msgtype, text, "ros2msg", topic.qos)
    if msgtype != topic.msgtype:
        renamed = completed(replace(renamed, definition="", definition_format=""))
    else:
        renamed = replace(renamed, type_hash=store.hash_rihs01(topic.msgtype))
    source = topic.msgtype
    return renamed, lambda data: bytes(store.ros1_to_cdr(data, source))


@lru_cache(maxsize=256)
def as_ros2(topic: Topic) -> tuple[Topic, Callable[[bytes], bytes]]:
    """A topic of either layout as ROS 2 has it, with its definition, and the translation of its messages."""
    translate: Callable[[bytes], bytes] = bytes
    if topic.encoding == "ros1":
        topic, translate = to_ros2(topic)
    return completed(topic), translate


def is_latched(topic: Topic) -> bool:
    """Whether late subscribers are given the last message."""
    return "transient_local" in topic.qos or topic.name == "/tf_static"


Write = Callable[[Message], None]


class Copier:
    """Copies messages through what `register` returns for each topic.

    Topics that cannot be expressed and messages that cannot be translated are left out and named
    in `notes`.
    """

    def __init__(self, register: Callable[[Topic], Write]) -> None:
        self._register = register
        self._writers: dict[Topic, Write | None] = {}
        self._skipped: dict[str, str] = {}
        self._damaged: Counter[str] = Counter()
        self._no_qos: list[str] = []
        self.count = 0

    def write(self, message: Message) -> None:
        """Copy one message."""
        topic = message.topic
        if topic not in self._writers:  # files of a split bag have topics of their own that are equal
            self._writers[topic] = self._writer(topic)
        write = self._writers[topic]
        if write is None:
            return
        try:
            write(message)
        except DAMAGED:
            self._damaged[topic.name] += 1
        else:
            self.count += 1

    def _writer(self, topic: Topic) -> Write | None:
        try:
            qos_profiles(topic.qos)
        except (ValueError, yaml.YAMLError):
            self._no_qos.append(topic.name)
            topic = replace(topic, qos="")
        try:
            return self._register(topic)
        except Untranslatable as error:
            self._skipped[topic.name] = str(error)
        except TypesysError as error:
            self._skipped[topic.name] = f"{topic.name}: {topic.msgtype} ({' '.join(str(error).split())[:80]})"
        return None

    def notes(self) -> list[str]:
        """What was left out."""
        return [
            *(f"skipped {text}" for text in self._skipped.values()),
            *(f"{name}: its quality of service cannot be read and is left out" for name in self._no_qos),
            *(f"{name}: {count} damaged messages left out" for name, count in self._damaged.items()),
        ]


def into_mcap(bag: BagFolder) -> Copier:
    """A copier into a rosbag2 folder with mcap storage."""

    def register(topic: Topic) -> Write:
        topic, translate = as_ros2(topic)
        channel = bag.add_topic(
            topic.name,
            topic.msgtype,
            topic.definition,
            form=topic.definition_format if topic.definition else "",
            qos=topic.qos,
            type_hash=topic.type_hash,
            encoding=topic.encoding,
        )
        return lambda message: bag.write(channel, message.log_time_ns, translate(message.data))

    return Copier(register)
