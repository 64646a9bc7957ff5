"""The costmap: which cells are obstacles, and the distance to the nearest of them."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import Any, Literal

import numpy as np
import scipy
from numpy.typing import NDArray

from turtlebag.datasets.grid import OCCUPIED, OCCUPIED_FROM, UNKNOWN, OccupancyGrid
from turtlebag.datasets.kernels import njit
from turtlebag.datasets.se2 import SE2, Array
from turtlebag.datasets.settings import Settings
from turtlebag.planners.grid_distance import GridDistance, descend, grid_distance

Mask = NDArray[np.bool_]
Area = Array | OccupancyGrid
"""A keep-out area: a polygon, (n, 2) in the map frame, or a grid whose fully occupied cells it is."""
BLOCK = 256
"""Rows of a costmap that are looked up in a grid at once."""
EIGHT_NEIGHBOURS = np.ones((3, 3), dtype=bool)
SPECK_M2 = 0.06
"""Unknown patches smaller than this inside known floor count as free: gaps between beams (not measured)."""
SNAP_M = 0.35
"""If the robot or the goal is too close to an obstacle, its path may start or end up to this far away. Not
measured."""
COST_SCALING = 3.0
"""Rate at which inflated costs decay [1/m]: turtlebot3's for costmap_2d."""
INSCRIBED_COST = 253
"""costmap_2d's cost of a cell that the robot's inscribed disc may not enter."""
TOUCH = 1e-6
"""Tolerance as a share of a cell: an outline along a border reaches the cells on both sides, but for
rounding."""


class CostmapConfig(Settings, allow_inf_nan=False):
    """Which cells count as obstacles."""

    unknown: Literal["blocked", "free"] = "blocked"
    """Whether unknown cells are obstacles or free."""


@dataclass(frozen=True, eq=False)
class Costmap:
    """`lethal` (rows, cols) says which cells stop the robot; everything beyond the grid does too.

    `clearance` is the exact Euclidean distance from each cell's centre to the nearest lethal
    cell's centre [m]. `T_map_grid` is the frame of cell (0, 0)'s outer corner; planners work in
    that grid frame, where cell (row, col) covers [col, col + 1) x [row, row + 1) times resolution.
    """

    lethal: Mask
    resolution: float
    T_map_grid: SE2
    keepout: Mask | None = None
    """Lethal cells that are floor in a keep-out area; None: there is no such area."""

    @cached_property
    def clearance(self) -> NDArray[np.float32]:
        """Distance to the nearest lethal cell [m], (rows, cols) float32."""
        return clearance_field(self.lethal, self.resolution)

    @cached_property
    def T_grid_map(self) -> SE2:
        """The map frame seen from the grid frame."""
        return self.T_map_grid.inverse()

    @property
    def size(self) -> tuple[float, float]:
        """Extent along the grid's own x and y [m]."""
        rows, cols = self.lethal.shape
        return cols * self.resolution, rows * self.resolution

    def clearance_at(self, points_map: Array) -> Array:
        """Distance from the cells under points (..., 2) to the nearest lethal cell [m]; 0 off the map."""
        xy = self.T_grid_map @ np.asarray(points_map, dtype=np.float64)
        cells = np.floor(xy[..., ::-1] / self.resolution).astype(np.int64)
        shape = np.array(self.lethal.shape)
        inside = np.all((cells >= 0) & (cells < shape), axis=-1)
        cells = np.clip(cells, 0, shape - 1)
        return np.where(inside, self.clearance[cells[..., 0], cells[..., 1]], 0.0).astype(np.float64)

    def with_lethal(self, extra: Mask) -> Costmap:
        """The map with more lethal cells."""
        keepout = None if self.keepout is None else self.keepout & ~extra
        return Costmap(self.lethal | extra, self.resolution, self.T_map_grid, keepout)

    def with_way_out(self, T_map_base: SE2, radius: float) -> Costmap:
        """The map, with a way out for a disc of `radius` [m] that is in a keep-out area: the shortest one.

        A robot that did not know its pose, or was carried, may be in one. The way is twice as wide as the
        disc, so that a controller that keeps its distance follows it.
        """
        if self.keepout is None:
            return self
        res, xy = self.resolution, self.T_grid_map @ T_map_base.xy / self.resolution
        if nearest_free(self.clearance > radius, xy, SNAP_M / res) is not None:
            return self
        floor = clearance_field(self.lethal & ~self.keepout, res) > radius
        start = nearest_free(floor, xy, SNAP_M / res)
        if start is None:
            return self
        ways = grid_distance(floor, *start, np.inf)
        outside = np.where(self.clearance > radius, ways, np.inf)
        row, col = np.unravel_index(int(outside.argmin()), outside.shape)
        if not np.isfinite(outside[row, col]):
            return self
        way = np.zeros_like(self.lethal)
        way[tuple(descend(ways, int(row), int(col)).T)] = True
        closed = self.keepout & (distance_field(way, res) > 2.0 * radius)
        return Costmap(self.lethal & ~self.keepout | closed, res, self.T_map_grid, closed)


