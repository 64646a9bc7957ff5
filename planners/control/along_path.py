"""Path following: the robot's position along a path, the lookahead point, and speed limits along the path."""

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


@njit(cache=True)
def curvature_along(points: Array, lengths: Array, arm: float) -> Array:
    """Curvature at each point of a polyline (n, 2) from the circle through points `arm` before and after."""
    n = len(points)
    out = np.zeros(n)
    for k in range(1, n - 1):
        i, j = k, k
        while i > 0 and lengths[k] - lengths[i] < arm:
            i -= 1
        while j < n - 1 and lengths[j] - lengths[k] < arm:
            j += 1
        ax, ay = points[k, 0] - points[i, 0], points[k, 1] - points[i, 1]
        bx, by = points[j, 0] - points[k, 0], points[j, 1] - points[k, 1]
        cx, cy = points[j, 0] - points[i, 0], points[j, 1] - points[i, 1]
        product = math.hypot(ax, ay) * math.hypot(bx, by) * math.hypot(cx, cy)
        if product > 1e-12:
            out[k] = 2.0 * abs(ax * by - ay * bx) / product
    return out


@njit(cache=True)
def braked(limits: Array, lengths: Array, braking: float) -> Array:
    """Speed limits (n,) lowered so that each can be kept by braking: v_k^2 <= v_{k+1}^2 + 2 b ds."""
    out = limits.copy()
    for k in range(len(out) - 2, -1, -1):
        reachable = math.sqrt(out[k + 1] ** 2 + 2.0 * braking * (lengths[k + 1] - lengths[k]))
        out[k] = min(out[k], reachable)
    return out
