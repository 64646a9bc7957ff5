"""Decode many messages of one topic at once: if all share a layout, a field is a column of bytes."""

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
Decoded = TypeVar("Decoded")


@dataclass(frozen=True, eq=False, slots=True)
class OdometryColumns:
    """nav_msgs/Odometry of one topic: `kept` are the indices of the messages that could be decoded. If
    several robots or nodes write to it, only the most frequent frames are kept; `others` counts the rest by
    frame."""

    stamps_ns: Stamps
    xyt: Array
    child: str
    kept: NDArray[np.int64]
    others: dict[str, int] = field(default_factory=dict)


def odometry(messages: Sequence[bytes], cursor: MakeCursor) -> OdometryColumns:
    """Stamps (n,), planar poses (n, 3) and the child frame."""
    table = _table(messages, cursor, decode.odometry, 7)
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
    stamps, child, doubles = table
    x, y, _, qx, qy, qz, qw = doubles.T
    yaw = np.arctan2(2.0 * (qw * qz + qx * qy), qw**2 + qx**2 - qy**2 - qz**2)
    norm = qw**2 + qx**2 + qy**2 + qz**2
    yaw = np.where(np.isfinite(norm) & (norm > 0.0), yaw, np.nan)
    return OdometryColumns(stamps, np.stack([x, y, yaw], axis=-1), child, np.arange(len(stamps)))


def imu(messages: Sequence[bytes], cursor: MakeCursor) -> ImuLog:
    """Stamps (n,), gyro and specific force (n, 3)."""
    table = _table(messages, cursor, decode.imu, 37)
    if table is None:
        samples, _ = _one_by_one(messages, cursor, decode.imu)
        return ImuLog(
            np.array([sample.stamp_ns for sample in samples], dtype=np.int64),
            np.array([sample.angular for sample in samples], dtype=np.float64).reshape(-1, 3),
            np.array([sample.linear for sample in samples], dtype=np.float64).reshape(-1, 3),
        )
    stamps, _, doubles = table
    return ImuLog(stamps, doubles[:, 13:16].copy(), doubles[:, 25:28].copy())


def _table(
    messages: Sequence[bytes], cursor: MakeCursor, read: Callable[[Cursor], object], count: int
) -> tuple[Stamps, str, Array] | None:
    """Stamps, the child frame and the `count` doubles after the names, (n, count); None when the layouts
    differ and each message must be read alone."""
    first = messages[0]
    if any(len(message) != len(first) for message in messages):
        return None
    child = ""
    try:
        read(cursor(first))
        names = cursor(first)
        names.header()
        if read is decode.odometry:
            child = names.string()
    except BadMessage:
        return None
    rows = np.frombuffer(b"".join(messages), dtype=np.uint8).reshape(len(messages), len(first))
    # What must be equal: the encapsulation, and the frame names that follow the stamp.
    stamp, order = names.stamp_at, names.order
    for start, end in ((0, names.origin), (stamp + 8, names.at)):
        if not (rows[:, start:end] == rows[0, start:end]).all():
            return None
    names.align(8)
    seconds, nanoseconds = (
        rows[:, at : at + 4].copy().view(f"{order}{kind}4").ravel().astype(np.int64)
        for at, kind in ((stamp, "i"), (stamp + 4, "u"))
    )
    doubles = np.ascontiguousarray(rows[:, names.at : names.at + 8 * count]).view(order + "f8")
    return seconds * 1_000_000_000 + nanoseconds, child, doubles.astype(np.float64)


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
