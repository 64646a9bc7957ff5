"""The obstacle layer: cells are marked where beams end, cleared where they pass, and expire."""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from turtlebag.datasets.kernels import njit
from turtlebag.datasets.se2 import SE2, Array
from turtlebag.planners.costmap import Costmap, Mask, distance_field

NEVER = -math.inf
"""Stamp [s] of a cell without a mark."""
BLOCK = 8
"""Beams pass blocks of so many cells by so many at once where nothing was hit in them or beside them."""
REACH_M = 1.2
"""Clearance is updated up to this distance from marked obstacles: larger values are not needed."""


class Marking(NamedTuple):
    """When a cell is marked, and when a mark counts; names as in costmap_2d, where it has them; SI units."""

    obstacle_range: float = 2.5
    """Beams that end farther away do not mark."""
    wall_margin: float = 0.14
    """A beam that ends this near an obstacle of the map does not mark."""
    decay: float = 8.0
    """Seconds after which a mark expires unless it is seen again."""
    hits: int = 2
    """Sweeps that must hit a cell within `decay` before it counts: a single one may be noise."""
    replan_s: float = 1.0
    """Least time between two plans while the path is blocked."""


ON_MAP = Marking()


class ObstacleLayer:
    """Obstacles that the lidar sees, over a static costmap of the same grid."""

    costmap: Costmap
    """The static map with the marked obstacles of the last update."""
    marked: int
    """Number of marked cells."""
    _marks: Mask

    def __init__(self, static: Costmap, marking: Marking = ON_MAP) -> None:
        self.marking = marking
        self.static = static
        """The map, with a way out of the keep-out area that the robot was in when it last planned."""
        self._closed = static
        shape = static.lethal.shape
        self._seen: NDArray[np.float64] = np.full(shape, NEVER)
        self._hits: NDArray[np.int16] = np.zeros(shape, dtype=np.int16)
        self._shown: Costmap | None = None
        self._show(np.zeros(shape, dtype=bool))

    def update(self, now_s: float, origin: SE2, hits: Array, passes: Array) -> None:
        """Add a sweep: end points (n, 2) of beams that hit, and of beams without return, map frame. `origin`
        is the lidar's pose in the map frame."""
        static, c = self.static, self.marking
        x, y = (static.T_grid_map @ origin.xy).tolist()
        ends = static.T_grid_map @ np.concatenate([hits, passes])
        beams = GridBeams(x, y, ends, len(hits), c.obstacle_range, c.wall_margin)
        mark_and_clear(self._seen, self._hits, static.clearance, static.resolution, beams, now_s)
        self._show(marks(self._seen, self._hits, now_s - c.decay, c.hits))

    def let_out(self, T_map_base: SE2, radius: float) -> None:
        """Let a disc of `radius` [m] out of a keep-out area; any earlier way out is closed again."""
        if self._closed.keepout is not None:
            self.static = self._closed.with_way_out(T_map_base, radius)
            self._show(self._marks)

    def aim(self, pose: SE2, goal: SE2, radius: float) -> SE2:
        """The pose to plan to on the way from a pose to a goal: on a map, the goal itself."""
        del pose, radius
        return goal

    def stands_in(self, goal: SE2) -> bool:
        """Whether the plan currently ends elsewhere than at the goal: on a map, never."""
        del goal
        return False

    def clear(self) -> None:
        """Forget all obstacles seen."""
        self._seen[:] = NEVER
        self._hits[:] = 0
        self._show(np.zeros_like(self.static.lethal))

    def _show(self, marked: Mask) -> None:
        if self._shown is self.static and np.array_equal(marked, self._marks):
            return  # so that nobody looks at the same costmap anew
        self._marks, self._shown, self.marked = marked, self.static, int(marked.sum())
        self.costmap = self._combined(marked) if self.marked else self.static

    def _combined(self, marked: Mask) -> Costmap:
        """The smaller of both clearances: exact within REACH_M of marked cells, and so everywhere."""
        static = self.static
        rows, cols = np.flatnonzero(marked.any(axis=1)), np.flatnonzero(marked.any(axis=0))
        pad = math.ceil(REACH_M / static.resolution)
        window = (
            slice(max(rows[0] - pad, 0), rows[-1] + pad + 1),
            slice(max(cols[0] - pad, 0), cols[-1] + pad + 1),
        )
        near = distance_field(marked[window], static.resolution)
        clearance = static.clearance.copy()
        # Beyond REACH_M the distance to a marked obstacle is deliberately capped: nothing is that near.
        np.minimum(clearance[window], near, out=clearance[window])
        combined = static.with_lethal(marked)
        combined.__dict__["clearance"] = clearance
        return combined


