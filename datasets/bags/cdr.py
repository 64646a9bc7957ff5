"""Our messages in CDR, little endian. Stamps are nanoseconds, poses planar.

A message is packed at once from its numbers, texts and arrays in the order of its definition; where each of
them lies follows from the definition and from how long texts and sequences are.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from functools import cached_property, lru_cache
from itertools import chain
from math import cos, sin
from struct import Struct, calcsize
from typing import Any

import numpy as np
from numpy.typing import NDArray

from turtlebag.datasets.bags.topics import typestore
from turtlebag.datasets.se2 import SE2, Array
from turtlebag.datasets.types import Imu, Joints, Scan, Twist

NO_COVARIANCE = np.zeros(36)
_NO_COVARIANCE = NO_COVARIANCE.tobytes()
_UNKNOWN_ORIENTATION = 0.0, 0.0, 0.0, 1.0, np.array([-1.0, *[0.0] * 8]).tobytes()
_MOVING = None, 0.0, 0.0, 0.0, 0.0, None
"""A planar velocity in a layout: only forward and turning speed differ."""
_FRONT = b"\0\1\0\0"
"""What CDR of little endian begins with; places in a message are counted from behind it."""
_CODES = {
    "bool": "?", "int8": "b", "uint8": "B", "byte": "B", "int16": "h", "uint16": "H", "int32": "i",
    "uint32": "I", "int64": "q", "uint64": "Q", "float32": "f", "float64": "d",
}  # fmt: skip


Row = tuple[float, ...]
"""The numbers in which a message differs from others of its layout, in order."""


@lru_cache(maxsize=256)
def _codes(kind: str, *lengths: int) -> tuple[tuple[int, str], ...]:
    """How a message lies in memory, in bytes of padding and codes of `struct`: of a text its length with the
    final zero and its bytes, of a sequence the number of its elements and these. Arrays of numbers are bytes.
    `lengths` are those of texts and sequences in order."""
    from rosbags.interfaces import Nodetype

    ahead, place = iter(lengths), 0
    codes: list[tuple[int, str]] = []

    def put(code: str, align: int) -> None:
        nonlocal place
        gap = -place % align
        codes.append((gap, code))
        place += gap + calcsize("<" + code)

    def field(node: Any, about: Any) -> None:
        if node == Nodetype.NAME:
            for _, part in typestore().get_msgdef(about).fields:
                field(*part)
        elif node == Nodetype.BASE and about[0] == "string":
            put("I", 4)
            put(f"{next(ahead)}s", 1)
        elif node == Nodetype.BASE:
            code = _CODES[about[0]]
            put(code, calcsize(code))
        else:
            element, count = about
            if node == Nodetype.SEQUENCE:
                put("I", 4)
                count = next(ahead)
            if element[0] == Nodetype.BASE and element[1][0] != "string":
                width = calcsize(_CODES[element[1][0]])
                put(f"{count * width}s", width if count else 1)
            else:
                for _ in range(count):
                    field(*element)

    field(Nodetype.NAME, kind)
    return tuple(codes)


@lru_cache(maxsize=256)
def _layout(kind: str, *lengths: int) -> Struct:
    return Struct("<" + "".join(f"{gap}x{code}" for gap, code in _codes(kind, *lengths)))


class Layout:
    """Messages that differ in numbers only, packed many at a time; `row` makes a row of what one is of."""

    def __init__(
        self, kind: str, lengths: Sequence[int], values: Sequence[Any], row: Callable[..., Row]
    ) -> None:
        """`values` are those of the message in order, None where the row has a number."""
        self._kind, self._lengths, self._values, self.row = kind, lengths, values, row

    @cached_property
    def size(self) -> int:
        """Bytes of a message."""
        return len(_FRONT) + _layout(self._kind, *self._lengths).size

    @cached_property
    def _template(self) -> tuple[bytes, np.dtype[np.void], list[str]]:
        """A message without its numbers, its fields, and those where the numbers belong, one or several."""
        place, told = len(_FRONT), {}
        fields: dict[str, tuple[str, int]] = {}
        for value, (gap, code) in zip(self._values, _codes(self._kind, *self._lengths), strict=True):
            place, width, name = place + gap, calcsize("<" + code), f"at {place + gap}"
            array = f"({width // 8},)<f8" if value is None else f"S{width}"
            if width:
                fields[name] = array if code.endswith("s") else f"<{code}", place
                told[name] = value
            place += width
        formats, offsets = map(list, zip(*fields.values(), strict=True))
        dtype = np.dtype(
            {"names": list(fields), "formats": formats, "offsets": offsets, "itemsize": self.size}
        )
        message = bytearray(_FRONT.ljust(self.size, b"\0"))
        template = np.frombuffer(message, dtype)
        for name, value in told.items():
            if value is not None:
                template[name] = value
        return bytes(message), dtype, [name for name, value in told.items() if value is None]

    def messages(self, rows: Sequence[Row]) -> list[bytes]:
        """The messages of rows."""
        template, dtype, names = self._template
        data, numbers, used = bytearray(len(rows) * template), np.array(rows, dtype=float), 0
        packed = np.frombuffer(data, dtype)
        for name in names:
            field = packed[name]
            width = field[0].size
            field[...] = numbers[:, used : used + width].reshape(field.shape)
            used += width
        return [bytes(data[k : k + self.size]) for k in range(0, len(data), self.size)]


def _bytes(kind: str, lengths: Sequence[int], *values: Any) -> bytes:
    return _FRONT + _layout(kind, *lengths).pack(*values)


@lru_cache(maxsize=256)
def _text(text: str) -> tuple[int, bytes]:
    """A text as it is packed: its length with the final zero, and its bytes."""
    data = text.encode() + b"\0"
    return len(data), data


def _stamp(stamp_ns: int) -> tuple[int, int]:
    return divmod(stamp_ns, 1_000_000_000)


def _pose(x: float, y: float, yaw: float) -> tuple[float, ...]:
    return x, y, 0.0, 0.0, 0.0, sin(0.5 * yaw), cos(0.5 * yaw)


def odometry(frame: str, child: str, covariance: Array) -> Layout:
    """nav_msgs/Odometry of a stamp, a pose and a twist; `covariance` (36,) of the pose."""
    above, below = _text(frame), _text(child)
    pose = None, None, 0.0, 0.0, 0.0, None, None, covariance.tobytes()
    values = None, None, *above, *below, *pose, *_MOVING, _NO_COVARIANCE
    return Layout("nav_msgs/msg/Odometry", (above[0], below[0]), values, _odometry)


def _odometry(stamp_ns: int, T: SE2, velocity: Twist) -> Row:
    return *divmod(stamp_ns, 1_000_000_000), *_place(T), velocity.v, velocity.w


def transform(frame: str, child: str) -> Layout:
    """tf2_msgs/TFMessage of a stamp and one planar transform."""
    above, below = _text(frame), _text(child)
    values = 1, None, None, *above, *below, None, None, 0.0, 0.0, 0.0, None, None
    return Layout("tf2_msgs/msg/TFMessage", (1, above[0], below[0]), values, _transform)


def _transform(stamp_ns: int, T: SE2) -> Row:
    return *divmod(stamp_ns, 1_000_000_000), *_place(T)


def _place(T: SE2) -> Row:
    x, y, yaw = T.xyt.tolist()
    return x, y, sin(0.5 * yaw), cos(0.5 * yaw)


def transforms(stamp_ns: int, links: Sequence[tuple[str, str, tuple[float, float, float], float]]) -> bytes:
    """tf2_msgs/TFMessage with (parent, child, (x, y, z), yaw) each."""
    stamp, lengths = _stamp(stamp_ns), [len(links)]
    values: list[Any] = [len(links)]
    for parent, child, xyz, yaw in links:
        above, below = _text(parent), _text(child)
        lengths += above[0], below[0]
        values += *stamp, *above, *below, *xyz, 0.0, 0.0, sin(0.5 * yaw), cos(0.5 * yaw)
    return _bytes("tf2_msgs/msg/TFMessage", lengths, *values)


def joint_state(frame: str, names: Sequence[str]) -> Layout:
    """sensor_msgs/JointState of two wheels."""
    place, texts = _text(frame), [_text(name) for name in names]
    lengths = place[0], len(texts), *(size for size, _ in texts), 2, 2, 0
    values = None, None, *place, len(texts), *chain(*texts), 2, None, 2, None, 0, b""
    return Layout("sensor_msgs/msg/JointState", lengths, values, _joints)


def _joints(joints: Joints) -> Row:
    return *divmod(joints.stamp_ns, 1_000_000_000), *joints.position, *joints.velocity


def imu(frame: str, gyro_covariance: Array, acceleration_covariance: Array) -> Layout:
    """sensor_msgs/Imu without orientation; covariances (9,)."""
    place, three = _text(frame), (None, None, None)
    measured = *three, gyro_covariance.tobytes(), *three, acceleration_covariance.tobytes()
    values = None, None, *place, *_UNKNOWN_ORIENTATION, *measured
    return Layout("sensor_msgs/msg/Imu", place[:1], values, _imu)


def _imu(sample: Imu) -> Row:
    turning, force = sample.angular_velocity.tolist(), sample.linear_acceleration.tolist()
    return *divmod(sample.stamp_ns, 1_000_000_000), *turning, *force


def laser_scan(frame: str, scan: Scan) -> bytes:
    """sensor_msgs/LaserScan; its stamp is that of the first beam."""
    lidar, place, n = scan.lidar, _text(frame), len(scan.ranges)
    last = lidar.angle_min + (lidar.n_beams - 1) * lidar.angle_increment
    angles = lidar.angle_min, last, lidar.angle_increment
    limits = lidar.time_increment, lidar.scan_time, lidar.range_min, lidar.range_max
    beams = n, scan.ranges.astype("<f4").tobytes(), 0, b""
    lengths, header = (place[0], n, 0), (*_stamp(scan.stamp_ns), *place)
    return _bytes("sensor_msgs/msg/LaserScan", lengths, *header, *angles, *limits, *beams)


def twist() -> Layout:
    """geometry_msgs/Twist."""
    return Layout("geometry_msgs/msg/Twist", (), _MOVING, _twist)


def _twist(velocity: Twist) -> Row:
    return velocity.v, velocity.w


def string(text: str) -> bytes:
    """std_msgs/String."""
    value = _text(text)
    return _bytes("std_msgs/msg/String", value[:1], *value)


def pose_stamped(frame: str, stamp_ns: int, T: SE2) -> bytes:
    """geometry_msgs/PoseStamped."""
    place = _text(frame)
    values = *_stamp(stamp_ns), *place, *_pose(*T.xyt.tolist())
    return _bytes("geometry_msgs/msg/PoseStamped", place[:1], *values)


def pose_with_covariance(frame: str, stamp_ns: int, T: SE2, covariance: Array) -> bytes:
    """geometry_msgs/PoseWithCovarianceStamped; `covariance` (3, 3) of x, y, yaw."""
    place, full = _text(frame), planar_covariance(covariance).tobytes()
    values = *_stamp(stamp_ns), *place, *_pose(*T.xyt.tolist()), full
    return _bytes("geometry_msgs/msg/PoseWithCovarianceStamped", place[:1], *values)


def planar_covariance(covariance: Array) -> Array:
    """(3, 3) covariance of x, y, yaw as ROS's row-major 6x6, (36,)."""
    full = np.zeros((6, 6))
    full[np.ix_((0, 1, 5), (0, 1, 5))] = covariance
    return full.ravel()


