"""The rolling costmap: an obstacle layer in a window of fixed size that moves with the robot.

Nothing is on a map; beyond the window everything counts as free. For a goal beyond it, the robot
first drives to a point on the window's edge.
"""

from __future__ import annotations

import math
from typing import Any

import numpy as np
from numpy.typing import NDArray

from turtlebag.datasets.se2 import SE2, Array
from turtlebag.planners.costmap import Costmap, ways_from
from turtlebag.planners.obstacle_layer import NEVER, Marking, ObstacleLayer
from turtlebag.planners.planner import NoPath

RIM_M = 0.8
"""Intermediate goals lie this far inside the window: its edge counts as an obstacle (not measured)."""


IN_WINDOW = Marking(wall_margin=0.0, decay=60.0, obstacle_range=6.0, replan_s=0.3)
"""No static map, and always something new to see."""


class RollingLayer(ObstacleLayer):
    """Marked obstacles in a square window in the odometry frame, which moves by whole cells."""

    def __init__(
        self, centre: Array, side: float, resolution: float, shift: float, marking: Marking = IN_WINDOW
    ) -> None:
        """`side` [m] of the window; it moves when the robot is more than `shift` [m] off its centre."""
        cells = max(2, round(side / resolution))
        self._shift_cells = max(1, round(shift / resolution))
        corner = np.floor(centre / resolution) - cells // 2
        super().__init__(free_floor(corner, cells, resolution), marking)

    def update(self, now_s: float, origin: SE2, hits: Array, passes: Array) -> None:
        """Move the window if necessary, then add a sweep as an obstacle layer does."""
        self._move_to(origin.xy)
        super().update(now_s, origin, hits, passes)

    def aim(self, pose: SE2, goal: SE2, radius: float) -> SE2:
        """The goal, or the place at the window's edge on the shortest way to it for a disc of `radius` [m].

        Beyond the edge, the way is assumed to be straight. Raises NoPath if no such place can be reached.
        """
        if not self.stands_in(goal):
            return goal
        costmap, res = self.costmap, self.costmap.resolution
        ways = ways_from(costmap, pose, radius)
        if ways is None:
            raise NoPath("the robot is too close to an obstacle")
        rim = rim_cells(len(ways), round(RIM_M / res))
        rest = np.linalg.norm((rim[:, ::-1] + 0.5) * res - costmap.T_grid_map @ goal.xy, axis=1)
        total = ways[rim[:, 0], rim[:, 1]] + rest
        best = int(np.argmin(total))
        if not math.isfinite(total[best]):
            raise NoPath("no path out of the visible area")
        place = costmap.T_map_grid @ ((rim[best, ::-1] + 0.5) * res)
        ahead = goal.xy - place
        return SE2.from_xyt(place[0], place[1], math.atan2(ahead[1], ahead[0]))

    def stands_in(self, goal: SE2) -> bool:
        """Whether the plan ends at the edge of the window."""
        xy = self.static.T_grid_map @ goal.xy
        return bool(np.any(xy < RIM_M) or np.any(xy > self.static.size[0] - RIM_M))

    def _move_to(self, xy: Array) -> None:
        """Shift the window so that its centre is within reach of a point again."""
        res, cells = self.static.resolution, len(self._seen)
        off = np.floor((self.static.T_grid_map @ xy) / res).astype(int) - cells // 2
        if np.abs(off).max() <= self._shift_cells:
            return
        cols, rows = off.tolist()
        self._seen = shifted(self._seen, rows, cols, NEVER)
        self._hits = shifted(self._hits, rows, cols, 0)
        corner = np.round(self.static.T_map_grid.xy / res) + off
        self.static = free_floor(corner, cells, res)


def free_floor(corner: Array, cells: int, resolution: float) -> Costmap:
    """Unknown floor, which counts as free; `corner` (x, y) in cells."""
    x, y = (corner * resolution).tolist()
    return Costmap(np.zeros((cells, cells), dtype=bool), resolution, SE2.from_xyt(x, y, 0.0))


def shifted(values: NDArray[Any], rows: int, cols: int, empty: float) -> NDArray[Any]:
    """`values` of a window moved by (rows, cols); new cells are `empty`."""
    n, out = len(values), np.full_like(values, empty)
    to_r, to_c = slice(max(-rows, 0), min(n - rows, n)), slice(max(-cols, 0), min(n - cols, n))
    of_r, of_c = slice(max(rows, 0), min(n + rows, n)), slice(max(cols, 0), min(n + cols, n))
    if abs(rows) < n and abs(cols) < n:
        out[to_r, to_c] = values[of_r, of_c]
    return out


def rim_cells(cells: int, inset: int) -> Array:
    """Cells (n, 2) of a square ring, `inset` cells inside the window."""
    low, high = inset, cells - 1 - inset
    side = np.arange(low, high + 1)
    ends = np.full_like(side, low), np.full_like(side, high)
    edges = [np.stack([end, side], axis=1) for end in ends] + [np.stack([side, end], axis=1) for end in ends]
    return np.unique(np.concatenate(edges), axis=0)
