"""Growing clouds: scans are appended, each prepared once, and old ones dropped."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from turtlebag.datasets.se2 import SE2
from turtlebag.datasets.types import Recording
from turtlebag.pipeline.slam.online.columns import Columns
from turtlebag.pipeline.slam.scans.clouds import PER_POINT, Clouds, make_clouds
from turtlebag.pipeline.slam.scans.range_noise import RangeNoise


class GrowingClouds:
    """Clouds of all scans so far (see `slam/clouds.py`); `noise` is the lidar's, for those still to come."""

    def __init__(self, noise: RangeNoise | None = None) -> None:
        self.noise = noise or RangeNoise()
        self._points, self._scans = Columns(), Columns()
        self._origin = np.zeros(2)

    def append(self, recording: Recording, usable_range: float, motion: SE2 | None) -> None:
        """Append a scan: a recording of it alone, and the motion during its sweep."""
        one, end = make_clouds(recording, usable_range, motion, self.noise), len(self._points)
        self._points.append(**{name: getattr(one, name) for name in PER_POINT})
        table = np.where(one.table < 0, -1, one.table + end).astype(np.int32)
        self._scans.append(table=table, end=end + one.starts[1:])
        self._origin = one.origin

    def keep(self, stays: NDArray[np.bool_]) -> None:
        """Keep only these scans (n,), numbered anew."""
        ends = self._scans["end"]
        counts = np.diff(ends, prepend=0)
        self._points.keep(np.repeat(stays, counts))
        self._scans.keep(stays)
        new_ends, table = np.cumsum(counts[stays]), self._scans["table"]
        moved = (ends[stays] - new_ends)[:, None]
        table[:] = np.where(table < 0, -1, table - moved)
        self._scans["end"][:] = new_ends

    def view(self) -> Clouds:
        """All current scans, without copying their points."""
        points, starts = {name: self._points[name] for name in PER_POINT}, np.append(0, self._scans["end"])
        return Clouds(**points, table=self._scans["table"], starts=starts, origin=self._origin)
