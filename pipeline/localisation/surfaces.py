"""Subcell surfaces of a map: smooth walls fitted through the staircase of the grid.

Every occupied cell gets the point and normal of a parabola fitted to the occupied cells around it
(moving least squares, Levin 1998), so that a slanted or round wall is located to a fraction of a cell.
A wall along the grid's axes stays where its cells are: what the grid does not say, no fit can know.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np
import scipy
from numpy.typing import NDArray

from turtlebag.datasets.grid import FREE, OCCUPIED, OccupancyGrid
from turtlebag.datasets.kernels import njit
from turtlebag.datasets.se2 import SE2, Array
from turtlebag.pipeline.localisation.small_matrices import solve

Indices = NDArray[np.int32]

# Occupied cells within this many of a cell take part in its fit: of a wall seven in a row.
WINDOW_CELLS = 3.5
# A fit that leaves more than this is no surface (a corner, a thin post) and counts little; a step of more
# along the normal begins another one.
ROUGH_CELLS, ROUGH_WEIGHT = 0.6, 0.1
# A patch: connected surface whose normal stays within 25 degrees of where it began, at most 3 m wide.
PATCH_COSINE, PATCH_CELLS = 0.9, 60
# Points farther than this from every surface are not matched at all.
REACH_CELLS = 2.5
MARGIN_CELLS = math.ceil(WINDOW_CELLS)


class Surfaces(NamedTuple):
    """One small surface an occupied cell, in the frame of the padded grid's outer corner [m].

    The numba kernels take the tuple whole; `corner` (3,) is that corner's pose in the map.

    `points`, `normals` (n, 2), normals towards the free side; `trust` (n,) in 0..1; `patch` (n,) says
    which surfaces are one wall; `nearest` (rows, cols) is the surface nearest to a cell, -1 beyond reach.
    """

    points: Array
    normals: Array
    trust: Array
    patch: Indices
    nearest: Indices
    resolution: float
    corner: Array

    @property
    def T_map_surfaces(self) -> SE2:
        """The surfaces' frame in the map."""
        return SE2(self.corner)

    @property
    def patches(self) -> int:
        """How many patches there are."""
        return int(self.patch.max()) + 1


def fit_surfaces(grid: OccupancyGrid) -> Surfaces:
    """Surfaces of a map; ValueError without an occupied cell."""
    occupied = np.pad(grid.cells >= OCCUPIED, MARGIN_CELLS)
    if not occupied.any():
        raise ValueError("the map has no occupied cell")
    cells = np.argwhere(occupied)
    index = np.full(occupied.shape, -1, dtype=np.int32)
    index[occupied] = np.arange(len(cells))
    to_free = towards_free(np.pad(grid.cells == FREE, MARGIN_CELLS))[cells[:, 0], cells[:, 1]]
    shift, normals, rough = fit_cells(cells, index, to_free, WINDOW_CELLS)
    points = cells[:, ::-1] + 0.5 + shift
    patch = grow_patches(cells, index, points, normals)
    distance, (rows, cols) = scipy.ndimage.distance_transform_edt(~occupied, return_indices=True)
    nearest = np.where(distance <= REACH_CELLS, index[rows, cols], -1).astype(np.int32)
    corner = -MARGIN_CELLS * grid.resolution
    return Surfaces(
        points * grid.resolution,
        normals,
        np.where(rough < ROUGH_CELLS, 1.0, ROUGH_WEIGHT),
        patch,
        nearest,
        grid.resolution,
        (grid.T_map_grid @ SE2.from_xyt(corner, corner, 0.0)).xyt,
    )


def towards_free(free: NDArray[np.bool_]) -> Array:
    """Direction of more free space at each cell, (rows, cols, 2) as x, y; short where both sides are free."""
    smooth = scipy.ndimage.gaussian_filter(free.astype(np.float64), 0.8)
    along_y, along_x = np.gradient(smooth)
    return np.stack([along_x, along_y], axis=-1)


