"""What to copy of a bag: topics and transforms to leave out, and a stretch of time."""

from __future__ import annotations

import math
from collections import Counter
from collections.abc import Collection, Iterator
from dataclasses import dataclass
from typing import Any

from turtlebag.datasets.bags.copying import DAMAGED, as_ros2, is_latched
from turtlebag.datasets.bags.source import Bag
from turtlebag.datasets.bags.topics import TRANSFORMS, Message, Topic, typestore
from turtlebag.datasets.errors import InputError
from turtlebag.datasets.findings import Finding
from turtlebag.datasets.plurals import counted, listed

_LONGEST_S = 1e10
"""Longer than any recording, and no more than a stamp can hold."""


@dataclass(frozen=True, slots=True)
class Selection:
    """What is copied of a bag.

    The messages recorded from `start_s` to `end_s`, both included, in seconds from the bag's first message.
    What latched topics (/tf_static, /map) hold by then is kept too, as if recorded at `start_s`. The topics
    `exclude` are left out, and in /tf and /tf_static every transform whose child is one of `exclude_frames`.
    """

    exclude: tuple[str, ...] = ()
    exclude_frames: tuple[str, ...] = ()
    start_s: float = 0.0
    end_s: float = math.inf

    def messages(self, bag: Bag) -> Iterator[Message]:
        """The messages of a bag that are selected, in its order.

        InputError for a stretch of time without any, and at the end for a topic or frame to leave out that
        is not there.
        """
        start_ns, end_ns = self._stretch_ns(bag)
        links = _Links(self.exclude_frames)
        topics: set[str] = set()

        def wanted(topic: Topic) -> bool:
            topics.add(topic.name)
            return topic.name not in self.exclude

        for message in bag.messages(wanted):
            if message.log_time_ns < start_ns and is_latched(message.topic):
                message = message._replace(log_time_ns=start_ns)
            if start_ns <= message.log_time_ns <= end_ns:
                yield from links.kept(message)
        bag.findings += links.findings()
        _require_there(bag, "--exclude", "topic", self.exclude, topics)
        _require_there(bag, "--exclude-frame", "child frame", self.exclude_frames, links.children)

    def _stretch_ns(self, bag: Bag) -> tuple[int, int]:
        """Log times [ns] of the first and the last moment to copy."""
        if self.start_s == 0.0 and self.end_s == math.inf:
            return 0, 1 << 64
        known = len(bag.findings)
        times = [message.log_time_ns for message in bag.messages()]
        del bag.findings[known:]  # which the second reading adds again
        first, last = min(times, default=0), max(times, default=0)
        start, end = (first + round(1e9 * min(s, _LONGEST_S)) for s in (self.start_s, self.end_s))
        if times and not any(start <= time <= end for time in times):
            until = "" if self.end_s == math.inf else f" --to {self.end_s:g}"
            raise InputError(
                f"--from {self.start_s:g}{until}: {bag.path} has no messages in this interval; "
                f"it is {(last - first) * 1e-9:.2f} s long"
            )
        return start, end


EVERYTHING = Selection()


class _Links:
    """Leaves out the transforms to some frames; `children` are all frames that there are transforms to."""

    def __init__(self, frames: Collection[str]) -> None:
        self._frames = frames
        self._damaged: Counter[str] = Counter()
        self.children: set[str] = set()

    def kept(self, message: Message) -> Iterator[Message]:
        """The message; one of transforms as ROS 2 has it, without those to leave out, or not at all."""
        if not self._frames or message.topic.msgtype not in TRANSFORMS:
            yield message
            return
        try:
            topic, translate = as_ros2(message.topic)
            data = translate(message.data)
            content: Any = typestore().deserialize_cdr(data, topic.msgtype)
        except DAMAGED:
            self._damaged[message.topic.name] += 1
            return
        names = [link.child_frame_id.lstrip("/") for link in content.transforms]
        self.children.update(names)
        kept = [
            link for link, name in zip(content.transforms, names, strict=True) if name not in self._frames
        ]
        if len(kept) < len(names):
            data = bytes(typestore().serialize_cdr(type(content)(kept), topic.msgtype))
        if kept or not names:
            yield Message(topic, message.log_time_ns, data)

    def findings(self) -> Iterator[Finding]:
        """What else was left out."""
        for name, count in self._damaged.items():
            what = f"{counted(count, 'message')} cannot be decoded"
            yield Finding("damaged messages", name, what, count, remedy="left out")


def _require_there(bag: Bag, option: str, what: str, wanted: Collection[str], there: Collection[str]) -> None:
    for name in wanted:
        if name not in there:
            raise InputError(f"{option} {name}: no such {what}; {bag.path} has {listed(there)}")
