"""A map's walls as one solid of a world."""

from __future__ import annotations

from dataclasses import dataclass, field
from pathlib import Path

import numpy as np
import scipy

from turtlebag.datasets.errors import InputError
from turtlebag.datasets.grid import FREE, FREE_TO, OCCUPIED_FROM, OccupancyGrid
from turtlebag.datasets.maps import load_map
from turtlebag.datasets.se2 import SE2, Array
from turtlebag.sim.outlines import Mask, edges, least_corners, outlines
from turtlebag.sim.shapes import NO_CIRCLES, NO_SEGMENTS, Bools, Mesh, within

WALL_M = 2.0
"""Height of the walls, above every lidar."""
MOST_SEGMENTS = 200_000


@dataclass(frozen=True, eq=False)
class Plan(Mesh):
    """Upright walls over the cells of a map that are not free.

    `segments` (n, 4) bound what is solid, `walls` (m, 4) its occupied cells alone, whether or not its unknown
    cells are solid; both in the world frame. `grid` is the map.
    """

    segments: Array = field(default_factory=lambda: NO_SEGMENTS)
    walls: Array = field(default_factory=lambda: NO_SEGMENTS)
    grid: OccupancyGrid = field(default_factory=lambda: OccupancyGrid(np.zeros((1, 1), np.int8), 1.0))

    def outline(self, low: float, high: float) -> tuple[Array, Array]:
        """Its segments: the same at every height."""
        return self.segments, NO_CIRCLES

    def inside(self, z: float, points: Array) -> Bools:
        """Which points (n, 2) lie inside what is solid, (n,)."""
        return within(self.segments, points)


def load_plan(path: Path, name: str, *, solid: bool, z: tuple[float, float] = (0.0, WALL_M)) -> Plan:
    """The walls of a map yaml; `solid`: its unknown cells are solid as well. InputError without any wall."""
    grid = load_map(path)
    occupied = grid.cells >= OCCUPIED_FROM
    if not occupied.any():
        raise InputError(f"{path}: no occupied cell: a world needs walls")
    if not free(grid).any():
        raise InputError(f"{path}: no free cell: a robot has no place to stand")
    walls = _segments(occupied, grid, path)
    segments = _segments(~free(grid), grid, path) if solid else walls
    corners = np.hstack([segments[:, :2], segments[:, 2:]]).reshape(-1, 2)
    low, high = corners.min(axis=0), corners.max(axis=0)
    box = np.array([[low[0], low[1]], [high[0], low[1]], [high[0], high[1]], [low[0], high[1]]])
    center = (float(low[0] + high[0]) / 2.0, float(low[1] + high[1]) / 2.0)
    return Plan(name, *z, center, box, 0.0, 1.0, _upright(segments, z), segments, walls, grid)


def free(grid: OccupancyGrid) -> Mask:
    """The free cells of a map, (rows, cols)."""
    return np.asarray((grid.cells >= FREE) & (grid.cells <= FREE_TO))


def roomiest_place(grid: OccupancyGrid) -> SE2:
    """The middle of the free cell that is farthest from all others, towards x."""
    room = scipy.ndimage.distance_transform_edt(np.pad(free(grid), 1))[1:-1, 1:-1]
    cell = np.array(np.unravel_index(int(np.argmax(room)), room.shape))
    x, y = grid.center_of(cell).tolist()
    return SE2.from_xyt(x, y, 0.0)


def _segments(marked: Mask, grid: OccupancyGrid, path: Path) -> Array:
    """The outlines of marked cells as segments (n, 4) in the world frame; InputError for too many."""
    lines = outlines(marked) if least_corners(marked) <= MOST_SEGMENTS else None
    if lines is None or sum(map(len, lines)) > MOST_SEGMENTS:
        raise InputError(f"{path}: the outlines of its cells have more than {MOST_SEGMENTS} corners")
    return edges([grid.T_map_grid @ (grid.resolution * line) for line in lines])


def _upright(segments: Array, z: tuple[float, float]) -> Array:
    """Two triangles for each segment, (2 n, 3, 3)."""
    low, high = np.full((len(segments), 1), z[0]), np.full((len(segments), 1), z[1])
    a, b = segments[:, :2], segments[:, 2:]
    first = np.stack([np.hstack([a, low]), np.hstack([b, low]), np.hstack([b, high])], axis=1)
    second = np.stack([np.hstack([a, low]), np.hstack([b, high]), np.hstack([a, high])], axis=1)
    return np.concatenate([first, second], axis=1).reshape(-1, 3, 3)
