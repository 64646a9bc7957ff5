"""Routes through any world for the teleop scripts, planned on the true geometry.

They are for the simulated driver only (see `teleop_scripts.py`); the robot just receives its commands.
"""

from __future__ import annotations

import itertools
import math
from collections.abc import Callable
from functools import cached_property

import numpy as np
import scipy
from numpy.typing import NDArray

from turtlebag.datasets.errors import InputError
from turtlebag.datasets.se2 import SE2, Array
from turtlebag.sim.raycast import distance_to_point, keeps_clear, roomiest
from turtlebag.sim.robots import RobotSpec
from turtlebag.sim.world import World

CELL_M = 0.1
SIDE_M = 0.08
"""Room that a route keeps beside the robot's circumscribed circle [m]."""
EXACT_SIDE_M = 0.02
"""The same for a driver who turns on the spot and drives straight: that one keeps to its line."""
COMFORT_M = 0.35
"""With less room than this a way counts as longer."""
SEEN_M = 2.0
"""A place counts as visited when the route passes this near."""
NEAR_WALL_M = 0.5


class RoutePlanner:
    """Shortest comfortable ways over the floor that the robot's centre can reach from the spawn."""

    def __init__(self, world: World, robot: RobotSpec) -> None:
        self._outlines = world.touchable(robot.height)
        self._need = robot.model.circumscribed_radius + SIDE_M
        self.world = world
        x_min, x_max, y_min, y_max = world.bounds
        self._x, self._y = np.arange(x_min, x_max, CELL_M), np.arange(y_min, y_max, CELL_M)
        # The roomiest point of each cell, so that a door hardly wider than the robot is found.
        room, points = roomiest(
            self._x, self._y, CELL_M / 2.0, self._need, self._outlines.segments, self._outlines.circles
        )
        regions, _ = scipy.ndimage.label(room > self._need, structure=np.ones((3, 3)))
        row, col = self._cell(world.spawn.xy)
        near = regions[max(row - 3, 0) : row + 4, max(col - 3, 0) : col + 4]
        if not np.any(near):
            raise InputError(f"world {world.name}: {robot.name} has no room to move at its spawn")
        region = regions[row, col] or int(np.bincount(near[near > 0]).argmax())
        self._free = regions == region
        self._room = room
        self._number = np.full(room.shape, -1)
        self._number[self._free] = np.arange(np.count_nonzero(self._free))
        self.places = points[self._free]
        self.rooms = room[self._free]

    def room(self, x: float, y: float) -> float:
        """Distance from a point to the nearest thing that the robot could touch [m]."""
        return float(distance_to_point(x, y, self._outlines.segments, self._outlines.circles))

    def _cell(self, xy: Array) -> tuple[int, int]:
        col = int(np.clip(round((float(xy[0]) - self._x[0]) / CELL_M), 0, len(self._x) - 1))
        row = int(np.clip(round((float(xy[1]) - self._y[0]) / CELL_M), 0, len(self._y) - 1))
        return row, col

    @cached_property
    def _graph(self) -> scipy.sparse.csr_matrix:
        """Neighbouring free cells, weighted by distance and discomfort."""
        weight = 1.0 + 2.0 * np.clip((self._need + COMFORT_M - self._room) / COMFORT_M, 0.0, 1.0)
        starts, ends, costs = [], [], []
        for dr, dc in ((0, 1), (1, 0), (1, 1), (1, -1)):
            a = (slice(0, -dr or None), slice(max(-dc, 0), -dc if dc > 0 else None))
            b = (slice(dr, None), slice(max(dc, 0), dc if dc < 0 else None))
            both = self._free[a] & self._free[b]
            starts.append(self._number[a][both])
            ends.append(self._number[b][both])
            costs.append((0.5 * (weight[a] + weight[b]) * CELL_M * math.hypot(dr, dc))[both])
        n = len(self.places)
        flat = (np.concatenate(costs), (np.concatenate(starts), np.concatenate(ends)))
        return scipy.sparse.csr_matrix(flat, shape=(n, n))

    def nearest(self, xy: Array) -> int:
        """Number of the free place nearest to a point."""
        return int(np.argmin(np.hypot(*(self.places - xy).T)))

    def ways_from(self, place: int) -> tuple[Array, NDArray[np.int32]]:
        """Cost to every place and the place before it on the way, from one place."""
        shortest = scipy.sparse.csgraph.dijkstra
        cost, before = shortest(self._graph, directed=False, indices=place, return_predecessors=True)
        return cost, before

    def way(self, before: NDArray[np.int32], end: int) -> list[int]:
        """Places on the way to `end`."""
        trail = [end]
        while before[trail[-1]] >= 0:
            trail.append(int(before[trail[-1]]))
        return trail[::-1]

    def straightened(self, points: Array) -> Array:
        """The fewest of the points (n, 2) that still lead along them with room to spare."""
        kept, at = [0], 0
        while at < len(points) - 1:
            step = len(points) - 1 - at
            while step > 1 and not self._open(points[at], points[at + step]):
                step = max(1, int(step * 0.7))
            at += step
            kept.append(at)
        return points[kept]

    def fits(self, points: Array, side: float = SIDE_M) -> bool:
        """Whether the robot, turned any way, has `side` [m] of room along points (n, 2) from the spawn."""
        line = np.vstack([self.world.spawn.xy, points])
        return all(self._open(a, b, side) for a, b in itertools.pairwise(line))

    def _open(self, a: Array, b: Array, side: float = SIDE_M) -> bool:
        n = max(2, int(np.hypot(*(b - a)) / 0.05) + 1)
        line = a + np.linspace(0.0, 1.0, n)[:, None] * (b - a)
        need = self._need - SIDE_M + side
        return bool(keeps_clear(line, need, self._outlines.segments, self._outlines.circles))


