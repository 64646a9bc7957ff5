"""The shortest collision-free way of a footprint that drives forwards and backwards and turns on the spot.

A lattice of every cell and 32 headings is searched exhaustively (Dijkstra; a step leads along the
heading, a turn costs nothing), and the way found is pulled tight with the footprint itself. The
lattice alone is at most 1.3 % too long: the widest gap between headings is 18.4 degrees. Lethal cells
are discs of half a cell, as wide as the thing in them: a gap between their mere centres is none.
"""

from __future__ import annotations

import heapq
import math

import numpy as np
from numba import njit
from numpy.typing import NDArray

from turtlebag.datasets.se2 import SE2, Array
from turtlebag.datasets.types import RobotModel
from turtlebag.planners.control.monitor import padded
from turtlebag.planners.costmap import Costmap
from turtlebag.planners.footprint import Field32, footprint_free
from turtlebag.planners.lattice import HEADINGS
from turtlebag.planners.oriented import drives, pull
from turtlebag.planners.smoothing import densify, path_length


class Lattice:
    """The lattice of one map and one robot; which poses are free is found out once."""

    def __init__(self, costmap: Costmap, model: RobotModel) -> None:
        self._costmap = costmap
        self._corners = padded(model.footprint, 0.5 * costmap.resolution)
        self._free = free_headings(costmap.clearance, costmap.resolution, self._corners, HEADINGS)

    def shortest(self, T_map_start: SE2, T_map_goal: SE2) -> float:
        """Length of the shortest way of the footprint [m]; inf when there is none on the lattice."""
        field, res = self._costmap.clearance, self._costmap.resolution
        ends = [self._costmap.T_grid_map @ T for T in (T_map_start, T_map_goal)]
        cells = [(int(T.y / res), int(T.x / res)) for T in ends]
        path = search(field, res, self._corners, HEADINGS, self._free, _nearest(ends[0]), cells[0], cells[1])
        if len(path) == 0:
            return math.inf
        points = (path + 0.5) * res
        points[0], points[-1] = ends[0].xy, ends[1].xy
        tight, _ = pull(field, res, self._corners, densify(points, res), math.nan, math.nan)
        again, _ = pull(field, res, self._corners, densify(tight[::-1].copy(), res), math.nan, math.nan)
        return min(path_length(points), path_length(tight), path_length(again))


def _nearest(pose: SE2) -> int:
    angles = np.arctan2(HEADINGS[:, 1], HEADINGS[:, 0])
    return int(np.argmin(np.abs(np.angle(np.exp(1j * (angles - float(pose.yaw)))))))


@njit(cache=True)
def free_headings(
    field: Field32, res: float, corners: Array, headings: NDArray[np.int64]
) -> NDArray[np.bool_]:
    """Whether the footprint is free at each cell's centre in each heading, (32, rows, cols)."""
    rows, cols = field.shape
    free = np.zeros((len(headings), rows, cols), dtype=np.bool_)
    for k in range(len(headings)):
        yaw = math.atan2(headings[k, 1], headings[k, 0])
        for r in range(rows):
            for c in range(cols):
                x, y = (c + 0.5) * res, (r + 0.5) * res
                free[k, r, c] = footprint_free(field, res, corners, x, y, yaw)
    return free


@njit(cache=True)
def search(
    field: Field32,
    res: float,
    corners: Array,
    headings: NDArray[np.int64],
    free: NDArray[np.bool_],
    heading: int,
    start: tuple[int, int],
    goal: tuple[int, int],
) -> Array:
    """Cells (n, 2) as column, row of the shortest way to the goal in any heading; empty: none."""
    n, rows, cols = free.shape
    size = rows * cols
    cost = np.full(n * size, np.inf)
    before = np.full(n * size, -1, dtype=np.int64)
    first = heading * size + start[0] * cols + start[1]
    cost[first] = 0.0
    queue = [(0.0, np.int64(first))]
    a, b = np.empty(2), np.empty(2)
    while len(queue) > 0:
        d, state = heapq.heappop(queue)
        if d > cost[state]:
            continue
        k, cell = state // size, state % size
        r, c = cell // cols, cell % cols
        if r == goal[0] and c == goal[1]:
            out = []
            while state >= 0:
                cell = state % size
                if len(out) == 0 or out[-1][0] != cell % cols or out[-1][1] != cell // cols:
                    out.append((cell % cols, cell // cols))
                state = before[state]
            way = np.empty((len(out), 2))
            for i in range(len(out)):
                way[i, 0], way[i, 1] = out[len(out) - 1 - i]
            return way
        for turn in (1, n - 1):
            other = (k + turn) % n
            there = other * size + cell
            if free[other, r, c] and d < cost[there]:
                cost[there] = d
                before[there] = state
                heapq.heappush(queue, (d, there))
        dc, dr = headings[k, 0], headings[k, 1]
        step = math.hypot(dc, dr)
        yaw = math.atan2(dr, dc)
        for way_ in (1, -1):
            r1, c1 = r + way_ * dr, c + way_ * dc
            if r1 < 0 or c1 < 0 or r1 >= rows or c1 >= cols or not free[k, r1, c1]:
                continue
            there = k * size + r1 * cols + c1
            if d + step >= cost[there]:
                continue
            a[0], a[1], b[0], b[1] = (c + 0.5) * res, (r + 0.5) * res, (c1 + 0.5) * res, (r1 + 0.5) * res
            if step > 1.5 and not drives(field, res, corners, a, b, yaw):
                continue
            cost[there] = d + step
            before[there] = state
            heapq.heappush(queue, (d + step, there))
    return np.empty((0, 2))
