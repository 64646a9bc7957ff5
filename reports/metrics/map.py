"""How well an occupancy grid shows the true surfaces.

The true map is the world rasterised at the lidar's height, where walls and pillars are solid. A
lidar sees only their skins, and only from where a robot can be, so the map is compared with the
VISIBLE SURFACE: true occupied cells that touch (8-neighbourhood) the true free space the mapped
free space lies in. Grids with different origins, resolutions or yaws are compared by resampling:
each true surface cell's centre is looked up in the map's cells and back, never by array index.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import TypedDict

import numpy as np
import scipy
from numpy.typing import NDArray

from turtlebag.datasets.grid import FREE, OCCUPIED_FROM, OccupancyGrid
from turtlebag.datasets.se2 import Array

EIGHT = np.ones((3, 3), dtype=bool)


@dataclass(frozen=True, eq=False)
class MapError:
    """Centres of mapped occupied cells and their distance to the nearest visible true surface cell.

    `xy_mapped` is (n, 2) in the map frame, `error_m` (n,), `xy_true` (m, 2) the visible surface and
    `missed_m` (m,) how far each true surface cell is from the nearest mapped one.
    """

    xy_mapped: Array
    error_m: Array
    xy_true: Array
    missed_m: Array


def occupied(grid: OccupancyGrid) -> NDArray[np.bool_]:
    """Occupied cells, (rows, cols)."""
    return grid.cells >= OCCUPIED_FROM


def visible_surface(true_grid: OccupancyGrid, grid: OccupancyGrid) -> NDArray[np.bool_]:
    """True occupied cells a robot in the mapped free space could see, (rows, cols) of `true_grid`."""
    solid = occupied(true_grid)
    rooms, count = scipy.ndimage.label(~solid)
    if count == 0:
        return solid
    free = np.argwhere((grid.cells >= FREE) & (grid.cells < OCCUPIED_FROM))
    cells = true_grid.cell_of(grid.center_of(free))
    cells = cells[true_grid.contains(cells)]
    votes = np.bincount(rooms[cells[:, 0], cells[:, 1]], minlength=count + 1)
    votes[0] = 0
    room = rooms == np.argmax(votes) if votes.any() else rooms > 0
    return solid & scipy.ndimage.binary_dilation(room, EIGHT)


def map_error(grid: OccupancyGrid, true_grid: OccupancyGrid) -> MapError:
    """Distances between mapped occupied cells and the visible true surface, both ways."""
    xy_mapped = walls(grid)
    xy_true = true_grid.center_of(np.argwhere(visible_surface(true_grid, grid)))
    return MapError(xy_mapped, nearest_m(xy_mapped, xy_true), xy_true, nearest_m(xy_true, xy_mapped))


def nearest_m(points: Array, targets: Array) -> Array:
    """Distance of each point (n, 2) to the nearest target (m, 2), (n,) [m]; inf without targets."""
    if len(targets) == 0:
        return np.full(len(points), np.inf)
    return np.asarray(scipy.spatial.cKDTree(targets).query(points)[0], dtype=np.float64)


def walls(grid: OccupancyGrid) -> Array:
    """Centres of the occupied cells, (n, 2)."""
    return grid.center_of(np.argwhere(occupied(grid)))


def walls_in(grid: OccupancyGrid, other: OccupancyGrid) -> NDArray[np.bool_]:
    """Which occupied cells of a grid, (n,) in their order, have one of another within a cell."""
    return nearest_m(walls(grid), walls(other)) <= _one_cell(max(grid.resolution, other.resolution))


class WallErrors(TypedDict):
    """Centres of mapped occupied cells to the nearest visible surface cell's [m]; None without any."""

    mean: float | None
    p95: float | None
    within_one_cell: float | None


class MapMetrics(TypedDict):
    """How well a grid shows the true surfaces."""

    iou: float
    iou_one_cell: float
    coverage: float
    occupied_error_m: WallErrors


class AreaMetrics(TypedDict):
    """True free floor that was seen and could have been seen [m2], and the share of the one in the other."""

    seen_m2: float
    visible_m2: float
    share: float


def map_metrics(grid: OccupancyGrid, true_grid: OccupancyGrid) -> MapMetrics:
    """iou: mapped occupied cells against visible surface cells, cell for cell, no tolerance: harsh,
    because a surface on a cell border may fall on either side. iou_one_cell: the same with a cell
    counted as matched when its nearest counterpart is at most one cell (edge or corner neighbour)
    away, P R / (P + R - P R) of the two matched fractions. coverage: the recall R alone.
    A map without occupied cells has iou 0 and no error (None).
    """
    error = map_error(grid, true_grid)
    if len(error.xy_mapped) == 0 or len(error.xy_true) == 0:
        nothing: WallErrors = {"mean": None, "p95": None, "within_one_cell": None}
        return {"iou": 0.0, "iou_one_cell": 0.0, "coverage": 0.0, "occupied_error_m": nothing}
    mapped = _unique_cells(true_grid.cell_of(error.xy_mapped))
    true = _unique_cells(true_grid.cell_of(error.xy_true))
    both = len(mapped & true)
    reach = _one_cell(max(grid.resolution, true_grid.resolution))
    precision, recall = float(np.mean(error.error_m <= reach)), float(np.mean(error.missed_m <= reach))
    matched = precision * recall
    return {
        "iou": both / (len(mapped) + len(true) - both),
        "iou_one_cell": matched / (precision + recall - matched) if matched > 0 else 0.0,
        "coverage": recall,
        "occupied_error_m": {
            "mean": float(np.mean(error.error_m)),
            "p95": float(np.percentile(error.error_m, 95.0)),
            "within_one_cell": precision,
        },
    }


def _one_cell(side: float) -> float:
    """Distance between diagonal neighbours, with room for rounding [m]."""
    return side * float(np.sqrt(2.0)) + 1e-6


def _unique_cells(cells: NDArray[np.int64]) -> set[tuple[int, int]]:
    return {(int(row), int(col)) for row, col in cells}
