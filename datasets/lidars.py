"""The scans of a robot with several lidars: those of each changed alone, and all put together again."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from dataclasses import replace
from itertools import pairwise

import numpy as np
from numpy.typing import NDArray

from turtlebag.datasets.se2 import SE2
from turtlebag.datasets.types import MountedLidar, Recording


def of_each_lidar(recording: Recording, change: Callable[[Recording], Recording]) -> Recording:
    """The recording after a change of each lidar's scans, which keeps their number.

    What it says of a lidar is said with its topic. Odometry that does not belong to one of them is not used
    for any; late odometry is as late as the first one says.
    """
    if not recording.others:
        return change(recording)
    alone = recording.parts()
    parts = [change(part) for _, part in alone]
    notes = [note for part in parts for note in _of_topic(part, part.notes[len(recording.notes) :])]
    poses = [part.T_odom_base for part in parts]
    known = [T for T in poses if T is not None]
    whole = len(known) == len(parts)
    order = np.argsort(np.concatenate([rows for rows, _ in alone]), kind="stable")
    return replace(
        together(parts, order),
        T_odom_base=SE2(np.concatenate([T.xyt for T in known])[order]) if whole else None,
        odometry=parts[0].odometry if whole else None,
        notes=(*recording.notes, *notes),
        turned_over=any(part.turned_over for part in parts),
        times=max((part.times for part in parts), key=lambda times: times.apart_s),
    )


def returns(recording: Recording, rows: slice | NDArray[np.int64]) -> NDArray[np.bool_]:
    """Which readings of some scans are returns from a surface, (k, n_beams)."""
    readings, sensor = recording.ranges[rows], recording.lidar_of[rows]
    valid = recording.lidar.returns(readings)
    for number, lidar in enumerate(recording.others, start=1):
        valid[sensor == number] = lidar.spec.returns(readings[sensor == number])
    return valid


def runs(sensor: NDArray[np.uint8], rows: slice) -> Iterator[slice]:
    """The runs of scans of one lidar among `rows`, which lidar took each being `sensor` (n,)."""
    changes = rows.start + 1 + np.flatnonzero(np.diff(sensor[rows]))
    ends = [rows.start, *changes.tolist(), rows.stop]
    yield from (slice(a, b) for a, b in pairwise(ends) if a < b)


def together(parts: Sequence[Recording], order: NDArray[np.int64]) -> Recording:
    """The first recording with the scans of others, each of one lidar, in `order`: row k of it is row
    `order[k]` of their scans one after another. Odometry poses are left to the caller."""
    widest = max(part.lidar.n_beams for part in parts)
    ranges = np.full((sum(len(part) for part in parts), widest), np.nan, dtype=parts[0].ranges.dtype)
    first = 0
    for part in parts:
        ranges[first : first + len(part), : part.lidar.n_beams] = part.ranges
        first += len(part)
    return replace(
        parts[0],
        stamps_ns=np.concatenate([part.stamps_ns for part in parts])[order],
        ranges=ranges[order],
        others=tuple(MountedLidar(part.lidar, part.T_base_lidar, part.topic) for part in parts[1:]),
        sensor=np.repeat(np.arange(len(parts), dtype=np.uint8), [len(part) for part in parts])[order],
    )


def _of_topic(part: Recording, notes: Sequence[str]) -> list[str]:
    return [f"{part.topic}: {note}" if part.topic else note for note in notes]
