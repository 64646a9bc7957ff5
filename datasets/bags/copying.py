"""Messages of one bag into another: the same bytes, or translated between the layouts of ROS 1 and 2."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace

from rosbags.interfaces.typing import Typesdict
from rosbags.typesys import Stores, TypesysError, get_types_from_idl, get_types_from_msg, get_typestore
from rosbags.typesys.store import Typestore

from datasets.bags.folder import BagFolder
from datasets.bags.storage import Message, Topic
from datasets.bags.topics import definition, typestore

RENAMED = {"tf/msg/tfMessage": "tf2_msgs/msg/TFMessage"}
_HEADER, _TIME = "std_msgs/msg/Header", "builtin_interfaces/msg/Time"


class Untranslatable(ValueError):
    """The definition of a type is unknown or cannot be expressed in the other layout."""


def completed(topic: Topic) -> Topic:
    """The topic with its ROS 2 definition, from the standard types where the bag has none."""
    if topic.definition or topic.msgtype not in typestore().fielddefs:
        return topic
    text, type_hash = definition(topic.msgtype)
    return replace(
        topic, definition=text, definition_format="ros2msg", type_hash=topic.type_hash or type_hash
    )


def store_of(topic: Topic, *, ros2_header: bool) -> Typestore:
    """Types of one topic's definition, with the header of ROS 2 or of ROS 1."""
    store = get_typestore(Stores.EMPTY)
    try:
        if not topic.definition:
            types = dict(typestore().fielddefs)
        elif topic.definition_format == "ros2idl":
            types = _types_from_idl(topic.definition)
        else:
            types = dict(get_types_from_msg(topic.definition, topic.msgtype))
        standard = typestore() if ros2_header else get_typestore(Stores.ROS1_NOETIC)
        types[_HEADER] = standard.fielddefs[_HEADER]
        types.setdefault(_TIME, typestore().fielddefs[_TIME])
        store.register(types)
    except (TypesysError, KeyError, IndexError) as error:
        reason = " ".join(str(error).split())[:80]
        raise Untranslatable(f"{topic.name}: {topic.msgtype} ({reason})") from None
    if topic.msgtype not in store.fielddefs:
        raise Untranslatable(f"{topic.name}: the definition of {topic.msgtype} is not known")
    return store


def _types_from_idl(text: str) -> Typesdict:
    types: Typesdict = {}
    for part in text.split("=" * 80 + "\n"):
        types.update(get_types_from_idl(part.split("\n", 1)[1] if part.startswith("IDL: ") else part))
    return types


def to_ros2(topic: Topic) -> tuple[Topic, Callable[[bytes], bytes]]:
    """The topic as ROS 2 has it, and the translation of its messages from ROS 1's layout."""
    store = store_of(topic, ros2_header=True)
    text, _ = store.generate_msgdef(topic.msgtype, ros_version=2)
    msgtype = RENAMED.get(topic.msgtype, topic.msgtype)
    renamed = Topic(topic.name, msgtype, text, "ros2msg", topic.qos)
    if msgtype != topic.msgtype:
        renamed = completed(replace(renamed, definition="", definition_format=""))
    else:
        renamed = replace(renamed, type_hash=store.hash_rihs01(topic.msgtype))
    source = topic.msgtype
    return renamed, lambda data: bytes(store.ros1_to_cdr(data, source))


def to_ros1(topic: Topic) -> tuple[str, str, Callable[[bytes], bytes]]:
    """ROS 1's definition text and md5 sum of a topic, and the translation of its CDR messages."""
    store = store_of(topic, ros2_header=True)
    text, digest = store_of(topic, ros2_header=False).generate_msgdef(topic.msgtype, ros_version=1)
    return text, digest, lambda data: bytes(store.cdr_to_ros1(data, topic.msgtype))


def is_latched(topic: Topic) -> bool:
    """Whether late subscribers are given the last message."""
    return "transient_local" in topic.qos or topic.name == "/tf_static"


class TopicCopier:
    """Appends messages of other bags to a rosbag2 folder; topics are registered as they appear."""

    def __init__(self, bag: BagFolder) -> None:
        self._bag = bag
        self._known: dict[int, tuple[int, Callable[[bytes], bytes] | None]] = {}
        self._topics: list[Topic] = []
        self.count = 0
        self.skipped: dict[str, str] = {}

    def write(self, message: Message) -> None:
        """Append a message; those of untranslatable types are skipped and named in `skipped`."""
        known = self._known.get(id(message.topic))
        if known is None:
            self._topics.append(message.topic)  # keeps the identity taken
            known = self._known[id(message.topic)] = self._register(message.topic)
        channel, translate = known
        if channel:
            data = translate(message.data) if translate else message.data
            self._bag.write(channel, message.log_time_ns, data)
            self.count += 1

    def _register(self, topic: Topic) -> tuple[int, Callable[[bytes], bytes] | None]:
        translate = None
        if topic.encoding == "ros1":
            try:
                topic, translate = to_ros2(topic)
            except Untranslatable as error:
                self.skipped[topic.name] = str(error)
                return 0, None
        topic = completed(topic)
        channel = self._bag.add_topic(
            topic.name,
            topic.msgtype,
            topic.definition,
            form=topic.definition_format if topic.definition else "",
            qos=topic.qos,
            type_hash=topic.type_hash,
            encoding=topic.encoding if topic.encoding != "ros1" else "cdr",
        )
        return channel, translate
