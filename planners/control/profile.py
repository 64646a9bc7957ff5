"""How fast a path may be driven at each of its points: curves, tight places, and braking before them."""

from __future__ import annotations

import math

import numpy as np

from turtlebag.datasets.kernels import njit
from turtlebag.datasets.se2 import Array


@njit(cache=True)
def curvature_along(points: Array, lengths: Array, arm: float) -> Array:
    """Curvature at each point of a polyline (n, 2) from the circle through points `arm` before and after."""
    n = points.shape[0]
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