def cover(planner: RoutePlanner, stages: list[NDArray[np.bool_]]) -> Array:
    """Route (n, 2) that passes near every place of each stage in turn, and home; nearest first."""
    place = home = planner.nearest(planner.world.spawn.xy)
    legs = [planner.places[place][None]]
    for wanted in stages:
        left = wanted.copy()
        left &= np.hypot(*(planner.places - planner.places[place]).T) > SEEN_M
        while np.any(left):
            cost, before = planner.ways_from(place)
            cost[~left] = np.inf
            end = int(np.argmin(cost))
            if not np.isfinite(cost[end]):
                break
            leg = planner.way(before, end)
            legs.append(planner.straightened(planner.places[leg])[1:])
            place = end
            for stop in leg[::3] + leg[-1:]:
                near = np.nonzero(left & (np.hypot(*(planner.places - planner.places[stop]).T) < SEEN_M))[0]
                seen = [p for p in near if planner._open(planner.places[stop], planner.places[p])]
                left[seen] = False
            left[end] = False
    _, before = planner.ways_from(place)
    legs.append(planner.straightened(planner.places[planner.way(before, home)])[1:])
    return np.vstack(legs)


def tour(planner: RoutePlanner) -> Array:
    """Everywhere, nearest first, and home."""
    return cover(planner, [_sparse(planner)])


def perimeter_then_rooms(planner: RoutePlanner) -> Array:
    """Along the walls first, then what is left of the middle, and home."""
    near_wall = planner.rooms < planner._need + NEAR_WALL_M
    sparse_places = _sparse(planner)
    return cover(planner, [sparse_places & near_wall, sparse_places])


def _sparse(planner: RoutePlanner) -> NDArray[np.bool_]:
    """Every third place each way: enough to aim for."""
    cells = np.round(planner.places / CELL_M).astype(np.int64)
    return np.all(cells % 3 == 0, axis=1)


def random_goals(planner: RoutePlanner, rng: np.random.Generator, length: float) -> Array:
    """A walk (n, 2) to places drawn at random, until it is `length` metres long."""
    place = planner.nearest(planner.world.spawn.xy)
    points = [planner.places[place][None]]
    done = 0.0
    while done < length:
        end = int(rng.integers(len(planner.places)))
        _, before = planner.ways_from(place)
        leg = planner.straightened(planner.places[planner.way(before, end)])
        done += float(np.linalg.norm(np.diff(leg, axis=0), axis=1).sum()) + CELL_M
        points.append(leg[1:])
        place = end
    return np.vstack(points)


def square(planner: RoutePlanner) -> Array:
    """Twice round a square of 2 m: the route of an empty world."""
    corners = np.array([[2.0, 0.0], [2.0, 2.0], [0.0, 2.0], [0.0, 0.0]] * 2)
    return SE2(planner.world.spawn.xyt) @ corners


ROUTES: dict[str, Callable[[RoutePlanner], Array]] = {
    "tour": tour,
    "perimeter_then_rooms": perimeter_then_rooms,
}


def route(name: str, planner: RoutePlanner, side: float = SIDE_M) -> Array:
    """A route of the world by name: its own if the robot fits, or one planned. InputError when unknown.

    `side` is the room [m] that the way of driving needs beside the robot.
    """
    own = planner.world.routes.get(name)
    if own is not None and (name not in ROUTES or planner.fits(own, side)):
        return own
    if name not in ROUTES:
        known = ", ".join(sorted({*planner.world.routes, *ROUTES}))
        raise InputError(f"world {planner.world.name} has no route '{name}' (it has: {known})")
    return ROUTES[name](planner) if planner.world.shapes else square(planner)
