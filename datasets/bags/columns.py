"""Many messages of one topic decoded at once: where all share a layout, a field is a column of bytes."""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from typing import TypeVar

import numpy as np
from numpy.typing import NDArray

from turtlebag.datasets.bags import decode
from turtlebag.datasets.bags.decode import BadMessage, Cursor
from turtlebag.datasets.se2 import Array
from turtlebag.datasets.types import ImuLog, Stamps

MakeCursor = Callable[[bytes], Cursor]
Bytes = NDArray[np.uint8]
Decoded = TypeVar("Decoded")


@dataclass(frozen=True, eq=False, slots=True)
class OdometryColumns:
    """nav_msgs/Odometry of one topic: `kept` are the indices of the messages that could be decoded.

    Where several robots or nodes write to it, those of the most frequent frames; `others` says how many
    of which are left out.
    """

    stamps_ns: Stamps
    xyt: Array
    child: str
    kept: NDArray[np.int64]
    others: dict[str, int] = field(default_factory=dict)


def odometry(messages: Sequence[bytes], cursor: MakeCursor) -> OdometryColumns:
    """Stamps (n,), planar poses (n, 3) and the child frame."""
    table = _table(messages, cursor, decode.odometry)
    if table is None:
        poses, kept = _one_by_one(messages, cursor, decode.odometry)
        links = Counter((pose.frame, pose.child) for pose in poses)
        (main, _), *rest = links.most_common() or [(("", ""), 0)]
        ours = [(pose, index) for pose, index in zip(poses, kept, strict=True) if pose[1:3] == main]
        poses, kept = [pose for pose, _ in ours], np.array([index for _, index in ours], dtype=np.int64)
        others = {f"{parent} -> {child}": count for (parent, child), count in rest}
        stamps = np.array([pose.stamp_ns for pose in poses], dtype=np.int64)
        xyt = np.array([pose[3:6] for pose in poses], dtype=np.float64).reshape(-1, 3)
        return OdometryColumns(stamps, xyt, main[1], kept, others)
    rows, order = table
    probe = cursor(messages[0])
    probe.header()
    child = probe.string()
    probe.align(8)
    x, y, _, qx, qy, qz, qw = _doubles(rows, probe.at, 7, order).T
    yaw = np.arctan2(2.0 * (qw * qz + qx * qy), qw**2 + qx**2 - qy**2 - qz**2)
    norm = qw**2 + qx**2 + qy**2 + qz**2
    yaw = np.where(np.isfinite(norm) & (norm > 0.0), yaw, np.nan)
    kept = np.arange(len(rows))
    return OdometryColumns(_stamps(rows, probe, order), np.stack([x, y, yaw], axis=-1), child, kept)


def imu(messages: Sequence[bytes], cursor: MakeCursor) -> ImuLog:
    """Stamps (n,), gyro and specific force (n, 3)."""
    table = _table(messages, cursor, decode.imu)
    if table is None:
        samples, _ = _one_by_one(messages, cursor, decode.imu)
        return ImuLog(
            np.array([sample.stamp_ns for sample in samples], dtype=np.int64),
            np.array([sample.angular for sample in samples], dtype=np.float64).reshape(-1, 3),
            np.array([sample.linear for sample in samples], dtype=np.float64).reshape(-1, 3),
        )
    rows, order = table
    probe = cursor(messages[0])
    probe.header()
    probe.align(8)
    values = _doubles(rows, probe.at, 37, order)
    return ImuLog(_stamps(rows, probe, order), values[:, 13:16].copy(), values[:, 25:28].copy())


def _table(
    messages: Sequence[bytes], cursor: MakeCursor, read: Callable[[Cursor], object]
) -> tuple[Bytes, str] | None:
    """(n, size) bytes and the byte order; None when the layouts differ and each must be read alone."""
    first = messages[0]
    if any(len(message) != len(first) for message in messages):
        return None
    try:
        read(cursor(first))
        names = cursor(first)
        names.header()
        if read is decode.odometry:
            names.string()
    except BadMessage:
        return None
    rows = np.frombuffer(b"".join(messages), dtype=np.uint8).reshape(len(messages), len(first))
    # What must be equal: the encapsulation, and the frame names that follow the stamp.
    for start, end in ((0, names.origin), (names.stamp_at + 8, names.at)):
        if not (rows[:, start:end] == rows[0, start:end]).all():
            return None
    return rows, names.order


def _stamps(rows: Bytes, probe: Cursor, order: str) -> Stamps:
    parts = rows[:, probe.stamp_at : probe.stamp_at + 8]
    seconds = parts[:, :4].copy().view(order + "i4").ravel().astype(np.int64)
    return seconds * 1_000_000_000 + parts[:, 4:].copy().view(order + "u4").ravel()


def _doubles(rows: Bytes, start: int, count: int, order: str) -> Array:
    return np.ascontiguousarray(rows[:, start : start + 8 * count]).view(order + "f8").astype(np.float64)


def _one_by_one(
    messages: Sequence[bytes], cursor: MakeCursor, read: Callable[[Cursor], Decoded]
) -> tuple[list[Decoded], NDArray[np.int64]]:
    found, kept = [], []
    for index, message in enumerate(messages):
        try:
            found.append(read(cursor(message)))
            kept.append(index)
        except BadMessage:
            continue
    return found, np.array(kept, dtype=np.int64)
