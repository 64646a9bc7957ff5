"""Walls that a person draws on a finished map, or erases from it: glass, legs, people."""

from __future__ import annotations

from collections.abc import Sequence
from itertools import pairwise
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from turtlebag.datasets.errors import InputError
from turtlebag.datasets.grid import FREE, MAX_CELLS, OCCUPIED, UNKNOWN, OccupancyGrid
from turtlebag.datasets.se2 import SE2, Array
from turtlebag.pipeline.slam.graph.edits import WallEdit
from turtlebag.pipeline.slam.grid import bands

# Cells as near to a line as this are on it, so that no line has gaps.
LINE_CELLS = 0.71
# Lines are painted in pieces of this length, or as long as they are half wide.
PIECE_CELLS = 64.0
SURE = 255
"""The confidence in a cell that a person drew or erased."""


class Stroke(NamedTuple):
    """An edit in cells, x first, whose centres are whole numbers: corners (n, 2), half its width, and what
    becomes of the cells."""

    corners: Array
    reach: float
    value: int


def with_walls(
    grid: OccupancyGrid, confidence: NDArray[np.uint8], walls: Sequence[WallEdit], T_map_base: SE2
) -> tuple[OccupancyGrid, NDArray[np.uint8]]:
    """The map, which is not turned, and its confidence (rows, cols), with the edits in their order.

    `T_map_base` (n,) are the poses of all scans. The map grows where walls are drawn beyond it; InputError if
    that is too far.
    """
    if not walls:
        return grid, confidence
    strokes, size = [_stroke(wall, grid, T_map_base) for wall in walls], grid.resolution
    first, shape = _extent(grid.shape, strokes)
    cells, sure = np.full(shape, UNKNOWN, dtype=np.int8), np.zeros(shape, dtype=np.uint8)
    col, row = (-first).tolist()
    before = slice(row, row + grid.shape[0]), slice(col, col + grid.shape[1])
    cells[before], sure[before] = grid.cells, confidence
    for corners, reach, value in strokes:
        for a, b in pairwise(_pieces(corners - first, reach)):
            _paint(cells, a, b, reach, value)
            _paint(sure, a, b, reach, SURE)
    corner = grid.T_map_grid.xy if not first.any() else (np.rint(grid.T_map_grid.xy / size) + first) * size
    return OccupancyGrid(cells, size, SE2(np.append(corner, 0.0))), sure


def _stroke(wall: WallEdit, grid: OccupancyGrid, T_map_base: SE2) -> Stroke:
    corners = (wall.xy_map(T_map_base) - grid.T_map_grid.xy) / grid.resolution - 0.5
    reach = max(0.5 * wall.width / grid.resolution, LINE_CELLS)
    return Stroke(corners, reach, OCCUPIED if wall.do == "draw" else FREE)


def _extent(shape: tuple[int, int], strokes: Sequence[Stroke]) -> tuple[NDArray[np.int64], tuple[int, int]]:
    """The first cell (col, row) of a map of this shape that has room for all that is drawn, and its shape."""
    drawn = [one for one in strokes if one.value == OCCUPIED]
    low = np.min([[0.0, 0.0], *(one.corners.min(axis=0) - one.reach for one in drawn)], axis=0)
    high = np.max(
        [[shape[1] - 1, shape[0] - 1], *(one.corners.max(axis=0) + one.reach for one in drawn)], axis=0
    )
    first, last = np.ceil(low).astype(np.int64), np.floor(high).astype(np.int64)
    cols, rows = (last - first + 1).tolist()
    if rows * cols > MAX_CELLS:
        raise InputError(f"--edits: walls: drawn so far away that the map would have {rows} x {cols} cells")
    return first, (rows, cols)


def _pieces(corners: Array, reach: float) -> Array:
    """The corners (n, 2), the last one once more, and others between them: there is little around a short
    piece."""
    ends, length = np.append(corners[1:], corners[-1:], axis=0), max(PIECE_CELLS, reach)
    counts = np.ceil(np.linalg.norm(ends - corners, axis=1) / length).astype(int).clip(1).tolist()
    lines = zip(corners, ends, counts, strict=True)
    between = [np.linspace(a, b, count, endpoint=False) for a, b, count in lines]
    return np.concatenate([*between, corners[-1:]])


def _paint(cells: NDArray, a: Array, b: Array, reach: float, value: int) -> None:
    """Set all cells (rows, cols) whose centre is at most `reach` away from the line from a to b (2,)."""
    size = np.array(cells.shape[::-1])
    col, row = np.clip(np.ceil(np.minimum(a, b) - reach), 0, size).astype(int)
    end_col, end_row = np.clip(np.floor(np.maximum(a, b) + reach) + 1, 0, size).astype(int)
    around, (along_x, along_y) = cells[row:end_row, col:end_col], b - a
    squared = along_x**2 + along_y**2
    x = np.arange(col, end_col) - a[0]
    for rows in bands(around):
        part = around[rows]
        y = row + rows.start + np.arange(len(part))[:, None] - a[1]
        share = np.clip((x * along_x + y * along_y) / squared, 0.0, 1.0) if squared > 0.0 else 0.0
        part[np.hypot(x - share * along_x, y - share * along_y) <= reach] = value
