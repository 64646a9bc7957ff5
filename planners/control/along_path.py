"""Path following: the robot's position along a path, and the lookahead point."""

from __future__ import annotations

import math

import numpy as np

from turtlebag.datasets.kernels import njit
from turtlebag.datasets.se2 import Array


def arc_lengths(points: Array) -> Array:
    """Distance along a polyline (n, 2) at each of its points, (n,) [m]."""
    return np.concatenate([[0.0], np.cumsum(np.linalg.norm(np.diff(points, axis=0), axis=1))])


@njit(cache=True)
def project(
    points: Array, lengths: Array, x: float, y: float, s_from: float, s_to: float
) -> tuple[float, float]:
    """Nearest place on the polyline between two arc lengths: (its arc length, distance to it)."""
    best_s, best_d2 = s_from, np.inf
    for k in range(len(points) - 1):
        if lengths[k + 1] < s_from or lengths[k] > s_to:
            continue
        ax, ay = points[k, 0], points[k, 1]
        dx, dy = points[k + 1, 0] - ax, points[k + 1, 1] - ay
        n2 = dx * dx + dy * dy
        f = 0.0 if n2 == 0.0 else min(max(((x - ax) * dx + (y - ay) * dy) / n2, 0.0), 1.0)
        d2 = (ax + f * dx - x) ** 2 + (ay + f * dy - y) ** 2
        if d2 < best_d2:
            best_d2, best_s = d2, lengths[k] + f * (lengths[k + 1] - lengths[k])
    return best_s, math.sqrt(best_d2)


@njit(cache=True)
def point_at(points: Array, lengths: Array, s: float) -> tuple[float, float]:
    """The point at an arc length of the polyline, held at its ends."""
    k = min(max(np.searchsorted(lengths, s) - 1, 0), points.shape[0] - 2)
    span = lengths[k + 1] - lengths[k]
    f = 0.0 if span == 0.0 else min(max((s - lengths[k]) / span, 0.0), 1.0)
    return (
        points[k, 0] + f * (points[k + 1, 0] - points[k, 0]),
        points[k, 1] + f * (points[k + 1, 1] - points[k, 1]),
    )