def distance_field(blocked: Mask, resolution: float) -> NDArray[np.float32]:
    """Distance from each cell's centre to that of the nearest blocked cell [m], (rows, cols); one must be
    blocked."""
    return np.asarray(np.sqrt(squared_distance(blocked)) * resolution, dtype=np.float32)


@njit(cache=True)
def squared_distance(blocked: Mask) -> NDArray[np.int64]:
    """Squared distance of cells to the nearest blocked one (Meijster, Roerdink, Hesselink 2000), exact;
    without any, a square of more than the grid is long."""
    rows, cols = blocked.shape
    beside = np.empty((rows, cols), dtype=np.int32)  # along the column, all columns of a row at once
    beside[0] = np.where(blocked[0], 0, rows + cols)
    for r in range(1, rows):
        for c in range(cols):
            beside[r, c] = 0 if blocked[r, c] else min(beside[r - 1, c] + 1, rows + cols)
    for r in range(rows - 2, -1, -1):
        for c in range(cols):
            beside[r, c] = min(beside[r, c], beside[r + 1, c] + 1)
    # Along each row the lower envelope of parabolas, one for each cell: which is lowest, and from where on.
    out, lowest, since = np.empty((rows, cols), np.int64), np.empty(cols, np.int64), np.empty(cols, np.int64)
    height = np.empty(cols, np.int64)
    for r in range(rows):
        for c in range(cols):
            height[c] = np.int64(beside[r, c]) ** 2 + c * c
        k = 0
        lowest[0] = since[0] = 0
        for c in range(1, cols):
            # From `above / apart` on, column c is lower.
            above, apart = height[c] - height[lowest[k]], 2 * (c - lowest[k])
            while k >= 0 and above < apart * since[k]:
                k -= 1
                if k >= 0:
                    above, apart = height[c] - height[lowest[k]], 2 * (c - lowest[k])
            if k < 0:
                k, lowest[0], since[0] = 0, c, 0
            elif above < apart * (cols - 1):
                k += 1
                lowest[k], since[k] = c, 1 + above // apart
        end = cols
        for part in range(k, -1, -1):
            i = lowest[part]
            for c in range(since[part], end):
                out[r, c] = height[i] + c * (c - 2 * i)
            end = since[part]
    return out


def clearance_field(lethal: Mask, resolution: float) -> NDArray[np.float32]:
    """Exact distance transform of a mask [m]; the world beyond it is lethal."""
    # One ring of lethal cells stands for everything beyond the grid.
    return distance_field(np.pad(lethal, 1, constant_values=True), resolution)[1:-1, 1:-1].copy()


def inflated_cost(room: Any, scaling: float) -> Any:
    """costmap_2d's cost outside of obstacles: 252 at the inscribed disc's border, decaying to 0. `room` is
    the clearance minus the inscribed radius [m], a number or an array; `scaling` is per metre."""
    return (INSCRIBED_COST - 1.0) * np.exp(-scaling * np.maximum(room, 0.0))


inflated_cost_at = njit(cache=True)(inflated_cost)
"""The same of a number, for kernels."""


def costmap_from_grid(grid: OccupancyGrid, config: CostmapConfig, keepout: Sequence[Area] = ()) -> Costmap:
    """Costmap of an occupancy grid; `keepout` areas are lethal."""
    lethal = grid.cells >= OCCUPIED_FROM
    if config.unknown == "blocked":
        lethal |= _unknown_without_specks(grid)
    costmap = Costmap(lethal, grid.resolution, grid.T_map_grid)
    if not keepout:
        return costmap
    areas = np.any([area_mask(costmap, area) for area in keepout], axis=0) & ~lethal
    return Costmap(lethal | areas, grid.resolution, grid.T_map_grid, areas)


def _unknown_without_specks(grid: OccupancyGrid) -> Mask:
    """Unknown cells, without small patches amid free floor.

    A patch that touches an occupied cell stays: it may be the inside of a pillar.
    """
    unknown = grid.cells == UNKNOWN
    labels, count = scipy.ndimage.label(unknown, structure=EIGHT_NEIGHBOURS)
    areas = np.bincount(labels.ravel(), minlength=count + 1) * grid.resolution**2
    beside_occupied = scipy.ndimage.binary_dilation(grid.cells >= OCCUPIED_FROM, structure=EIGHT_NEIGHBOURS)
    keep = areas >= SPECK_M2
    keep[np.unique(labels[beside_occupied & unknown])] = True
    return np.asarray(unknown & keep[labels], dtype=bool)


