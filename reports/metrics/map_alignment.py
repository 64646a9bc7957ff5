"""Laying the walls of one map on those of another: two maps of a place seldom share a frame."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
import scipy

from turtlebag.datasets.grid import OccupancyGrid
from turtlebag.datasets.se2 import SE2, Array
from turtlebag.reports.metrics.map import walls
from turtlebag.reports.metrics.trajectory import fit_rigid

REACHES_M = (1.5, 1.0, 0.6, 0.4, 0.25, 0.15)
"""How far off a wall is looked for while the maps come together."""
STEPS = 6
MOST_POINTS = 6000
BINS = 256
YAWS = 120
BETTER = 0.05
GOOD_START = 0.6


@dataclass(frozen=True, eq=False)
class Placed:
    """A map moved by `T_ref_map` so that its walls lie on others; `share` of them lie within two cells of the
    coarser map."""

    T_ref_map: SE2
    share: float

    def moved(self, grid: OccupancyGrid) -> OccupancyGrid:
        """The map where it was laid."""
        return replace(grid, T_map_grid=self.T_ref_map @ grid.T_map_grid)


def place(grid: OccupancyGrid, walls_ref: Array, cell_m: float, guesses: Sequence[SE2]) -> Placed:
    """Lay a map on walls (m, 2), right to `cell_m`, by the closest points, from the guess that ends best.

    Where none ends well, every turn and shift is tried. A later guess has to be clearly better than an
    earlier: rooms look alike from several sides. A map without walls stays where the first guess puts it.
    """
    points = walls(grid)
    if not len(points) or not len(walls_ref):
        return Placed(guesses[0], 0.0)
    points = points[:: -(-len(points) // MOST_POINTS)]
    tree = scipy.spatial.cKDTree(walls_ref)
    near_m = 2.0 * max(grid.resolution, cell_m)
    found = [_closed(points, tree, guess, near_m) for guess in guesses]
    if max(placed.share for placed in found) < GOOD_START:
        found += [_closed(points, tree, guess, near_m) for guess in _everywhere(points, walls_ref)]
    best = found[0]
    for placed in found[1:]:
        if placed.share > best.share + BETTER:
            best = placed
    return best


def _closed(points: Array, tree: scipy.spatial.cKDTree, guess: SE2, near_m: float) -> Placed:
    """Iterated closest points with a reach that shrinks."""
    T = guess
    for reach in REACHES_M:
        for _ in range(STEPS):
            moved = T @ points
            distance, index = tree.query(moved, distance_upper_bound=reach)
            near = np.isfinite(distance)
            if near.sum() < 3:
                break
            T = fit_rigid(points[near], tree.data[index[near]])
    distance, _ = tree.query(T @ points)
    return Placed(T, float(np.mean(distance <= near_m)))


def _everywhere(points: Array, walls_ref: Array) -> list[SE2]:
    """The three best of all turns and shifts, by correlation of coarse pictures of the walls."""
    middle, middle_ref = (0.5 * (xy.min(axis=0) + xy.max(axis=0)) for xy in (points, walls_ref))
    centred, centred_ref = points - middle, walls_ref - middle_ref
    reach = max(float(np.linalg.norm(xy, axis=1).max()) for xy in (centred, centred_ref))
    cell = max(4.0 * reach / BINS, 0.1)
    target = scipy.ndimage.gaussian_filter(_picture(centred_ref, cell), 1.0)
    spectrum = np.fft.rfft2(target)
    found = []
    for yaw in np.arange(YAWS) * (2.0 * np.pi / YAWS):
        turned = SE2.from_xyt(0.0, 0.0, yaw) @ centred
        match = np.fft.irfft2(spectrum * np.conj(np.fft.rfft2(_picture(turned, cell))), s=target.shape)
        row, column = np.unravel_index(int(np.argmax(match)), match.shape)
        shift = (
            np.array([(column + BINS // 2) % BINS - BINS // 2, (row + BINS // 2) % BINS - BINS // 2]) * cell
        )
        place = middle_ref + shift - (SE2.from_xyt(0.0, 0.0, yaw) @ middle)
        found.append((float(match[row, column]), SE2.from_xyt(place[0], place[1], yaw)))
    found.sort(key=lambda entry: -entry[0])
    return [T for _, T in found[:3]]


def _picture(xy: Array, cell: float) -> Array:
    """Which coarse cells around the origin hold a wall, (BINS, BINS)."""
    index = np.floor(xy / cell).astype(np.int64) + BINS // 2
    index = index[np.all((index >= 0) & (index < BINS), axis=1)]
    picture = np.zeros((BINS, BINS))
    picture[index[:, 1], index[:, 0]] = 1.0
    return picture
