"""Clouds to which scan after scan is appended, each prepared once, and from which old ones are dropped."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from turtlebag.datasets.se2 import SE2
from turtlebag.datasets.types import Recording
from turtlebag.pipeline.slam.clouds import PER_POINT, Clouds, make_clouds
from turtlebag.pipeline.slam.range_noise import RangeNoise


class Rows:
    """An array that grows along its first axis; room doubles, so that appending costs little."""

    def __init__(self) -> None:
        self._data: NDArray[Any] | None = None
        self._count = 0

    def __len__(self) -> int:
        return self._count

    def append(self, rows: NDArray[Any]) -> None:
        """More rows at the end."""
        count = self._count + len(rows)
        if self._data is None:
            self._data = np.empty((max(1024, 2 * count), *rows.shape[1:]), dtype=rows.dtype)
        elif count > len(self._data):
            grown = np.empty((2 * count, *rows.shape[1:]), dtype=rows.dtype)
            grown[: self._count] = self._data[: self._count]
            self._data = grown
        self._data[self._count : count] = rows
        self._count = count

    def keep(self, stays: NDArray[np.bool_]) -> None:
        """Only some of the rows (n,)."""
        kept = self.view()[stays]
        self._data, self._count = None, 0
        self.append(kept)

    def view(self) -> NDArray[Any]:
        """All rows, without copying them."""
        assert self._data is not None
        return self._data[: self._count]


class GrowingClouds:
    """Clouds of all scans so far (see `slam/clouds.py`); `noise` is the lidar's, for those still to come."""

    def __init__(self, noise: RangeNoise | None = None) -> None:
        self.noise = noise or RangeNoise()
        self._rows = {name: Rows() for name in (*PER_POINT, "table")}
        self._starts = Rows()
        self._starts.append(np.zeros(1, dtype=np.int64))
        self._origin = np.zeros(2)

    def append(self, recording: Recording, usable_range: float, motion: SE2 | None) -> None:
        """One more scan: a recording of it alone, and how the robot moved during its sweep."""
        one, end = make_clouds(recording, usable_range, motion, self.noise), self._starts.view()[-1]
        for name in PER_POINT:
            self._rows[name].append(getattr(one, name))
        self._rows["table"].append(np.where(one.table < 0, -1, one.table + end).astype(np.int32))
        self._starts.append(end + one.starts[1:])
        self._origin = one.origin

    def keep(self, stays: NDArray[np.bool_]) -> None:
        """Only some of the scans (n,), numbered anew."""
        starts, table = self._starts.view(), self._rows["table"].view()[stays]
        counts = np.diff(starts)
        for name in PER_POINT:
            self._rows[name].keep(np.repeat(stays, counts))
        ends = np.concatenate([[0], np.cumsum(counts[stays])]).astype(np.int64)
        moved = (starts[:-1][stays] - ends[:-1])[:, None]
        self._rows["table"] = Rows()
        self._rows["table"].append(np.where(table < 0, -1, table - moved).astype(np.int32))
        self._starts = Rows()
        self._starts.append(ends)

    def view(self) -> Clouds:
        """All scans there are, without copying their points."""
        rows = {name: rows.view() for name, rows in self._rows.items()}
        return Clouds(**rows, starts=self._starts.view(), origin=self._origin)
