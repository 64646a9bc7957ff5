"""Grids in tiles: which of them a client lacks."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from turtlebag.datasets.grid import OccupancyGrid
from turtlebag.datasets.se2 import SE2
from turtlebag.pipeline.studio.view import CostLayer, MapLayer

TILE = 64
MARGIN = 2 * TILE
"""Cells that a growing grid is given on each side that it has outgrown: it then starts anew less often."""
Cells = NDArray[np.uint8]


class GridTiles:
    """What one client was sent of one grid.

    The client's grid may be larger than the layer: what lies beyond holds `blank`, as all cells of a
    grid that the client starts anew do.
    """

    def __init__(self, blank: int) -> None:
        self._blank = blank
        self._version = 0
        self._layer: MapLayer | CostLayer | None = None
        self._canvas: Cells = np.zeros((0, 0), dtype=np.uint8)
        self._corner = (0, 0)
        """Row and column of the last layer's cell (0, 0) on the canvas."""

    def changed(self, layer: MapLayer | CostLayer | None) -> tuple[dict[str, Any], Cells]:
        """What the header says of the grid, and the cells of the tiles that changed, one after the other.

        No layer any more is a grid of one blank cell.
        """
        if layer is None:
            layer = MapLayer(OccupancyGrid(np.array([[self._blank]], dtype=np.uint8).view(np.int8), 1.0))
        self._place(layer)
        fresh = np.full_like(self._canvas, self._blank)
        row, column = self._corner
        rows, columns = layer.cells.shape
        fresh[row : row + rows, column : column + columns] = layer.cells
        tiles = changed_tiles(self._canvas, fresh)
        self._canvas, self._layer = fresh, layer
        blocks = [fresh[y : y + h, x : x + w].ravel() for x, y, w, h in tiles]
        corner = np.array([-column, -row]) * layer.resolution
        where = {
            "version": self._version,
            "w": fresh.shape[1],
            "h": fresh.shape[0],
            "resolution": layer.resolution,
            "origin": (layer.origin @ SE2.from_xyt(*corner.tolist(), 0.0)).xyt.tolist(),
            "tiles": tiles,
        }
        return where, np.concatenate([np.zeros(0, dtype=np.uint8), *blocks])

    def _place(self, layer: MapLayer | CostLayer) -> None:
        """Find the layer's place on the canvas; where it has none, begin a new one, that can grow if it does."""
        moved = self._moved(layer)
        rows, columns = layer.cells.shape
        if moved is None or self._layer is None:
            self._begin((rows, columns), (0, 0))
            return
        old_rows, old_columns = self._layer.cells.shape
        row, column = self._corner[0] + moved[0], self._corner[1] + moved[1]
        if moved[0] > 0 or moved[1] > 0 or moved[0] + rows < old_rows or moved[1] + columns < old_columns:
            self._begin((rows, columns), (0, 0))  # it does not hold what there was: another grid
            return
        height, width = self._canvas.shape
        low = MARGIN if row < 0 else row
        left = MARGIN if column < 0 else column
        high = MARGIN if row + rows > height else height - row - rows
        right = MARGIN if column + columns > width else width - column - columns
        if (low, left) == (row, column) and (high, right) == (height - row - rows, width - column - columns):
            self._corner = row, column
        else:
            self._begin((low + rows + high, left + columns + right), (low, left))

    def _begin(self, shape: tuple[int, int], corner: tuple[int, int]) -> None:
        self._canvas = np.full(shape, self._blank, dtype=np.uint8)
        self._corner = corner
        self._version += 1

    def _moved(self, layer: MapLayer | CostLayer) -> tuple[int, int] | None:
        """Row and column of a layer's cell (0, 0) in the cells of the last; None off their lattice."""
        before = self._layer
        if before is None or before.resolution != layer.resolution:
            return None
        x, y, yaw = (before.origin.inverse() @ layer.origin).xyt.tolist()
        cells = np.array([y, x]) / layer.resolution
        if yaw != 0.0 or np.abs(cells - np.round(cells)).max() > 1e-3:
            return None
        row, column = np.round(cells).astype(int).tolist()
        return row, column


def changed_tiles(before: Cells, after: Cells) -> list[list[int]]:
    """[column, row, width, height] of the tiles in which two grids of one shape differ."""
    differs = before != after
    height, width = after.shape
    strips = np.logical_or.reduceat(differs, np.arange(0, height, TILE), axis=0)
    found = np.argwhere(np.logical_or.reduceat(strips, np.arange(0, width, TILE), axis=1)) * TILE
    return [[x, y, min(TILE, width - x), min(TILE, height - y)] for y, x in found.tolist()]
