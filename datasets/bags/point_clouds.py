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

from turtlebag.datasets.bags.contents import Contents
from turtlebag.datasets.bags.decode import BadMessage, Cursor
from turtlebag.datasets.bags.mapping_input import require_near
from turtlebag.datasets.bags.odometry import find_odometry, odometry_at, sensor_pose
from turtlebag.datasets.bags.source import Bag, open_bag
from turtlebag.datasets.bags.stamps import check_order, running
from turtlebag.datasets.bags.topics import way_out
from turtlebag.datasets.errors import InputError
from turtlebag.datasets.findings import lines_of
from turtlebag.datasets.se2 import Array
from turtlebag.datasets.types import Cloud, Recording3D

_DTYPES = {1: "i1", 2: "u1", 3: "i2", 4: "u2", 5: "i4", 6: "u4", 7: "f4", 8: "f8"}
_TIME_FIELDS = ("t", "time", "timestamp", "time_stamp", "offset_time")
_LONGEST_SWEEP_S = 2.0
"""Times of points that span more are no times within a sweep."""


class _Points(NamedTuple):
    """A cloud's message: its points (n,) as records, and the field of their times, if they have one."""

    stamp_ns: int
    frame: str
    points: NDArray[np.void]
    time: str | None


def _points(cursor: Cursor) -> _Points:
    """Header and points (height * width,) of a cloud; BadMessage when they do not fit together."""
    stamp, frame = cursor.header()
    height, width = cursor.take("I", 2)
    fields = {}
    for _ in range(cursor.count(13)):
        name = cursor.string()
        (offset,), (kind,) = cursor.take("I"), cursor.take("B")
        cursor.take("I")
        fields[name] = kind, offset
    order = ">" if cursor.take("B")[0] else "<"
    point_step, row_step = cursor.take("I", 2)
    data = cursor.array("u1", cursor.count(1))
    if row_step < width * point_step or len(data) < height * row_step or not point_step:
        raise BadMessage("a point cloud with too little data")
    time = next((name for name in _TIME_FIELDS if name in fields), None)
    used = ["x", "y", "z", *([] if time is None else [time])]
    try:
        formats = [order + _DTYPES[fields[name][0]] for name in used]
        offsets = [fields[name][1] for name in used]
        layout = np.dtype({"names": used, "formats": formats, "offsets": offsets, "itemsize": point_step})
    except (KeyError, ValueError):
        raise BadMessage("a point cloud without x, y, z, or with fields outside its points") from None
    rows = data[: height * row_step].reshape(height, row_step)[:, : width * point_step]
    return _Points(stamp, frame, np.ascontiguousarray(rows).reshape(-1).view(layout), time)


def decode_cloud(cursor: Cursor) -> tuple[int, str, Cloud]:
    """Stamp [ns], frame and points; non-finite ones and the zeros of no return are left out."""
    stamp_ns, frame, points, time = _points(cursor)
    xyz = np.stack([points[axis].astype(np.float64) for axis in "xyz"])
    finite = np.isfinite(xyz).all(axis=0) & (xyz != 0.0).any(axis=0)
    times = None if time is None else _seconds(points[time][finite], stamp_ns)
    return stamp_ns, frame, Cloud(np.ascontiguousarray(xyz[:, finite].T), times)


def _seconds(given: NDArray, stamp_ns: int) -> Array | None:
    """Times of points after the stamp [s]: drivers give seconds, nanoseconds, or either absolutely.

    None when they cannot be times within one sweep.
    """
    values = given.astype(np.float64)
    if not np.isfinite(values).all():
        return None
    if given.dtype.str[1:] in ("i4", "u4") or np.abs(values).max(initial=0.0) > 1e12:
        values = values * 1e-9
    if np.abs(values).max(initial=0.0) > 1e6:
        values = values - stamp_ns * 1e-9
    return values if np.abs(values).max(initial=0.0) <= _LONGEST_SWEEP_S else None


@dataclass(eq=False)
class _Index:
    """The clouds of one topic: stamps, log times and frames, and the log times of those that are damaged."""

    stamps: list[int] = field(default_factory=list)
    log_times: list[int] = field(default_factory=list)
    frames: Counter[str] = field(default_factory=Counter)
    damaged: list[int] = field(default_factory=list)


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

    def note(name: str, log_time: int, data: bytes) -> None:
        index = found.setdefault(name, _Index())
        try:
            cloud = _points(bag.cursor(data))
        except BadMessage:
            index.damaged.append(log_time)
            return
        index.stamps.append(cloud.stamp_ns)
        index.log_times.append(log_time)
        index.frames[cloud.frame] += 1

    contents = Contents(bag, note_cloud=note)
    chosen = _chosen_topic(contents, list(found), topic)
    index, findings = found[chosen], bag.findings
    for name, one in found.items():
        if one.damaged:
            contents.note_damaged(name, one.damaged, len(one.damaged) + len(one.stamps))
    if not index.stamps:
        raise InputError(f"{path}: {chosen}: no point cloud could be decoded")
    if len(index.frames) > 1:
        several = ", ".join(f"'{name}' ({count})" for name, count in index.frames.most_common())
        raise InputError(
            f"{path}: {chosen}: clouds of several frames: {several}; record each lidar on its own topic"
        )
    (frame,) = index.frames
    log_times = np.array(index.log_times, dtype=np.int64)
    stamps = running(chosen, index.stamps, log_times, findings)
    findings += check_order(chosen, index.stamps, log_times, "file order kept")
    odometry = find_odometry(contents, frame, findings)
    T_base_lidar = sensor_pose(contents.frames, odometry.base, frame)
    if T_base_lidar is not None:
        require_near(contents, chosen, odometry.base, frame, T_base_lidar)
    T_odom_base = odometry_at(odometry, chosen, stamps, log_times, findings)
    imu = contents.read_imu(findings)
    findings += contents.findings()
    return Recording3D(
        source=str(path),
        stamps_ns=stamps,
        clouds=_Clouds(bag, chosen),
        T_base_lidar=np.eye(4) if T_base_lidar is None else T_base_lidar,
        mounted=T_base_lidar is not None,
        T_odom_base=T_odom_base,
        odometry=odometry.poses,
        imu=imu,
        notes=lines_of(findings),
        findings=tuple(findings),
    )


def _chosen_topic(contents: Contents, names: list[str], wanted: str | None) -> str:
    if wanted in names:
        return str(wanted)
    if wanted is None and len(names) == 1:
        return names[0]
    listed, path = ", ".join(names) or "none", contents.bag.path
    if wanted is None and names:
        raise InputError(f"{path}: several point cloud topics; choose one with --topic: {listed}")
    missing = wanted or "point cloud topic"
    told = way_out(contents.types) or f"it has: {listed}"
    raise InputError(f"{path}: no {missing} (sensor_msgs/PointCloud2) in this bag; {told}")
