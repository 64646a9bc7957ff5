"""Grid search over free cells: connectivity, distances and shortest paths."""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

from turtlebag.datasets.kernels import njit

_STEPS = sorted(
    ((r, c) for r in (1, 0, -1) for c in (1, 0, -1) if r or c),
    key=lambda step: (np.hypot(*step), abs(step[0])),
)
_DR, _DC = np.array(_STEPS).T.copy()

GridDistance = NDArray[np.float32]
"""What `grid_distance` gives: (rows, cols), in cells."""


@njit(cache=True)
def grid_distance(free: NDArray[np.bool_], row: int, col: int, limit: float) -> GridDistance:
    """Dijkstra over eight neighbours from one cell: distance in cells, inf where not reached.

    Stops where distances pass `limit`. The source itself counts as free. In place of a heap there
    are buckets (Dial 1969): a step costs 1 or sqrt(2), so that cells of length [k, k + 1) are final
    once those before are, and lead to [k + 1, k + 3) only.
    """
    rows, width = free.shape[0] + 2, free.shape[1] + 2
    # What is not free has distance 0, so that no way is shorter, and so has a rim around the grid; cells are
    # numbered row by row.
    distance = np.zeros(rows * width, dtype=np.float32)
    for r in range(free.shape[0]):
        for c in range(free.shape[1]):
            if free[r, c]:
                distance[(r + 1) * width + c + 1] = np.inf
    # A cell is put in a bucket at most once for each neighbour; memory that is not used costs nothing.
    bucket, count = np.empty((3, 8 * rows * width), dtype=np.int32), np.zeros(3, dtype=np.int64)
    source = (row + 1) * width + col + 1
    bucket[0, 0], count[0], distance[source] = source, 1, 0.0
    k = 0
    while count.sum() > 0 and k <= limit:
        now, soon, later = k % 3, (k + 1) % 3, (k + 2) % 3
        for j in range(count[now]):
            cell = np.int64(bucket[now, j])
            d = distance[cell]
            # A cell that got nearer since it was put here has been dealt with.
            if d < k or d > limit:
                continue
            straight, diagonal = np.float32(d + 1.0), np.float32(d + math.sqrt(2.0))
            for beside in (cell + 1, cell - 1, cell + width, cell - width):
                if straight < distance[beside]:
                    distance[beside] = straight
                    bucket[soon, count[soon]] = beside
                    count[soon] += 1
            into = soon if diagonal < k + 2 else later
            for beside in (cell + width + 1, cell + width - 1, cell - width + 1, cell - width - 1):
                if diagonal < distance[beside]:
                    distance[beside] = diagonal
                    bucket[into, count[into]] = beside
                    count[into] += 1
        count[now] = 0
        k += 1
    found = distance.reshape(rows, width)[1:-1, 1:-1].copy()
    for r in range(free.shape[0]):
        for c in range(free.shape[1]):
            if not free[r, c] and (r != row or c != col):
                found[r, c] = np.inf
    return found


@njit(cache=True)
def descend(distance: GridDistance, row: int, col: int) -> NDArray[np.int64]:
    """Cells (n, 2) from (row, col) down a grid distance to its source."""
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
