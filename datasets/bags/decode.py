"""Decode the message types we use, from ROS 2's CDR and ROS 1's plain layout."""

from __future__ import annotations

import math
import struct
from collections.abc import Sequence
from functools import lru_cache
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from turtlebag.datasets.se2 import Array

_SIZES = {"B": 1, "i": 4, "I": 4, "f": 4, "d": 8}
_STRUCTS: dict[tuple[str, str, int], struct.Struct] = {}
_HEADERS = {order: struct.Struct(order + "iII") for order in "<>"}
_LENGTHS = {order: struct.Struct(order + "I") for order in "<>"}


@lru_cache(maxsize=4096)
def _name(text: bytes) -> str:
    """A frame's name; ROS 1's leading slash and CDR's final zero go."""
    return text.rstrip(b"\0").decode("utf-8", "replace").lstrip("/")


class BadMessage(ValueError):
    """The bytes are not a message of that type."""


class Cursor:
    """Reads CDR fields in order; alignment counts from after the encapsulation header."""

    origin = 4

    def __init__(self, data: bytes) -> None:
        if len(data) < 4 or data[0] != 0 or data[1] > 1:
            raise BadMessage("not a CDR message")
        self.data = data
        self.at = 4
        self.order = "<" if data[1] else ">"

    def align(self, size: int) -> None:
        """Step over padding."""
        self.at += -(self.at - self.origin) % size

    def take(self, code: str, count: int = 1) -> tuple:
        """Values of one struct type."""
        key = self.order, code, count
        known = _STRUCTS.get(key)
        if known is None:
            known = _STRUCTS[key] = struct.Struct(f"{self.order}{count}{code}")
        self.align(_SIZES[code])
        return self._unpacked(known)

    def _unpacked(self, layout: struct.Struct) -> tuple:
        try:
            values = layout.unpack_from(self.data, self.at)
        except struct.error:
            raise BadMessage("the message is too short") from None
        self.at += layout.size
        return values

    def count(self, least: int) -> int:
        """Length of a sequence whose items need at least `least` bytes each."""
        n = int(self.take("I")[0])
        if n * least > len(self.data) - self.at + 8:
            raise BadMessage("a sequence is longer than its message")
        return n

    def array(self, dtype: str, count: int) -> NDArray:
        """`count` numbers, e.g. dtype "f4"."""
        size = int(dtype[1])
        if count:
            self.align(size)
        if self.at + size * count > len(self.data):
            raise BadMessage("the message is too short")
        values = np.frombuffer(self.data, self.order + dtype, count, self.at)
        self.at += size * count
        return values

    def string(self) -> str:
        """A string without ROS 1's leading slash."""
        self.align(4)
        return self._text(*self._unpacked(_LENGTHS[self.order]))

    def header(self) -> tuple[int, str]:
        """(stamp [ns], frame)."""
        self.align(4)
        sec, nanosec, n = self._unpacked(_HEADERS[self.order])
        return sec * 1_000_000_000 + nanosec, self._text(n)

    def _text(self, size: int) -> str:
        start = self.at
        self.at += size
        if self.at > len(self.data):
            raise BadMessage("a text is longer than its message")
        return _name(self.data[start : self.at])


class Ros1Cursor(Cursor):
    """Reads ROS 1 fields: no padding, headers with a sequence number, strings without a final zero."""

    origin = 0

    def __init__(self, data: bytes) -> None:
        self.data, self.at, self.order = data, 0, "<"

    def align(self, size: int) -> None:
        """Nothing is padded in ROS 1."""

    def header(self) -> tuple[int, str]:
        """(stamp [ns], frame); a sequence number comes first."""
        self.at += 4
        return super().header()


class RawScan(NamedTuple):
    """LaserScan; `geometry`: angle_min, angle_max, increment, time_increment, scan_time, range limits."""

    stamp_ns: int
    frame: str
    geometry: tuple[float, ...]
    ranges: NDArray[np.float32]


class RawTransform(NamedTuple):
    """A stamped transform: translation and quaternion x, y, z, w."""

    stamp_ns: int
    parent: str
    child: str
    xyz: tuple[float, float, float]
    quaternion: tuple[float, float, float, float]
    log_time_ns: int = 0


def yaw_of(quaternion: Sequence[float]) -> float:
    """Yaw of a quaternion x, y, z, w [rad]; NaN when it has no direction."""
    x, y, z, w = quaternion
    norm = x * x + y * y + z * z + w * w
    if not norm > 0.0 or not math.isfinite(norm):
        return math.nan
    return math.atan2(2.0 * (w * z + x * y), norm - 2.0 * (y * y + z * z))


def yaws_of(quaternions: Array) -> Array:
    """Yaws (n,) of quaternions (n, 4) as `yaw_of` has them, but for rounding."""
    x, y, z, w = quaternions.T
    yaws = np.arctan2(2.0 * (w * z + x * y), w**2 + x**2 - y**2 - z**2)
    norm = w**2 + x**2 + y**2 + z**2
    return np.where(np.isfinite(norm) & (norm > 0.0), yaws, np.nan)


def header(cursor: Cursor) -> tuple[int, str]:
    """Stamp [ns] and frame of any message that begins with a header."""
    return cursor.header()


def laser_scan(cursor: Cursor) -> RawScan:
    """sensor_msgs/LaserScan."""
    stamp, frame = cursor.header()
    geometry = cursor.take("f", 7)
    return RawScan(stamp, frame, geometry, cursor.array("f4", cursor.count(4)))


def transforms(cursor: Cursor) -> list[RawTransform]:
    """tf2_msgs/TFMessage."""
    found = []
    for _ in range(cursor.count(60)):
        stamp, parent = cursor.header()
        child = cursor.string()
        values = cursor.take("d", 7)
        found.append(RawTransform(stamp, parent, child, values[:3], values[3:]))
    return found


def twist(cursor: Cursor) -> tuple[float, float]:
    """geometry_msgs/Twist: forward and yaw speed."""
    v, _, _, _, _, w = cursor.take("d", 6)
    return v, w


def twist_stamped(cursor: Cursor) -> tuple[float, float]:
    """geometry_msgs/TwistStamped."""
    cursor.header()
    return twist(cursor)


def pose_array(cursor: Cursor) -> tuple[int, Array]:
    """geometry_msgs/PoseArray: stamp and (n, 3) x, y, yaw."""
    stamp, _ = cursor.header()
    rows = cursor.array("f8", 7 * cursor.count(56)).reshape(-1, 7)
    return stamp, np.column_stack([rows[:, :2], yaws_of(rows[:, 3:])])


def joint_state(cursor: Cursor) -> tuple[int, list[str], Array]:
    """sensor_msgs/JointState: stamp, names and positions."""
    stamp, _ = cursor.header()
    names = [cursor.string() for _ in range(cursor.count(4))]
    return stamp, names, cursor.array("f8", cursor.count(8))
