"""Walls of an occupancy grid as thin as the range noise allows."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from turtlebag.datasets.grid import FREE, OCCUPIED, UNKNOWN
from turtlebag.datasets.kernels import njit

# Returns of a distant wall scatter over this many cells behind it (LDS-01 at 3.5 m: 4 cm and more in twenty).
BEHIND_CELLS = 3


@njit(cache=True)
def thin(cells: NDArray[np.int8], hits: NDArray[np.uint16], behind: float, before: float) -> None:
    """Make walls as thin as the range noise allows: of two occupied cells one behind the other the weaker
    goes.

    A cell behind a wall (no free neighbour) becomes unknown when one that does face free space, at most
    BEHIND_CELLS before it with nothing free between, was hit more than 1 / `behind` times as often: its
    hits overshot. A cell that faces free space becomes free when the occupied one right behind it was hit
    more than 1 / `before` times as often: its hits fell short. Where both are hit alike the surface lies on
    their border, and both stay.
    """
    rows, cols = cells.shape
    walls = 0
    for cell in cells.flat:
        walls += cell == OCCUPIED
    gone, n = np.empty(walls, dtype=np.int64), 0
    for row in range(rows):
        for col in range(cols):
            inside = cells[row, col] == OCCUPIED and not beside(cells, row, col, FREE)
            if inside and overshot(cells, hits, row, col, behind):
                gone[n], n = row * cols + col, n + 1
    for k in range(n):
        cells[gone[k] // cols, gone[k] % cols] = UNKNOWN
    n = 0
    for row in range(1, rows - 1):
        for col in range(1, cols - 1):
            # a cell next to unknown space closes the wall and stays
            closed = cells[row, col] == OCCUPIED and not beside(cells, row, col, UNKNOWN)
            if closed and fell_short(cells, hits, row, col, before):
                gone[n], n = row * cols + col, n + 1
    for k in range(n):
        cells[gone[k] // cols, gone[k] % cols] = FREE


@njit(cache=True)
def overshot(cells: NDArray, hits: NDArray, row: int, col: int, behind: float) -> bool:
    """Whether the hits of an occupied cell lie behind the wall that they belong to."""
    rows, cols = cells.shape
    for dr, dc in ((1, 0), (-1, 0), (0, 1), (0, -1)):
        r, c = row, col
        for _ in range(BEHIND_CELLS):
            r, c = r + dr, c + dc
            if not (0 <= r < rows and 0 <= c < cols) or cells[r, c] == FREE:
                break
            wall = cells[r, c] == OCCUPIED and beside(cells, r, c, FREE)
            if wall and hits[row, col] < behind * hits[r, c]:
                return True
    return False


@njit(cache=True)
def fell_short(cells: NDArray, hits: NDArray, row: int, col: int, before: float) -> bool:
    """Whether the hits of an occupied cell lie before the wall that they belong to."""
    for dr, dc in ((1, 0), (-1, 0), (0, 1), (0, -1)):
        r, c = row + dr, col + dc
        behind = cells[row - dr, col - dc] == FREE and cells[r, c] == OCCUPIED
        if behind and hits[row, col] < before * hits[r, c]:
            return True
    return False


@njit(cache=True)
def beside(cells: NDArray[np.int8], row: int, col: int, what: int) -> bool:
    """Whether one of the four neighbours is `what`."""
    rows, cols = cells.shape
    return (
        (row > 0 and cells[row - 1, col] == what)
        or (row < rows - 1 and cells[row + 1, col] == what)
        or (col > 0 and cells[row, col - 1] == what)
        or (col < cols - 1 and cells[row, col + 1] == what)
    )
