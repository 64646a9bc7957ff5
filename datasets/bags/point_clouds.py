"""3D scans of a bag: sensor_msgs/PointCloud2 with the odometry at each, read one cloud at a time."""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterator
from contextlib import suppress
from dataclasses import dataclass, field
from pathlib import Path
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from turtlebag.datasets.bags.decode import BadMessage, Cursor
from turtlebag.datasets.bags.odometry import find_odometry, in_file_order, odometry_at, sensor_matrix
from turtlebag.datasets.bags.source import Bag, open_bag
from turtlebag.datasets.bags.streams import Streams
from turtlebag.datasets.errors import InputError
from turtlebag.datasets.se2 import Array
from turtlebag.datasets.types import Cloud, Recording3D

_DTYPES = {1: "i1", 2: "u1", 3: "i2", 4: "u2", 5: "i4", 6: "u4", 7: "f4", 8: "f8"}
_TIME_FIELDS = ("t", "time", "timestamp", "time_stamp", "offset_time")
_LONGEST_SWEEP_S = 2.0
"""Times of points that span more are no times within a sweep."""


class _Layout(NamedTuple):
    """A cloud's message taken apart: its fields as (datatype, offset) in the bytes of each point."""

    stamp_ns: int
    frame: str
    fields: dict[str, tuple[int, int]]
    order: str
    rows: NDArray[np.uint8]


def _layout(cursor: Cursor) -> _Layout:
    """Header and bytes (height, width * point_step) of a cloud; BadMessage when they do not fit together."""
    stamp, frame = cursor.header()
    height, width = cursor.take("I", 2)
    fields = {}
    for _ in range(cursor.count(13)):
        name = cursor.string()
        (offset,), (kind,) = cursor.take("I"), cursor.take("B")
        cursor.take("I")
        fields[name] = kind, offset
    (big_endian,) = cursor.take("B")
    point_step, row_step = cursor.take("I", 2)
    data = cursor.array("u1", cursor.count(1))
    short = row_step < width * point_step or len(data) < height * row_step
    if not {"x", "y", "z"} <= fields.keys() or point_step == 0 or short:
        raise BadMessage("a point cloud without x, y, z or with too little data")
    for name in ("x", "y", "z", *_time_field(fields)):
        kind, offset = fields[name]
        if kind not in _DTYPES or offset + int(_DTYPES[kind][1]) > point_step:
            raise BadMessage(f"field {name} of a point cloud lies outside its points")
    rows = data[: height * row_step].reshape(height, row_step)[:, : width * point_step]
    points = np.ascontiguousarray(rows).reshape(-1, point_step)
    return _Layout(stamp, frame, fields, ">" if big_endian else "<", points)


def _time_field(fields: dict[str, tuple[int, int]]) -> list[str]:
    return [name for name in _TIME_FIELDS if name in fields][:1]


def decode_cloud(cursor: Cursor) -> tuple[int, str, Cloud]:
    """Stamp [ns], frame and points; non-finite ones and the zeros of no return are left out."""
    layout = _layout(cursor)

    def column(name: str) -> Array:
        kind, offset = layout.fields[name]
        dtype = np.dtype(layout.order + _DTYPES[kind])
        column = np.ascontiguousarray(layout.rows[:, offset : offset + dtype.itemsize])
        return column.view(dtype)[:, 0].astype(np.float64)

    xyz = np.stack([column("x"), column("y"), column("z")])
    finite = np.isfinite(xyz).all(axis=0) & (xyz != 0.0).any(axis=0)
    times = None
    for timed in _time_field(layout.fields):
        times = _seconds(column(timed)[finite], layout.fields[timed][0], layout.stamp_ns)
    return layout.stamp_ns, layout.frame, Cloud(np.ascontiguousarray(xyz[:, finite].T), times)


def _seconds(values: Array, kind: int, stamp_ns: int) -> Array | None:
    """Times of points after the stamp [s]: drivers give seconds, nanoseconds, or either absolutely.

    None when they cannot be times within one sweep.
    """
    if not np.isfinite(values).all():
        return None
    if kind in (5, 6) or np.abs(values).max(initial=0.0) > 1e12:
        values = values * 1e-9
    if np.abs(values).max(initial=0.0) > 1e6:
        values = values - stamp_ns * 1e-9
    return values if np.abs(values).max(initial=0.0) <= _LONGEST_SWEEP_S else None


@dataclass(eq=False)
class _Index:
    """The clouds of one topic that can be decoded: their stamps, log times and frame."""

    stamps: list[int] = field(default_factory=list)
    log_times: list[int] = field(default_factory=list)
    frames: Counter[str] = field(default_factory=Counter)


class _Clouds:
    """The clouds of a topic in file order, read from the bag each time they are gone through."""

    def __init__(self, bag: Bag, topic: str) -> None:
        self._bag, self._topic = bag, topic

    def __iter__(self) -> Iterator[Cloud]:
        for message in self._bag.messages(lambda topic: topic.name == self._topic):
            with suppress(BadMessage):
                yield decode_cloud(self._bag.cursor(message.data))[2]


def load_clouds(path: Path, topic: str | None = None) -> Recording3D:
    """The 3D scans of a bag with the odometry at each; InputError without 3D scans.

    `topic` is needed only where the bag has several point cloud topics. Truth is never read.
    """
    bag = open_bag(path)
    found: dict[str, _Index] = {}
    bad = 0

    def note(name: str, log_time: int, data: bytes) -> None:
        nonlocal bad
        index = found.setdefault(name, _Index())
        try:
            layout = _layout(bag.cursor(data))
        except BadMessage:
            bad += 1
            return
        index.stamps.append(layout.stamp_ns)
        index.log_times.append(log_time)
        index.frames[layout.frame] += 1

    streams = Streams(bag, note_cloud=note)
    chosen = _chosen_topic(path, list(found), topic)
    index = found[chosen]
    if not index.stamps:
        raise InputError(f"{path}: {chosen}: no point cloud could be decoded")
    if len(index.frames) > 1:
        several = ", ".join(f"'{name}' ({count})" for name, count in index.frames.most_common())
        raise InputError(
            f"{path}: {chosen}: clouds of several frames: {several}; record each lidar on its own topic"
        )
    (frame,) = index.frames
    notes, log_times = list(bag.notes), np.array(index.log_times, dtype=np.int64)
    stamps = in_file_order(index.stamps, log_times, chosen, notes)
    odometry = find_odometry(streams, frame, notes)
    known = len(notes)
    T_base_lidar = sensor_matrix(path, streams.frames, odometry.base, frame, notes)
    mounted = len(notes) == known
    del notes[known:]
    T_odom_base = odometry_at(odometry, stamps, log_times, notes)
    imu = streams.read_imu()
    streams.bad += bad
    streams.note_left_out(notes)
    return Recording3D(
        source=str(path),
        stamps_ns=stamps,
        clouds=_Clouds(bag, chosen),
        T_base_lidar=T_base_lidar,
        mounted=mounted,
        T_odom_base=T_odom_base,
        odometry=odometry.poses,
        imu=imu,
        notes=tuple(notes),
    )


def _chosen_topic(path: Path, names: list[str], wanted: str | None) -> str:
    if wanted in names:
        return str(wanted)
    if wanted is None and len(names) == 1:
        return names[0]
    listed = ", ".join(names) or "none"
    if wanted is None and names:
        raise InputError(f"{path}: several point cloud topics; choose one with --topic: {listed}")
    missing = wanted or "point cloud topic"
    raise InputError(f"{path}: no {missing} (sensor_msgs/PointCloud2) in this bag; it has: {listed}")
