"""The true map of a world: the map of a perfect lidar that has been everywhere.

A cell is OCCUPIED if it contains a surface visible from the floor that is reachable
from the spawn, FREE if it belongs to that floor, and UNKNOWN elsewhere: inside solids, behind
walls, outside. So it can be compared, cell by cell, with a map built from scans, which never see
the inside of a wall.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
import scipy

from turtlebag.datasets.grid import FREE, OCCUPIED, UNKNOWN, OccupancyGrid
from turtlebag.datasets.se2 import SE2, Array
from turtlebag.sim.shapes import Bools, Mesh, Solid, contains

INSET_M = 1e-3
"""Surfaces are sampled this far inside the solid, so that one on a cell border falls in the solid's cell."""

AT_ONCE = 1 << 20
"""Cells times edges that are looked at together: a solid may fill the largest map."""


def true_map(
    solids: Sequence[Solid],
    z: float,
    bounds: tuple[float, float, float, float],
    start_xy: Array,
    resolution: float,
) -> OccupancyGrid:
    """True map at height z over `bounds` (x_min, x_max, y_min, y_max), seen from start_xy.

    `solids` are those that cross that height.
    """
    # Whole cells, aligned to multiples of the resolution.
    x0, y0 = np.floor(bounds[0] / resolution + 1e-9), np.floor(bounds[2] / resolution + 1e-9)
    cols = int(np.ceil(bounds[1] / resolution - 1e-9) - x0)
    rows = int(np.ceil(bounds[3] / resolution - 1e-9) - y0)
    cells = np.full((rows, cols), UNKNOWN, dtype=np.int8)
    grid = OccupancyGrid(cells, resolution, SE2.from_xyt(x0 * resolution, y0 * resolution, 0.0))

    surface = _surface_cells(grid, solids, z)
    open_floor = ~surface & ~_filled_cells(grid, solids, z)
    regions, _ = scipy.ndimage.label(open_floor)
    start = grid.cell_of(np.asarray(start_xy))
    region = regions[tuple(start)] if grid.contains(start) else 0
    free = (regions == region) & open_floor if region else np.zeros_like(open_floor)

    seen = scipy.ndimage.binary_dilation(free, structure=np.ones((3, 3), dtype=bool))
    cells[free] = FREE
    cells[surface & seen] = OCCUPIED
    return grid


def _filled_cells(grid: OccupancyGrid, solids: Sequence[Solid], z: float) -> Bools:
    """Cells whose centre lies within a solid, (rows, cols)."""
    filled = np.zeros(grid.shape, dtype=bool)
    last = np.array(grid.shape) - 1
    for solid in solids:
        x_min, x_max, y_min, y_max = solid.bounds()
        corners = grid.cell_of(np.array([[x_min, y_min], [x_max, y_max]]))
        (row, col), (end_row, end_col) = np.clip(corners, 0, last)
        wide = (end_col - col + 1) * max(len(solid.polygon), 1)
        high = max(AT_ONCE // wide, 1)
        for low in range(row, end_row + 1, high):
            part = np.s_[low : min(low + high, end_row + 1), col : end_col + 1]
            centres = grid.center_of(np.stack([*np.mgrid[part]], axis=-1)).reshape(-1, 2)
            filled[part] |= contains([solid], z, centres).reshape(filled[part].shape)
    return filled


def _surface_cells(grid: OccupancyGrid, solids: Sequence[Solid], z: float) -> Bools:
    """Cells through which an uncovered surface passes, (rows, cols) bool."""
    step = grid.resolution / 25.0
    out = np.zeros(grid.shape, dtype=bool)
    bounds = np.array([solid.bounds() for solid in solids]).reshape(-1, 4)
    for number, solid in enumerate(solids):
        points, outward = _outline(solid, z, step)
        # A stretch that is sunk in another solid is no surface.
        near = np.flatnonzero(_near(bounds, bounds[number])).tolist()
        others = [solids[other] for other in near if other != number]
        exposed = ~contains(others, z, points + 2.0 * INSET_M * outward)
        hit = grid.cell_of((points - INSET_M * outward)[exposed])
        hit = hit[grid.contains(hit)]
        out[hit[:, 0], hit[:, 1]] = True
    return out


def _near(bounds: Array, own: Array) -> Bools:
    """Which boxes (n, 4) of x_min, x_max, y_min, y_max overlap this one, or nearly, (n,)."""
    pad = 4.0 * INSET_M
    x_min, x_max, y_min, y_max = bounds.T
    beside = (x_min - pad < own[1]) & (own[0] - pad < x_max)
    return np.asarray(beside & (y_min - pad < own[3]) & (own[2] - pad < y_max))


def _outline(solid: Solid, z: float, step: float) -> tuple[Array, Array]:
    """Points along a solid's outline at most `step` apart, and the outward normal at each, (n, 2) both."""
    segments, circles = solid.outline(z, z)
    points: list[Array] = [np.zeros((0, 2))]
    normals: list[Array] = [np.zeros((0, 2))]
    for x, y, r in circles:
        n = max(16, int(np.ceil(2.0 * np.pi * r / step)))
        angles = np.arange(n) * (2.0 * np.pi / n)
        normals.append(np.stack([np.cos(angles), np.sin(angles)], axis=-1))
        points.append(np.array([x, y]) + r * normals[-1])
    for a, b in zip(segments[:, :2], segments[:, 2:], strict=True):
        length = float(np.linalg.norm(b - a))
        if length < 1e-9:
            continue
        # Not into the very corners: there a face may end flush with that of a neighbour.
        end = min(INSET_M / length, 0.5)
        fractions = np.linspace(end, 1.0 - end, max(2, int(np.ceil(length / step)) + 1))
        points.append(a + fractions[:, None] * (b - a))
        normal = np.array([b[1] - a[1], a[0] - b[0]]) / length
        if isinstance(solid, Mesh) and solid.inside(z, (0.5 * (a + b) + INSET_M * normal)[None])[0]:
            normal = -normal
        normals.append(np.broadcast_to(normal, points[-1].shape))
    return np.vstack(points), np.vstack(normals)