def pose_array(frame: str, stamp_ns: int, poses: SE2) -> bytes:
    """geometry_msgs/PoseArray of planar poses (n,)."""
    place = _text(frame)
    # Rows of numbers, of which there are thousands: after the front they lie as an array of doubles does.
    rows = np.zeros((len(poses.xyt), 7))
    rows[:, :2] = poses.xy
    rows[:, 5], rows[:, 6] = np.sin(0.5 * poses.yaw), np.cos(0.5 * poses.yaw)
    begun = _bytes("geometry_msgs/msg/PoseArray", (place[0], 0), *_stamp(stamp_ns), *place, len(rows))
    padding = bytes(-(len(begun) - len(_FRONT)) % 8 if len(rows) else 0)
    return begun + padding + rows.astype("<f8").tobytes()


def path(frame: str, stamp_ns: int, poses: SE2) -> bytes:
    """nav_msgs/Path of planar poses (n,)."""
    place = _text(frame)
    header, rows = (*_stamp(stamp_ns), *place), poses.xyt.tolist()
    stops = chain(*((*header, *_pose(*row)) for row in rows))
    lengths = place[0], len(rows), *(place[0] for _ in rows)
    return _bytes("nav_msgs/msg/Path", lengths, *header, len(rows), *stops)


def occupancy_grid(
    frame: str, stamp_ns: int, cells: NDArray[np.int8], resolution: float, origin: Array
) -> bytes:
    """nav_msgs/OccupancyGrid from (rows, cols) cells and the grid's origin (x, y, yaw)."""
    place, stamp, (rows, columns) = _text(frame), _stamp(stamp_ns), cells.shape
    about = *stamp, resolution, columns, rows, *_pose(*origin.tolist())
    values = *stamp, *place, *about, cells.size, cells.tobytes()
    return _bytes("nav_msgs/msg/OccupancyGrid", (place[0], cells.size), *values)


def point_cloud(frame: str, stamp_ns: int, points: Array, times: Array | None = None) -> bytes:
    """sensor_msgs/PointCloud2 of points (n, 3) and, where given, times after the stamp (n,) [s]."""
    place, names = _text(frame), ("x", "y", "z") if times is None else ("x", "y", "z", "time")
    table = points if times is None else np.column_stack([points, times])
    texts, data, step = [_text(name) for name in names], table.astype("<f4").tobytes(), 4 * len(names)
    fields = chain(*((*text, 4 * k, 7, 1) for k, text in enumerate(texts)))
    lengths = place[0], len(names), *(size for size, _ in texts), len(data)
    layout = False, step, step * len(points), len(data), data, True
    values = *_stamp(stamp_ns), *place, 1, len(points), len(names), *fields, *layout
    return _bytes("sensor_msgs/msg/PointCloud2", lengths, *values)
