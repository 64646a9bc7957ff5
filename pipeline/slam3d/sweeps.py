"""Raw clouds made ready: points in the base frame as if all were taken at the stamp (deskewed).

The motion within a sweep comes from the odometry's own samples, or from a twist given by the caller.
"""

from __future__ import annotations

import math
from collections.abc import Iterator

import numpy as np

from turtlebag.datasets import se3
from turtlebag.datasets.kernels import njit
from turtlebag.datasets.se2 import Array
from turtlebag.datasets.types import Recording3D

KNOTS = 9
"""Samples of the odometry over a sweep: 25 ms apart for a lidar of 5 turns a second."""


MIN_RANGE_M, MAX_RANGE_M = 0.3, 100.0
"""Nearer points may be the robot itself, farther ones are not used."""
MOST_POINTS = 60_000
"""Larger clouds are thinned evenly."""


@njit(cache=True)
def _dot(a: Array, b: Array) -> float:
    return a[0] * b[0] + a[1] * b[1] + a[2] * b[2]


@njit(cache=True)
def deskewed(points: Array, when: Array, knots: Array) -> Array:
    """Points (n, 3) taken at times `when` (n,) in [0, 1] of a sweep, seen from its start.

    knots (k, 6): tangent vectors (rotation, translation) of the pose at k equal steps of the sweep,
    relative to its start; between them they are interpolated. All in the base frame.
    """
    out = np.empty_like(points)
    w, v = np.zeros(3), np.zeros(3)
    last = knots.shape[0] - 1
    for i in range(points.shape[0]):
        at = min(max(when[i], 0.0), 1.0) * last
        k = min(int(at), last - 1)
        f = at - k
        for a in range(3):
            w[a] = (1 - f) * knots[k, a] + f * knots[k + 1, a]
            v[a] = (1 - f) * knots[k, 3 + a] + f * knots[k + 1, 3 + a]
        angle = math.sqrt(w[0] * w[0] + w[1] * w[1] + w[2] * w[2])
        one, two, three = 1.0, 0.5, 1.0 / 6.0
        if angle > 1e-4:
            one, two = math.sin(angle) / angle, (1.0 - math.cos(angle)) / (angle * angle)
            three = (1.0 - one) / (angle * angle)
        # R p + V v, with R = 1 + one W + two W W and V = 1 + two W + three W W
        for a in range(3):
            b, c = (a + 1) % 3, (a + 2) % 3
            wp, wv = w[b] * points[i, c] - w[c] * points[i, b], w[b] * v[c] - w[c] * v[b]
            # W W x = w (w . x) - x (w . w)
            wwp = w[a] * _dot(w, points[i]) - angle * angle * points[i, a]
            wwv = w[a] * _dot(w, v) - angle * angle * v[a]
            out[i, a] = points[i, a] + one * wp + two * wwp + v[a] + two * wv + three * wwv
    return out


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

    def deskewed(self, twist: Array | None) -> Array:
        """Points (n, 3) at the stamp; `twist` (6,) a second is used where odometry does not tell."""
        knots = self._knots
        if self._times is None:
            return self.points
        if knots is None:
            if twist is None:
                return self.points
            knots = np.linspace(self._start, self._end, 2)[:, None] * twist
        return deskewed(self.points, self.when(), knots)


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
    """Motion by the odometry from the stamp on, at KNOTS times between `start` and `end` [s after it]."""
    odometry, stamp = recording.odometry, int(recording.stamps_ns[index])
    if odometry is None or not int(odometry.stamps_ns[0]) <= stamp <= int(odometry.stamps_ns[-1]):
        return None
    times = np.concatenate([[0.0], np.linspace(start, end, KNOTS)])
    T = odometry.at(stamp + np.round(times * 1e9).astype(np.int64))
    return se3.log(se3.lifted(T[0].inverse() @ T[1:]))
