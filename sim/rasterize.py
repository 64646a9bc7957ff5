"""The true map of a world: the map of a perfect lidar that has been everywhere.

A cell is OCCUPIED if it contains a surface visible from the floor that is reachable
from the spawn, FREE if it belongs to that floor, and UNKNOWN elsewhere: inside solids, behind
walls, outside. So it can be compared, cell by cell, with a map built from scans, which never see
the inside of a wall.

The cells of a world that was made from a map lie on those of the map, and show again what it shows:
all floor is FREE and all walls are OCCUPIED, even where nobody sees them.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np
import scipy

from turtlebag.datasets.grid import FREE, OCCUPIED, UNKNOWN, OccupancyGrid
from turtlebag.datasets.se2 import SE2, Array
from turtlebag.sim.plans import Plan
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
    T_world_origin: SE2 | None = None,
) -> OccupancyGrid:
    """True map at height z over `bounds` (x_min, x_max, y_min, y_max), seen from start_xy.

    `solids` are those that cross that height. Cells count from `T_world_origin`, the world's own without it,
    and are turned as it is.
    """
    T_world_origin = T_world_origin or SE2.identity()
    corners = np.array([[x, y] for x in bounds[:2] for y in bounds[2:]])
    corners = (T_world_origin.inverse() @ corners) / resolution
    # Whole cells, aligned to multiples of the resolution.
    x0, y0 = np.floor(corners.min(axis=0) + 1e-9)
    cols, rows = (np.ceil(corners.max(axis=0) - 1e-9) - (x0, y0)).astype(int)
    cells = np.full((rows, cols), UNKNOWN, dtype=np.int8)
    corner = SE2.from_xyt(x0 * resolution, y0 * resolution, 0.0)
    grid = OccupancyGrid(cells, resolution, T_world_origin @ corner)

    filled = _filled_cells(grid, solids, z)
    plans = [solid for solid in solids if isinstance(solid, Plan)]
    if plans:
        return _of_plans(grid, plans, [solid for solid in solids if not isinstance(solid, Plan)], z, filled)
    surface = _surface_cells(grid, solids, z)
    open_floor = ~surface & ~filled
    regions, _ = scipy.ndimage.label(open_floor)
    start = grid.cell_of(np.asarray(start_xy))
    region = regions[tuple(start)] if grid.contains(start) else 0
    free = (regions == region) & open_floor if region else np.zeros_like(open_floor)

    seen = scipy.ndimage.binary_dilation(free, structure=np.ones((3, 3), dtype=bool))
    cells[free] = FREE
    cells[surface & seen] = OCCUPIED
    return grid


def _of_plans(
    grid: OccupancyGrid, plans: Sequence[Plan], others: Sequence[Solid], z: float, filled: Bools
) -> OccupancyGrid:
    """The true map of a world that was made from maps, and of what else stands in it; `filled` (rows, cols)
    are the cells whose centres lie within a solid."""
    own = all(grid.resolution <= plan.grid.resolution for plan in plans)
    # Coarser cells may have no centre within a wall.
    surface = _surface_cells(grid, others if own else [*others, *plans], z)
    surface |= _filled_cells(grid, [replace(plan, segments=plan.walls) for plan in plans], z)
    free = ~filled & ~surface
    if grid.shape != plans[0].grid.shape:  # it reaches beyond the map, of which nothing is known there
        centres = grid.center_of(np.stack([*np.indices(grid.shape)], axis=-1))
        free &= np.any([plan.grid.contains(plan.grid.cell_of(centres)) for plan in plans], axis=0)
    # Unknown cells that are solid end the view where no wall does.
    seen = filled & scipy.ndimage.binary_dilation(free)
    grid.cells[free] = FREE
    grid.cells[surface | seen] = OCCUPIED
    return grid


def _filled_cells(grid: OccupancyGrid, solids: Sequence[Solid], z: float) -> Bools:
    """Cells whose centre lies within a solid, (rows, cols)."""
    filled = np.zeros(grid.shape, dtype=bool)
    last = np.array(grid.shape) - 1
    for solid in solids:
        x_min, x_max, y_min, y_max = solid.bounds()
        corners = grid.cell_of(np.array([[x, y] for x in (x_min, x_max) for y in (y_min, y_max)]))
        (row, col), (end_row, end_col) = np.clip([corners.min(axis=0), corners.max(axis=0)], 0, last)
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
