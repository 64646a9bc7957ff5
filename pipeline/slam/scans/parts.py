"""Clouds of a part of a log, so that only the scans in use are in memory."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from functools import cache as once

import numpy as np
from numpy.typing import NDArray

from turtlebag.datasets.se2 import SE2
from turtlebag.datasets.types import Recording
from turtlebag.pipeline.slam.scans.clouds import PER_POINT, Clouds, make_clouds
from turtlebag.pipeline.slam.scans.range_noise import range_noise

# The points of logs with no more readings than this stay in memory, some 70 bytes each.
FEW_READINGS = 1_000_000


def clouds_maker(
    recording: Recording, usable_range: float, motion: SE2 | None, few_readings: int = FEW_READINGS
) -> Callable[[NDArray[np.int64] | None], Clouds]:
    """`make_clouds` of any scans of a recording, None for all; for a short log they are made only once."""
    noise = once(lambda: range_noise(recording, usable_range))

    def made(scans: NDArray[np.int64] | None = None) -> Clouds:
        return make_clouds(recording, usable_range, motion, noise(), scans)

    if recording.ranges.size > few_readings:
        return made
    whole = once(made)
    return lambda scans: whole() if scans is None else chosen(whole(), scans)


def joined_clouds(clouds: Sequence[Clouds]) -> Clouds:
    """Several clouds as one, with their scans numbered consecutively."""
    rows = np.cumsum([0, *[len(cloud.points) for cloud in clouds]])
    starts = [cloud.starts[:-1] + row for cloud, row in zip(clouds, rows, strict=False)]
    tables = [
        np.where(cloud.table >= 0, cloud.table + np.int32(row), np.int32(-1))
        for cloud, row in zip(clouds, rows, strict=False)
    ]
    return Clouds(
        **{name: np.concatenate([getattr(cloud, name) for cloud in clouds]) for name in PER_POINT},
        starts=np.concatenate([*starts, rows[-1:]]).astype(np.int64),
        table=np.concatenate(tables).astype(np.int32),
        origin=clouds[0].origin,
    )


def among(clouds: Clouds, scans: NDArray[np.int64], n: int) -> Clouds:
    """The clouds of `scans` (k,), ascending, numbered as in their log of n scans; all others are empty."""
    counts, table = np.zeros(n, dtype=np.int64), np.full((n, clouds.table.shape[1]), -1, dtype=np.int32)
    counts[scans], table[scans] = np.diff(clouds.starts), clouds.table
    return clouds._replace(starts=np.concatenate([[0], np.cumsum(counts)]), table=table)


def chosen(clouds: Clouds, scans: NDArray[np.int64]) -> Clouds:
    """The clouds of `scans` (k,), ascending, alone and numbered anew."""
    counts, keep = np.diff(clouds.starts), np.zeros(len(clouds.table), dtype=np.bool_)
    keep[scans] = True
    rows = np.repeat(keep, counts)
    row = np.append(np.cumsum(rows, dtype=np.int32) - 1, np.int32(-1))  # the last one is that of no point
    return clouds._replace(
        **{name: getattr(clouds, name)[rows] for name in PER_POINT},
        starts=np.concatenate([[0], np.cumsum(counts[scans])]),
        table=row[clouds.table[scans]],
    )
