"""Grids in tiles: which of them a client does not have yet."""

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
OFF_LATTICE = 1e-3
"""A share of a cell: what is left of a whole number of them by rounding is less."""
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
        side = layer.resolution
        fresh[row : row + rows, column : column + columns] = layer.cells
        tiles = changed_tiles(self._canvas, fresh)
        self._canvas, self._layer = fresh, layer
        blocks = [fresh[y : y + h, x : x + w].ravel() for x, y, w, h in tiles]
        where = {
            "version": self._version,
            "w": fresh.shape[1],
            "h": fresh.shape[0],
            "resolution": side,
            "origin": (layer.origin @ SE2.from_xyt(-column * side, -row * side, 0.0)).xyt.tolist(),
            "tiles": tiles,
        }
        return where, np.concatenate([np.zeros(0, dtype=np.uint8), *blocks])

    def _place(self, layer: MapLayer | CostLayer) -> None:
        """Find the layer's place on the canvas, or begin a canvas that it has a place on."""
        rows, columns = layer.cells.shape
        corner = self._corner_of(layer)
        if corner is None:
            self._begin((rows, columns), (0, 0))
            return
        row, column = corner
        room = row, column, self._canvas.shape[0] - row - rows, self._canvas.shape[1] - column - columns
        if min(room) >= 0:
            self._corner = corner
        else:
            low, left, high, right = (MARGIN if cells < 0 else cells for cells in room)
            self._begin((low + rows + high, left + columns + right), (low, left))

    def _begin(self, shape: tuple[int, int], corner: tuple[int, int]) -> None:
        self._canvas = np.full(shape, self._blank, dtype=np.uint8)
        self._corner = corner
        self._version += 1

    def _corner_of(self, layer: MapLayer | CostLayer) -> tuple[int, int] | None:
        """Row and column of a layer's cell (0, 0) on the canvas; None if it is not the last layer, grown.

        It is when it has the same cells and maybe more.
        """
        before = self._layer
        if before is None or before.resolution != layer.resolution:
            return None
        x, y, yaw = (before.origin.inverse() @ layer.origin).xyt.tolist()
        moved = np.array([y, x]) / layer.resolution
        whole = np.round(moved)
        ends = whole + layer.cells.shape - before.cells.shape
        if yaw != 0.0 or np.abs(moved - whole).max() > OFF_LATTICE or whole.max() > 0 or ends.min() < 0:
            return None
        row, column = (self._corner + whole).astype(int).tolist()
        return row, column


def changed_tiles(before: Cells, after: Cells) -> list[list[int]]:
    """[column, row, width, height] of the tiles in which two grids of one shape differ."""
    differs = before != after
    height, width = after.shape
    strips = np.logical_or.reduceat(differs, np.arange(0, height, TILE), axis=0)
    found = np.argwhere(np.logical_or.reduceat(strips, np.arange(0, width, TILE), axis=1)) * TILE
    return [[x, y, min(TILE, width - x), min(TILE, height - y)] for y, x in found.tolist()]
