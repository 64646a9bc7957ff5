"""A recorded message with its topic, as every storage file returns it."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import NamedTuple


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


def full_type(msgtype: str) -> str:
    """Type name with the middle part that ROS 1 leaves out."""
    parts = msgtype.split("/")
    return f"{parts[0]}/msg/{parts[1]}" if len(parts) == 2 else msgtype
