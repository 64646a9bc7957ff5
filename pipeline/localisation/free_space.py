"""Poses drawn from the free space of a map."""

from __future__ import annotations

import numpy as np

from turtlebag.datasets.grid import OccupancyGrid
from turtlebag.datasets.se2 import SE2, Array
from turtlebag.pipeline.localisation.field import free_cells


class FreeSpace:
    """Uniform distribution over all free cells and all headings."""

    def __init__(self, grid: OccupancyGrid) -> None:
        self._grid = grid
        self._cells = free_cells(grid)

    def sample(self, count: int, rng: np.random.Generator) -> Array:
        """`count` poses in the map frame, (count, 3); ValueError when no cell is free."""
        if len(self._cells) == 0:
            raise ValueError("the map has no free cell to be in")
        cells = self._cells[rng.integers(len(self._cells), size=count)]
        within = rng.uniform(-0.5, 0.5, size=(count, 2)) * self._grid.resolution
        yaw = rng.uniform(-np.pi, np.pi, size=count)
        turned = SE2.from_xyt(0.0, 0.0, float(self._grid.T_map_grid.yaw)) @ within
        return np.column_stack([self._grid.center_of(cells) + turned, yaw])
