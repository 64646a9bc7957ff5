"""How much of the floor a robot's lidar has seen, against what it could have seen: by the truth alone."""

from __future__ import annotations

import math

import numpy as np
import scipy
from numpy.typing import NDArray

from turtlebag.datasets.grid import FREE, OccupancyGrid
from turtlebag.datasets.kernels import njit
from turtlebag.datasets.se2 import SE2, Array
from turtlebag.reports.metrics.map import EIGHT, AreaMetrics

Mask = NDArray[np.bool_]
STANDS_M = 0.2
"""Spacing of the places from which the floor that can be seen is looked at."""


def area_metrics(
    true_grid: OccupancyGrid, T_world_base: SE2, T_base_lidar: SE2, reach: float, radius: float
) -> AreaMetrics:
    """Seen: in line of sight within `reach` [m] of the lidar at one of the true poses (n,). Visible: seen, or
    in such a line from somewhere that a disc of `radius` [m] can get to from the first pose.
    """
    if len(T_world_base) == 0:
        return {"seen_m2": 0.0, "visible_m2": 0.0, "share": 0.0}
    free = true_grid.cells == FREE
    seen = floor_seen(true_grid, (T_world_base @ T_base_lidar).xy, reach)
    stands = _stands(true_grid, free, T_world_base.xy[0], radius)
    visible = seen | floor_seen(true_grid, stands, reach)
    cell = true_grid.resolution**2
    seen_m2, visible_m2 = float(seen.sum() * cell), float(visible.sum() * cell)
    share = seen_m2 / visible_m2 if visible_m2 else 0.0
    return {"seen_m2": round(seen_m2, 6), "visible_m2": round(visible_m2, 6), "share": share}


def floor_seen(grid: OccupancyGrid, places: Array, reach: float) -> Mask:
    """Free cells (rows, cols) in line of sight within `reach` [m] of one of the places (n, 2), map frame.

    A beam for every half cell of arc at the full range; it ends at the first cell that is not free.
    """
    xy = grid.T_map_grid.inverse() @ np.asarray(places, dtype=np.float64).reshape(-1, 2)
    # A place within the same quarter of a cell as one before shows nothing new.
    xy = np.unique(np.floor(4.0 * xy / grid.resolution), axis=0) / 4.0 + 0.125
    seen = np.zeros(grid.shape, dtype=np.bool_)
    beams = max(16, math.ceil(4.0 * math.pi * reach / grid.resolution))
    look_round(grid.cells == FREE, seen, xy, reach / grid.resolution, beams)
    return seen


def _stands(grid: OccupancyGrid, free: Mask, xy: Array, radius: float) -> Array:
    """Places (n, 2) on a lattice where the disc can be, joined to the place nearest to `xy`."""
    room = scipy.ndimage.distance_transform_edt(np.pad(free, 1))[1:-1, 1:-1] * grid.resolution > radius
    labels, _ = scipy.ndimage.label(room, structure=EIGHT)
    cells = np.argwhere(room)
    if len(cells) == 0:
        return np.zeros((0, 2))
    nearest = cells[np.argmin(np.linalg.norm(grid.center_of(cells) - xy, axis=1))]
    step = max(1, round(STANDS_M / grid.resolution))
    cells = np.argwhere(labels == labels[nearest[0], nearest[1]])
    return grid.center_of(cells[np.all(cells % step == nearest % step, axis=1)])


@njit(cache=True)
def look_round(free: Mask, seen: Mask, places: Array, reach: float, beams: int) -> None:
    """Mark what is seen from places (n, 2), all lengths in cells of the grid frame."""
    rows, cols = free.shape
    for k in range(places.shape[0]):
        for beam in range(beams):
            angle = 2.0 * math.pi * beam / beams
            dx, dy = math.cos(angle), math.sin(angle)
            x, y = places[k, 0], places[k, 1]
            col, row = math.floor(x), math.floor(y)
            step_c, step_r = (1 if dx > 0.0 else -1), (1 if dy > 0.0 else -1)
            next_c = (col + (step_c > 0) - x) / dx if dx != 0.0 else np.inf
            next_r = (row + (step_r > 0) - y) / dy if dy != 0.0 else np.inf
            travelled = 0.0
            while travelled <= reach and 0 <= row < rows and 0 <= col < cols and free[row, col]:
                seen[row, col] = True
                if next_c < next_r:
                    travelled = next_c
                    col += step_c
                    next_c += abs(1.0 / dx)
                else:
                    travelled = next_r
                    row += step_r
                    next_r += abs(1.0 / dy)
