"""Clouds to which scan after scan is appended, each prepared once."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from turtlebag.datasets.se2 import SE2
from turtlebag.datasets.types import Recording
from turtlebag.pipeline.slam.clouds import PER_POINT, Clouds, make_clouds
from turtlebag.pipeline.slam.range_noise import RangeNoise, range_noise


class _Rows:
    """An array that grows along its first axis; room doubles, so that appending costs little."""

    def __init__(self) -> None:
        self._data: NDArray[Any] | None = None
        self._count = 0

    def append(self, rows: NDArray[Any]) -> None:
        count = self._count + len(rows)
        if self._data is None:
            self._data = np.empty((max(1024, 2 * count), *rows.shape[1:]), dtype=rows.dtype)
        elif count > len(self._data):
            grown = np.empty((2 * count, *rows.shape[1:]), dtype=rows.dtype)
            grown[: self._count] = self._data[: self._count]
            self._data = grown
        self._data[self._count : count] = rows
        self._count = count

    def view(self) -> NDArray[Any]:
        assert self._data is not None
        return self._data[: self._count]


class GrowingClouds:
    """Clouds of all scans so far (see `slam/clouds.py`); the lidar's noise is that of the first one."""

    def __init__(self, noise: RangeNoise | None = None) -> None:
        self._noise = noise
        self._rows = {name: _Rows() for name in (*PER_POINT, "table")}
        self._starts = [0]
        self._origin = np.zeros(2)

    def append(self, recording: Recording, usable_range: float, motion: SE2 | None) -> None:
        """One more scan: a recording of it alone, and how the robot moved during its sweep."""
        if self._noise is None:
            self._noise = range_noise(recording, usable_range)
        one = make_clouds(recording, usable_range, motion, self._noise)
        for name in PER_POINT:
            self._rows[name].append(getattr(one, name))
        self._rows["table"].append(np.where(one.table < 0, -1, one.table + self._starts[-1]).astype(np.int32))
        self._starts.append(self._starts[-1] + len(one.points))
        self._origin = one.origin

    def view(self) -> Clouds:
        """All scans so far, without copying their points."""
        return Clouds(
            **{name: rows.view() for name, rows in self._rows.items()},
            starts=np.array(self._starts, dtype=np.int64),
            origin=self._origin,
        )