def nearest_free(free: Mask, xy: Array, reach: float) -> tuple[int, int] | None:
    """The free cell under a point (x, y), or else the nearest one, all in cells; None if none is within
    reach."""
    col, row = (int(v) for v in np.floor(xy))
    if 0 <= row < free.shape[0] and 0 <= col < free.shape[1] and free[row, col]:
        return row, col
    # No cell farther away can be within reach.
    first, last = np.maximum([row - reach, col - reach], 0), np.maximum([row + reach + 2, col + reach + 2], 0)
    (r0, c0), (r1, c1) = first.astype(int), last.astype(int)
    cells = np.argwhere(free[r0:r1, c0:c1]) + np.array([r0, c0])
    if len(cells) == 0:
        return None
    gap = np.linalg.norm(cells[:, ::-1] + 0.5 - xy, axis=1)
    best = int(np.argmin(gap))
    return (int(cells[best, 0]), int(cells[best, 1])) if gap[best] <= reach else None


def ways_from(costmap: Costmap, T_map_base: SE2, radius: float) -> GridDistance | None:
    """Distance of each cell from a pose over the floor, for a disc of `radius` [m], [m]; inf if unreachable.
    None if the robot is too close to an obstacle."""
    costmap = costmap.with_way_out(T_map_base, radius)
    free, res = costmap.clearance > radius, costmap.resolution
    start = nearest_free(free, costmap.T_grid_map @ T_map_base.xy / res, SNAP_M / res)
    return None if start is None else grid_distance(free, *start, np.inf) * np.float32(res)


def area_mask(costmap: Costmap, area: Area) -> Mask:
    """Cells of a keep-out area."""
    return _grid_mask(costmap, area) if isinstance(area, OccupancyGrid) else polygon_mask(costmap, area)


def _grid_mask(costmap: Costmap, area: OccupancyGrid) -> Mask:
    """Cells whose centre lies in an occupied cell of the area, or that hold the centre of one: so neither a
    coarser nor a finer area has holes."""
    whole = OccupancyGrid(np.zeros(costmap.lethal.shape, np.int8), costmap.resolution, costmap.T_map_grid)
    rows, cols = whole.shape
    mask = np.zeros(whole.shape, dtype=bool)
    for first in range(0, rows, BLOCK):
        block = np.moveaxis(np.mgrid[first : min(first + BLOCK, rows), 0:cols], 0, -1)
        mask[first : first + BLOCK] = area.value_at(whole.center_of(block)) == OCCUPIED
    cells = whole.cell_of(area.center_of(np.argwhere(area.cells == OCCUPIED)))
    inside = cells[whole.contains(cells)]
    mask[inside[:, 0], inside[:, 1]] = True
    return mask


def polygon_mask(costmap: Costmap, polygon_map: Array) -> Mask:
    """Cells of a polygon (even-odd rule) with (n, 2) corners in the map frame.

    These are the cells whose centre lies in it; where it is too narrow to hold four neighbouring centres,
    every cell that it touches, so that a strip thinner than a cell has no holes. So each point of the polygon
    is in a cell of the mask, or next to a block of 2 x 2 of them.
    """
    corners = costmap.T_grid_map @ np.asarray(polygon_map, dtype=np.float64) / costmap.resolution
    rows, cols = costmap.lethal.shape
    x, y = np.arange(cols)[None, :] + 0.5, np.arange(rows)[:, None] + 0.5
    mask = np.zeros((rows, cols), dtype=bool)
    edges = list(zip(corners, np.roll(corners, -1, axis=0), strict=True))
    for (ax, ay), (bx, by) in edges:
        if ay == by:
            continue
        crosses = (ay > y) != (by > y)
        mask ^= crosses & (x < ax + (y - ay) * (bx - ax) / (by - ay))
    reached = mask.copy()
    for start, end in edges:
        _add_passed(reached, start, end)
    opened = scipy.ndimage.binary_opening(mask, np.ones((2, 2)))
    broad = scipy.ndimage.binary_dilation(opened, EIGHT_NEIGHBOURS)
    narrow = reached & ~broad
    return np.asarray(mask | reached & scipy.ndimage.binary_dilation(narrow, EIGHT_NEIGHBOURS), dtype=bool)


def _add_passed(mask: Mask, start: Array, end: Array) -> None:
    """Add the cells that a segment touches; its ends (2,) are x, y in cells.

    Exact: a segment and a square have no point in common just when an axis or the segment's own normal
    separates them.
    """
    low = np.maximum(np.floor(np.minimum(start, end) - TOUCH), 0.0)
    high = np.minimum(np.floor(np.maximum(start, end) + TOUCH) + 1.0, mask.shape[::-1])
    if not np.all(low < high):
        return
    (left, bottom), (right, top) = low.astype(int), high.astype(int)
    x = np.arange(left, right)[None, :] + 0.5
    y = np.arange(bottom, top)[:, None] + 0.5
    along = end - start
    off = along[0] * (y - start[1]) - along[1] * (x - start[0])
    reached = np.abs(off) <= (0.5 + TOUCH) * np.abs(along).sum()
    for at, a, b in ((x, start[0], end[0]), (y, start[1], end[1])):
        reached &= (max(a, b) >= at - 0.5 - TOUCH) & (min(a, b) <= at + 0.5 + TOUCH)
    mask[bottom:top, left:right] |= reached
