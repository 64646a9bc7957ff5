"""Grid search over free cells: connectivity, distances and shortest paths."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from turtlebag.datasets.kernels import njit

_STEPS = sorted(
    ((r, c) for r in (1, 0, -1) for c in (1, 0, -1) if r or c),
    key=lambda step: (np.hypot(*step), abs(step[0])),
)
_DR, _DC = np.array(_STEPS).T.copy()
_COST = np.hypot(_DR, _DC)

GridDistance = NDArray[np.float32]
"""What `grid_distance` gives: (rows, cols), in cells."""


@njit(cache=True)
def grid_distance(free: NDArray[np.bool_], row: int, col: int, limit: float) -> GridDistance:
    """Dijkstra over eight neighbours from one cell: distance in cells, inf where not reached.

    Stops where distances pass `limit`. The source itself counts as free. In place of a heap there
    are buckets (Dial 1969): a step costs 1 or sqrt(2), so that cells of length [k, k + 1) are final
    once those before are, and lead to [k + 1, k + 3) only.
    """
    rows, cols = free.shape
    distance = np.full((rows, cols), np.inf, dtype=np.float32)
    distance[row, col] = 0.0
    now = [np.int64(row * cols + col)]
    soon, later = now[:0], now[:0]
    k = 0
    while len(now) + len(soon) + len(later) > 0 and k <= limit:
        for cell in now:
            r, c = cell // cols, cell % cols
            d = distance[r, c]
            # A cell that got nearer since it was put here has been dealt with.
            if d < k or d > limit:
                continue
            for i in range(8):
                nr, nc = r + _DR[i], c + _DC[i]
                if nr < 0 or nc < 0 or nr >= rows or nc >= cols or not free[nr, nc]:
                    continue
                nd = np.float32(d + _COST[i])
                if nd < distance[nr, nc]:
                    distance[nr, nc] = nd
                    if nd < k + 2:
                        soon.append(nr * cols + nc)
                    else:
                        later.append(nr * cols + nc)
        now.clear()
        now, soon, later = soon, later, now
        k += 1
    return distance


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