class GridBeams(NamedTuple):
    """A sweep in the grid frame: where it was taken, and the ends (n, 2) of beams, those that hit first."""

    x: float
    y: float
    ends: Array
    n_hits: int
    obstacle_range: float
    wall_margin: float


@njit(cache=True)
def mark_and_clear(
    seen: Array,
    hits: NDArray[np.int16],
    clearance: NDArray[np.float32],
    resolution: float,
    beams: GridBeams,
    now_s: float,
) -> None:
    """Walk along each beam in half-cell steps and clear; then mark its end, unless it is an obstacle of the
    map."""
    rows, cols = seen.shape
    x, y, ends, n_hits, obstacle_range, wall_margin = beams
    near = blocks_near_hits(hits)
    for k in range(len(ends)):
        dx, dy = ends[k, 0] - x, ends[k, 1] - y
        length = math.hypot(dx, dy)
        if length == 0.0:
            continue
        step_x, step_y = 0.5 * dx / length, 0.5 * dy / length  # in cells
        stop = length - (1.5 * resolution if k < n_hits else 0.0)
        i, steps = 0, math.ceil(2.0 * stop / resolution)
        while i < steps:
            col, row = math.floor(x / resolution + i * step_x), math.floor(y / resolution + i * step_y)
            i += 1
            if 0 <= row < rows and 0 <= col < cols:
                if not near[row // BLOCK + 1, col // BLOCK + 1]:
                    i += 2 * BLOCK - 1
                elif hits[row, col] > 0 and seen[row, col] < now_s:
                    seen[row, col] = NEVER
                    hits[row, col] = 0
            elif (step_x if col >= cols else -step_x if col < 0 else step_y if row >= rows else -step_y) >= 0:
                break  # off the grid, and away from it
    for k in range(n_hits):
        if math.hypot(ends[k, 0] - x, ends[k, 1] - y) > obstacle_range:
            continue
        col, row = math.floor(ends[k, 0] / resolution), math.floor(ends[k, 1] / resolution)
        if 0 <= row < rows and 0 <= col < cols and clearance[row, col] > wall_margin:
            if seen[row, col] < now_s:
                hits[row, col] = min(hits[row, col] + 1, 1000)
            seen[row, col] = now_s


@njit(cache=True)
def blocks_near_hits(hits: NDArray[np.int16]) -> Mask:
    """Which blocks hold a hit or are beside one that does; with a block's margin around the grid."""
    rows, cols = hits.shape
    near = np.zeros((rows // BLOCK + 3, cols // BLOCK + 3), dtype=np.bool_)
    for row in range(rows):
        for col in range(cols):
            if hits[row, col] > 0:
                r, c = row // BLOCK, col // BLOCK
                near[r : r + 3, c : c + 3] = True
    return near


@njit(cache=True)
def marks(seen: Array, hits: NDArray[np.int16], since_s: float, least: int) -> Mask:
    """Cells that were hit since then, often enough; the hits of others are forgotten."""
    marked = np.zeros(seen.shape, dtype=np.bool_)
    for row in range(seen.shape[0]):
        for col in range(seen.shape[1]):
            if hits[row, col] > 0:
                marked[row, col] = hits[row, col] >= least and seen[row, col] > since_s
                if seen[row, col] <= since_s:
                    hits[row, col] = 0
    return marked