@njit(cache=True)
def fit_cells(
    cells: NDArray[np.int64], index: Indices, towards_free: Array, window: float
) -> tuple[Array, Array, Array]:
    """Per occupied cell, in cells: shift of its centre to the surface, normal (n, 2), rms of the fit (n,)."""
    n = len(cells)
    shift, normals, rough = np.zeros((n, 2)), np.zeros((n, 2)), np.full(n, np.inf)
    reach = int(window)
    near = np.empty(((2 * reach + 1) ** 2, 3))
    for i in range(n):
        row, col = cells[i, 0], cells[i, 1]
        gx, gy = towards_free[i, 0], towards_free[i, 1]
        length = np.hypot(gx, gy)
        nx, ny = (gx / length, gy / length) if length > 1e-9 else (1.0, 0.0)
        count = 0
        for dr in range(-reach, reach + 1):
            for dc in range(-reach, reach + 1):
                r, c = row + dr, col + dc
                if dr * dr + dc * dc > window * window or not (0 <= r < index.shape[0]):
                    continue
                if not (0 <= c < index.shape[1]) or index[r, c] < 0:
                    continue
                j = index[r, c]
                # The far face of a thin wall is another surface.
                if towards_free[j, 0] * gx + towards_free[j, 1] * gy < 0.0:
                    continue
                near[count, 0], near[count, 1] = dc, dr
                near[count, 2] = np.exp(-2.0 * (dr * dr + dc * dc) / window**2)
                count += 1
        normals[i, 0], normals[i, 1] = nx, ny
        if count < 4:
            continue
        height, slope = 0.0, 0.0
        for _ in range(3):
            height, slope, rough[i] = fit_parabola(near[:count], nx, ny)
            nx, ny = nx + slope * ny, ny - slope * nx
            length = np.hypot(nx, ny)
            nx, ny = nx / length, ny / length
        normals[i, 0], normals[i, 1] = nx, ny
        if abs(height) < 1.5:
            shift[i, 0], shift[i, 1] = height * nx, height * ny
        else:
            rough[i] = np.inf
    return shift, normals, rough


@njit(cache=True)
def fit_parabola(near: Array, nx: float, ny: float) -> tuple[float, float, float]:
    """(height, slope, rms) at 0 of the parabola through points (n, 3: x, y, weight), v along (nx, ny)."""
    normal, right, weight, squares = np.eye(3) * 1e-6, np.zeros(3), 0.0, 0.0
    basis = np.empty(3)
    for k in range(len(near)):
        u, v = -ny * near[k, 0] + nx * near[k, 1], nx * near[k, 0] + ny * near[k, 1]
        basis[0], basis[1], basis[2] = 1.0, u, u * u
        for a in range(3):
            right[a] += near[k, 2] * basis[a] * v
            for b in range(3):
                normal[a, b] += near[k, 2] * basis[a] * basis[b]
        weight += near[k, 2]
        squares += near[k, 2] * v * v
    solved = solve(normal, right.reshape(3, 1))[:, 0]
    rest = max(0.0, squares - (solved * right).sum())
    return solved[0], solved[1], np.sqrt(rest / weight)


@njit(cache=True)
def grow_patches(cells: NDArray[np.int64], index: Indices, points: Array, normals: Array) -> Indices:
    """Patch of each surface, (n,): flood fill over cells at most two apart, as long as the wall goes on."""
    n = len(cells)
    patch = np.full(n, -1, dtype=np.int32)
    stack = np.empty(n, dtype=np.int64)
    count = 0
    for seed in range(n):
        if patch[seed] >= 0:
            continue
        patch[seed], stack[0], size = count, seed, 1
        while size > 0:
            size -= 1
            i = stack[size]
            for dr in range(-2, 3):
                for dc in range(-2, 3):
                    r, c = cells[i, 0] + dr, cells[i, 1] + dc
                    if not (0 <= r < index.shape[0] and 0 <= c < index.shape[1]) or index[r, c] < 0:
                        continue
                    j = index[r, c]
                    if patch[j] >= 0 or (normals[j] * normals[seed]).sum() < PATCH_COSINE:
                        continue
                    apart = max(abs(cells[j, 0] - cells[seed, 0]), abs(cells[j, 1] - cells[seed, 1]))
                    step = ((points[j] - points[i]) * normals[seed]).sum()
                    if apart <= PATCH_CELLS and abs(step) < ROUGH_CELLS:
                        patch[j], stack[size] = count, j
                        size += 1
        count += 1
    return patch
