"""The occupancy grid, and the conversion between metres and cells."""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from turtlebag.datasets.se2 import SE2, Array

UNKNOWN, FREE, OCCUPIED = -1, 0, 100
FREE_TO, OCCUPIED_FROM = 25, 65
"""map_saver's thresholds [percent]: what lies between them is unknown."""
MAX_CELLS, MAX_GB = 64_000_000, 5
"""Cells of a map that others can work with (8000 x 8000), and the memory that localising in them takes."""

Cells = NDArray[np.int64]


@dataclass(frozen=True, eq=False)
class OccupancyGrid:
    """Cells of nav_msgs/OccupancyGrid: -1 unknown, 0 free .. 100 occupied.

    `cells` is (rows, cols) int8; row 0 has the lowest y, column 0 the lowest x of the grid's own
    axes. `T_map_grid` places the OUTER corner of cell (0, 0) in the map frame; its yaw is 0 for
    every map of ours, but foreign maps may be turned.
    """

    cells: NDArray[np.int8]
    resolution: float
    T_map_grid: SE2 = field(default_factory=SE2.identity)

    def __post_init__(self) -> None:
        if self.cells.ndim != 2 or self.cells.size == 0:
            raise ValueError(f"a grid needs two non-empty axes, got shape {self.cells.shape}")
        if not self.resolution > 0.0:
            raise ValueError(f"grid resolution must be positive, got {self.resolution}")

    @property
    def shape(self) -> tuple[int, int]:
        """(rows, cols)."""
        return self.cells.shape[0], self.cells.shape[1]

    def cell_of(self, points_map: Array) -> Cells:
        """(row, col) of each point, (..., 2) integers, not clipped to the grid."""
        xy = self.T_map_grid.inverse() @ np.asarray(points_map, dtype=np.float64)
        return np.floor(xy[..., ::-1] / self.resolution).astype(np.int64)

    def center_of(self, cells: Cells) -> Array:
        """Map coordinates of cell centres, (..., 2) [m], from (..., 2) (row, col)."""
        xy_grid = (np.asarray(cells, dtype=np.float64)[..., ::-1] + 0.5) * self.resolution
        return self.T_map_grid @ xy_grid

    def contains(self, cells: Cells) -> NDArray[np.bool_]:
        """Whether each (row, col) lies on the grid."""
        return np.all((cells >= 0) & (cells < self.shape), axis=-1)

    def value_at(self, points_map: Array) -> NDArray[np.int8]:
        """Cell value under each point; UNKNOWN off the grid."""
        cells = self.cell_of(points_map)
        inside = self.contains(cells)
        clipped = np.clip(cells, 0, np.array(self.shape) - 1)
        return np.where(inside, self.cells[clipped[..., 0], clipped[..., 1]], UNKNOWN).astype(np.int8)

    def extent(self) -> tuple[float, float, float, float]:
        """(x_min, x_max, y_min, y_max) for drawing; of an unturned grid."""
        x, y = float(self.T_map_grid.x), float(self.T_map_grid.y)
        return x, x + self.shape[1] * self.resolution, y, y + self.shape[0] * self.resolution
