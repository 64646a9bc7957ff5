"""3D scans of a bag: sensor_msgs/PointCloud2 with the odometry at each."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from datasets.bags.decode import BadMessage, Cursor
from datasets.bags.odometry import find_odometry, odometry_at, sensor_matrix
from datasets.bags.source import open_bag
from datasets.bags.streams import Streams
from datasets.errors import InputError
from datasets.se2 import Array
from datasets.types import Cloud, Recording3D

_DTYPES = {1: "i1", 2: "u1", 3: "i2", 4: "u2", 5: "i4", 6: "u4", 7: "f4", 8: "f8"}
_TIME_FIELDS = ("t", "time", "timestamp", "time_stamp", "offset_time")


def decode_cloud(cursor: Cursor) -> tuple[int, str, Cloud]:
    """Stamp [ns], frame and points; non-finite ones and the zeros of no return are left out."""
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
    if not {"x", "y", "z"} <= fields.keys() or point_step == 0 or len(data) < height * row_step:
        raise BadMessage("a point cloud without x, y, z or with too little data")
    order = ">" if big_endian else "<"
    rows = data[: height * row_step].reshape(height, row_step)[:, : width * point_step]
    points = np.ascontiguousarray(rows).reshape(-1, point_step)

    def column(name: str) -> Array:
        kind, offset = fields[name]
        if kind not in _DTYPES or offset + int(_DTYPES[kind][1]) > point_step:
            raise BadMessage(f"field {name} of a point cloud lies outside its points")
        dtype = np.dtype(order + _DTYPES[kind])
        return (
            np.ascontiguousarray(points[:, offset : offset + dtype.itemsize]).view(dtype)[:, 0].astype(float)
        )

    xyz = np.stack([column("x"), column("y"), column("z")], axis=-1)
    finite = np.isfinite(xyz).all(axis=1) & (xyz != 0.0).any(axis=1)
    timed = next((name for name in _TIME_FIELDS if name in fields), None)
    times = None
    if timed:
        times = _seconds(column(timed), fields[timed][0], stamp)[finite]
    return stamp, frame, Cloud(xyz[finite], times)


def _seconds(values: Array, kind: int, stamp_ns: int) -> Array:
    """Times of points after the stamp [s]: drivers give seconds, nanoseconds, or absolute seconds."""
    if kind in (5, 6):
        return values * 1e-9
    return values - stamp_ns * 1e-9 if np.nanmax(np.abs(values), initial=0.0) > 1e6 else values


def load_clouds(path: Path, topic: str | None = None) -> Recording3D:
    """The 3D scans of a bag with the odometry at each; InputError when there is none.

    `topic` is needed only where the bag has several point cloud topics. Truth is never read.
    """
    bag = open_bag(path)
    streams = Streams(bag, clouds=True)
    names = list(streams.clouds)
    chosen = topic if topic else (names[0] if len(names) == 1 else None)
    if chosen is None or chosen not in names:
        listed = ", ".join(names) or "none"
        wanted = topic or "single point cloud topic"
        raise InputError(f"{path}: no {wanted} (sensor_msgs/PointCloud2) in this bag; it has: {listed}")
    raw = streams.clouds[chosen]
    stamps, log_times, clouds, frame = [], [], [], ""
    for log_time, data in zip(raw.times, raw.data, strict=True):
        try:
            stamp, frame, cloud = decode_cloud(bag.cursor(data))
        except BadMessage:
            streams.bad += 1
            continue
        stamps.append(stamp)
        log_times.append(log_time)
        clouds.append(cloud)
    if not clouds:
        raise InputError(f"{path}: {chosen}: no point cloud could be decoded")
    stamps_ns, notes = np.array(stamps, dtype=np.int64), bag.notes
    odometry = find_odometry(streams, frame, notes)
    T_base_lidar = sensor_matrix(streams.frames, odometry.base, frame, notes)
    T_odom_base = odometry_at(odometry, stamps_ns, np.array(log_times, dtype=np.int64), notes)
    streams.note_unknown(notes)
    if streams.bad:
        notes.append(f"{streams.bad} damaged messages skipped")
    return Recording3D(
        source=str(path),
        stamps_ns=stamps_ns,
        clouds=tuple(clouds),
        T_base_lidar=T_base_lidar,
        T_odom_base=T_odom_base,
        odometry=odometry.poses,
        imu=streams.read_imu(),
        notes=tuple(notes),
    )
