"""Likelihood field: the probability of a beam's end point, by its distance to the nearest obstacle.

Thrun, Burgard, Fox: Probabilistic Robotics, section 6.4. Distances are exact (Euclidean distance
transform) and refer to cell CENTRES, so an obstacle is at its cell's centre and nothing is
shifted by half a cell.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np
import scipy
from numpy.typing import NDArray

from turtlebag.datasets.grid import OCCUPIED, OccupancyGrid
from turtlebag.datasets.kernels import njit
from turtlebag.datasets.se2 import SE2, Array
from turtlebag.pipeline.localisation.deskewed_beams import Beams, evenly_spaced
from turtlebag.pipeline.localisation.parameters import AmclConfig

FloatGrid = NDArray[np.float32]

# Beams are looked up without interpolation in a field this much finer than the map (memory permitting).
FINEST, MOST_FINE_CELLS = 4, 2**25


@dataclass(frozen=True, eq=False)
class DistanceField:
    """Distance [m] to the nearest occupied cell's centre, sampled at the cell centres of a padded grid.

    `distance` is (rows, cols) float32, cut at a maximum that all cells at the border have; `T_map_field` has
    its origin at the CENTRE of cell (0, 0), so a point's field coordinates over the resolution are fractional
    (col, row).
    """

    distance: FloatGrid
    resolution: float
    T_map_field: SE2

    def finer(self) -> tuple[FloatGrid, int]:
        """The distance at the centres of cells `factor` times finer, interpolated, and that factor.

        Row 0, column 0 begins at the outer corner of the field's first cell.
        """
        factor = FINEST
        while factor > 1 and self.distance.size * factor**2 > MOST_FINE_CELLS:
            factor //= 2
        if factor == 1:
            return self.distance, 1
        fine = scipy.ndimage.zoom(self.distance, factor, order=1, mode="nearest", grid_mode=True)
        return np.ascontiguousarray(fine, dtype=np.float32), factor

    @property
    def T_map_corner(self) -> SE2:
        """Outer corner of the field's first cell."""
        half = -0.5 * self.resolution
        return self.T_map_field @ SE2.from_xyt(half, half, 0.0)

    @cached_property
    def frame(self) -> tuple[float, float, float, float]:
        """What the kernels take: that corner (x, y, yaw) in the map [m, rad], and cells per metre."""
        x, y, yaw = self.T_map_corner.xyt.tolist()
        return x, y, yaw, 1.0 / self.resolution


def distance_field(grid: OccupancyGrid, max_dist: float) -> DistanceField:
    """The field of a map; ValueError without an occupied cell."""
    occupied = grid.cells >= OCCUPIED
    if not occupied.any():
        raise ValueError("the map has no occupied cell")
    pad = int(np.ceil(max_dist / grid.resolution))
    distance = scipy.ndimage.distance_transform_edt(~np.pad(occupied, pad)) * grid.resolution
    corner = (0.5 - pad) * grid.resolution
    T_map_field = grid.T_map_grid @ SE2.from_xyt(corner, corner, 0.0)
    cut = np.minimum(distance, max_dist).astype(np.float32)
    return DistanceField(cut, grid.resolution, T_map_field)


def hit_probability(
    distance: FloatGrid, sigma_hit: float, z_hit: float, z_rand: float, range_max: float
) -> Array:
    """Beam probability from distance, as ROS amcl: z_hit exp(-d^2 / 2 sigma^2) + z_rand / range_max."""
    d = distance.astype(np.float64)
    return z_hit * np.exp(-0.5 * (d / sigma_hit) ** 2) + z_rand / range_max


@njit(cache=True)
def meets_wall(
    distance: FloatGrid,
    per_metre: float,
    start: tuple[float, float],
    way: tuple[float, float],
    length: float,
    end: float,
) -> bool:
    """Whether a wall is on a beam, less than `end` [m] along it.

    `start` and `way`, `length` long [m], are in the frame of the field's corner. Steps are as long as the
    distance field allows.
    """
    rows, cols = distance.shape
    cell, at = 1.0 / per_metre, 0.0
    while at < end:
        x = (start[0] + way[0] * at / length) * per_metre
        y = (start[1] + way[1] * at / length) * per_metre
        if x < 0.0 or y < 0.0 or x >= cols or y >= rows:
            break
        col, row = int(x), int(y)
        d = distance[row, col]
        if d < 0.5 * cell:
            return True
        # The nearest centre is at least this far from here, wherever in the cell we are.
        at += max(d - 0.75 * cell, 0.5 * cell)
    return False


@njit(cache=True)
def sum_over_beams(
    table: FloatGrid, frame: tuple[float, float, float, float], poses: Array, points: FloatGrid
) -> Array:
    """Sum of the table's values under all beams' end points, for each pose, (n,); beyond the table its
    border counts.

    `poses` (n, 3) are in the map frame, `points` (m, 2, float32) in the base frame in table cells;
    `frame` is the table's corner in the map (x, y, yaw) [m, rad] and its cells per metre.
    """
    n, (rows, cols), flat = len(poses), table.shape, table.ravel()
    x0, y0, yaw0, per_metre = frame
    c0, s0 = np.cos(yaw0), np.sin(yaw0)
    x, y = np.empty(n, dtype=np.float32), np.empty(n, dtype=np.float32)
    c, s = np.empty(n, dtype=np.float32), np.empty(n, dtype=np.float32)
    for i in range(n):
        dx, dy = poses[i, 0] - x0, poses[i, 1] - y0
        x[i], y[i] = (c0 * dx + s0 * dy) * per_metre, (c0 * dy - s0 * dx) * per_metre
        c[i], s[i] = np.cos(poses[i, 2] - yaw0), np.sin(poses[i, 2] - yaw0)
    low, right, top = np.float32(0.0), np.float32(cols - 1), np.float32(rows - 1)
    cell, total = np.empty(n, dtype=np.int32), np.zeros(n, dtype=np.float32)
    for j in range(len(points)):
        px, py = points[j, 0], points[j, 1]
        # Loops over the poses, as the compiler takes many of them at once where nothing is looked up.
        for i in range(n):
            gx, gy = x[i] + c[i] * px - s[i] * py, y[i] + s[i] * px + c[i] * py
            gx, gy = gx if gx > low else low, gy if gy > low else low
            gx, gy = gx if gx < right else right, gy if gy < top else top
            cell[i] = np.int32(gy) * np.int32(cols) + np.int32(gx)
        for i in range(n):
            total[i] += flat[np.uint32(cell[i])]
    return total.astype(np.float64)


class LikelihoodField:
    """End points on the likelihood field, probabilities multiplied (Probabilistic Robotics, table 6.3)."""

    def __init__(self, config: AmclConfig, field: DistanceField, range_max: float) -> None:
        self._max_beams = config.max_beams
        distance, factor = field.finer()
        p = hit_probability(distance, config.sigma_hit, config.z_hit, config.z_rand, range_max)
        self._table = np.log(p).astype(np.float32)
        *corner, per_metre = field.frame
        self._frame = (*corner, factor * per_metre)

    def weigh(self, poses: Array, beams: Beams) -> Array:
        """Log weights (n,) of poses (n, 3) in the map frame."""
        points = (beams.points[evenly_spaced(len(beams), self._max_beams)] * self._frame[3]).astype(
            np.float32
        )
        return sum_over_beams(self._table, self._frame, poses, points)
