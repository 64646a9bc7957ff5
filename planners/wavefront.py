"""Distances along the free floor: what is connected, how long the way is, and where the way lies."""

from __future__ import annotations

import heapq

import numpy as np
from numba import njit
from numpy.typing import NDArray

SQRT2 = float(np.sqrt(2.0))
_STEPS = (
    (0, 1, 1.0),
    (0, -1, 1.0),
    (1, 0, 1.0),
    (-1, 0, 1.0),
    (1, 1, SQRT2),
    (1, -1, SQRT2),
    (-1, 1, SQRT2),
    (-1, -1, SQRT2),
)
_DR = np.array([step[0] for step in _STEPS])
_DC = np.array([step[1] for step in _STEPS])
_COST = np.array([step[2] for step in _STEPS])

Wave = NDArray[np.float32]


@njit(cache=True)
def wave(free: NDArray[np.bool_], row: int, col: int, limit: float) -> Wave:
    """Dijkstra over eight neighbours from one cell: distance in cells, inf where not reached.

    Stops where distances pass `limit`. The source itself counts as free.
    """
    rows, cols = free.shape
    distance = np.full((rows, cols), np.inf, dtype=np.float32)
    distance[row, col] = 0.0
    queue = [(np.float32(0.0), np.int64(row * cols + col))]
    while len(queue) > 0:
        d, cell = heapq.heappop(queue)
        r, c = cell // cols, cell % cols
        if d > distance[r, c]:
            continue
        if d > limit:
            break
        for k in range(8):
            nr, nc = r + _DR[k], c + _DC[k]
            if nr < 0 or nc < 0 or nr >= rows or nc >= cols or not free[nr, nc]:
                continue
            nd = np.float32(d + _COST[k])
            if nd < distance[nr, nc]:
                distance[nr, nc] = nd
                heapq.heappush(queue, (nd, nr * cols + nc))
    return distance


@njit(cache=True)
def descend(distance: Wave, row: int, col: int) -> NDArray[np.int64]:
    """Cells (n, 2) from (row, col) down a wave to its source."""
    rows, cols = distance.shape
    path = [(np.int64(row), np.int64(col))]
    r, c = row, col
    while distance[r, c] > 0.0:
        best, br, bc = distance[r, c], r, c
        for k in range(8):
            nr, nc = r + _DR[k], c + _DC[k]
            if 0 <= nr < rows and 0 <= nc < cols and distance[nr, nc] < best:
                best, br, bc = distance[nr, nc], nr, nc
        if br == r and bc == c:
            break
        r, c = br, bc
        path.append((np.int64(r), np.int64(c)))
    out = np.empty((len(path), 2), dtype=np.int64)
    for k in range(len(path)):
        out[k, 0], out[k, 1] = path[k]
    return out
