"""Deskewed clouds: points in the base frame as if all were taken at the stamp.

The motion within a sweep comes from the odometry's own samples, or from a twist given by the caller.
"""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np

from turtlebag.datasets import se3
from turtlebag.datasets.deskew import deskewed_points
from turtlebag.datasets.durations import nanoseconds
from turtlebag.datasets.motion import KNOTS
from turtlebag.datasets.se2 import Array
from turtlebag.datasets.types import Recording3D

MIN_RANGE_M, MAX_RANGE_M = 0.3, 100.0
"""Nearer points may be the robot itself, farther ones are not used."""
LEAST_POINTS, MOST_POINTS = 50, 60_000
"""Clouds of fewer points are matched with nothing, larger ones are thinned evenly."""


class Sweep:
    """One cloud in the base frame: points (n, 3), and what is needed to deskew them to its stamp."""

    def __init__(
        self, points: Array, times: Array | None, start: float, end: float, knots: Array | None
    ) -> None:
        self.points, self._times, self._start, self._end = points, times, start, end
        self._knots = knots

    @property
    def span(self) -> tuple[float, float] | None:
        """First and last time of the points [s after the stamp] where the motion between is not known."""
        return None if self._times is None or self._knots is not None else (self._start, self._end)

    def when(self) -> Array:
        """Time of each point as a share of the span, (n,); needs a span."""
        assert self._times is not None
        return np.ascontiguousarray((self._times - self._start) / (self._end - self._start))

    def deskewed(self, twist: Array) -> Array:
        """Points (n, 3) at the stamp; `twist` (6,) a second is used where odometry does not tell."""
        if self._times is None:
            return self.points
        knots = self._knots
        if knots is None:
            knots = np.linspace(self._start, self._end, 2)[:, None] * twist
        return deskewed_points(self.points, self.when(), knots)


def sweeps_of(recording: Recording3D, T_base_lidar: Array, *, deskew: bool) -> Iterator[tuple[int, Sweep]]:
    """The clouds of a recording in order, filtered and in the base frame, with their numbers."""
    for index, cloud in enumerate(recording.clouds):
        squared = np.einsum("ij,ij->i", cloud.points, cloud.points)
        chosen = np.flatnonzero((squared >= MIN_RANGE_M**2) & (squared <= MAX_RANGE_M**2))
        chosen = chosen[:: -(-len(chosen) // MOST_POINTS) or 1]
        points = np.ascontiguousarray(se3.moved(T_base_lidar, cloud.points[chosen]))
        times = cloud.times[chosen] if cloud.times is not None and deskew else None
        if times is None or len(times) == 0 or np.ptp(times) <= 0.0:
            yield index, Sweep(points, None, 0.0, 0.0, None)
        else:
            start, end = float(times.min()), float(times.max())
            yield index, Sweep(points, times, start, end, _knots(recording, index, start, end))


def _knots(recording: Recording3D, index: int, start: float, end: float) -> Array | None:
    """Motion by the odometry from the stamp on, at KNOTS + 1 times between `start` and `end` [s after it]."""
    odometry, stamp = recording.odometry, int(recording.stamps_ns[index])
    if odometry is None or not int(odometry.stamps_ns[0]) <= stamp <= int(odometry.stamps_ns[-1]):
        return None
    times = np.concatenate([[0.0], np.linspace(start, end, KNOTS + 1)])
    T = odometry.at(stamp + nanoseconds(times))
    return se3.log(se3.lifted(T[0].inverse() @ T[1:]))
