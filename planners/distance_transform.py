"""Exact Euclidean distance transform (Meijster, Roerdink and Hesselink 2000), compiled."""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

from turtlebag.datasets.kernels import njit

Field32 = NDArray[np.float32]


@njit(cache=True)
def distance_field(blocked: NDArray[np.bool_], scale: float) -> Field32:
    """Distance from each cell's centre to the nearest blocked cell's centre, (rows, cols), times `scale`.

    inf where nothing is blocked at all.
    """
    rows, cols = blocked.shape
    far = rows + cols
    below = np.empty((rows, cols), dtype=np.int64)
    for c in range(cols):
        below[0, c] = 0 if blocked[0, c] else far
    for r in range(1, rows):
        for c in range(cols):
            below[r, c] = 0 if blocked[r, c] else below[r - 1, c] + 1
    for r in range(rows - 2, -1, -1):
        for c in range(cols):
            below[r, c] = min(below[r, c], below[r + 1, c] + 1)
    out = np.empty((rows, cols), dtype=np.float32)
    start = np.empty(cols, dtype=np.int64)
    parabola = np.empty(cols, dtype=np.int64)
    for r in range(rows):
        _lower_envelope(below[r], start, parabola, far, scale, out[r])
    return out


@njit(cache=True)
def _lower_envelope(
    heights: NDArray[np.int64],
    start: NDArray[np.int64],
    parabola: NDArray[np.int64],
    far: int,
    scale: float,
    out: Field32,
) -> None:
    """One row: the least of (x - i)^2 + heights[i]^2 over i, for every x; integers throughout."""
    n, top = len(heights), 0
    start[0], parabola[0] = 0, 0
    for u in range(1, n):
        hu = heights[u] * heights[u]
        while top >= 0:
            i, x = parabola[top], start[top]
            if (x - i) * (x - i) + heights[i] * heights[i] <= (x - u) * (x - u) + hu:
                break
            top -= 1
        if top < 0:
            top = 0
            parabola[0], start[0] = u, 0
            continue
        i = parabola[top]
        # The first x at which u is nearer than i.
        x = 1 + (u * u - i * i + hu - heights[i] * heights[i]) // (2 * (u - i))
        if x < n:
            top += 1
            parabola[top], start[top] = u, x
    for x in range(n - 1, -1, -1):
        i = parabola[top]
        if heights[i] >= far:
            out[x] = np.inf
        else:
            out[x] = math.sqrt((x - i) * (x - i) + heights[i] * heights[i]) * scale
        if x == start[top]:
            top -= 1
