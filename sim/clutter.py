"""Unmapped clutter: boxes and walking people, drawn from a seed."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import replace

import numpy as np
import scipy
from numpy.typing import NDArray

from turtlebag.datasets.errors import InputError
from turtlebag.datasets.se2 import Array
from turtlebag.datasets.seeds import stream
from turtlebag.sim.generators import seeded
from turtlebag.sim.movers import Mover
from turtlebag.sim.raycast import roomiest
from turtlebag.sim.shapes import Solid, box, cylinder, sections
from turtlebag.sim.world import World

CELL_M = 0.1
ROOM_M = 0.25
"""A floor cell with less room than this to the next solid is not counted as a way."""
SPAWN_M, ROUTE_M = 0.8, 0.35
"""Boxes and movers start at least this far from the spawn and from the points of the world's routes."""
LEFT, LEAST = 0.85, 0.4
"""Shares of the floor that must stay in reach: of what no box takes up, and of all."""
HEIGHT = (0.0, 1.0)
LIMITS = {"boxes": (0, 20), "movers": (0, 20)}
TRIES = 300


def cluttered(world: World, settings: str) -> World:
    """The world with clutter: `SEED,boxes=3,movers=2`. InputError names what is wrong or has no room.

    Boxes never cut off much of the floor. The first boxes of a seed are the same however many follow, and
    movers do not depend on boxes; a mover stops before it would touch the robot.
    """
    name = f"{world.name}+clutter:{settings}"
    seed, given = seeded(name, settings, LIMITS)
    counts = {"boxes": 3, "movers": 0} | given
    floor = _Floor(world)
    solids: list[Solid] = []
    rng = stream(seed, "clutter boxes")
    for number in range(counts["boxes"]):
        solids.append(_box(number, floor, solids, rng, world.name))
    rng = stream(seed, "clutter movers")
    movers = [_mover(number, floor, rng) for number in range(counts["movers"])]
    return replace(world, name=name, shapes=(*world.shapes, *solids), movers=(*world.movers, *movers))


class _Floor:
    """Cells of the floor that can be reached from the spawn."""

    def __init__(self, world: World) -> None:
        self._spawn = world.spawn.xy
        self._taboo = np.vstack([self._spawn[None], *world.routes.values()])
        x_min, x_max, y_min, y_max = world.bounds
        self._x, self._y = np.arange(x_min, x_max, CELL_M), np.arange(y_min, y_max, CELL_M)
        self._standing = self._rooms(world.below(HEIGHT[1]))
        self._open = self._reachable(self._standing)
        if not np.any(self._open):
            raise InputError(f"{world.name}: no floor to put clutter on")

    def _rooms(self, solids: Sequence[Solid]) -> Array:
        """Distance of each cell's middle to the nearest of the solids, (rows, cols)."""
        lines = sections(list(solids), *HEIGHT)
        rooms: Array = roomiest(self._x, self._y, 0.0, -1.0, lines.segments, lines.circles)[0]
        return rooms

    def _reachable(self, rooms: Array) -> NDArray[np.bool_]:
        regions, _ = scipy.ndimage.label(rooms > ROOM_M)
        col = int(np.argmin(np.abs(self._x - self._spawn[0])))
        row = int(np.argmin(np.abs(self._y - self._spawn[1])))
        near = regions[max(row - 2, 0) : row + 3, max(col - 2, 0) : col + 3]
        found = near[near > 0]
        return regions == (int(np.bincount(found).argmax()) if len(found) else -1)

    def place(self, rng: np.random.Generator) -> Array:
        """A place on it, (2,)."""
        rows, cols = np.nonzero(self._open)
        pick = int(rng.integers(len(rows)))
        return np.array([self._x[cols[pick]], self._y[rows[pick]]]) + rng.uniform(-0.5, 0.5, 2) * CELL_M

    def is_clear(self, xy: Array, radius: float) -> bool:
        """Whether something of that radius there is away from the spawn and from the routes' points."""
        far = np.linalg.norm(self._taboo - xy, axis=1) - radius
        return bool(far[0] > SPAWN_M and np.all(far[1:] > ROUTE_M))

    def leaves_ways(self, solids: Sequence[Solid]) -> bool:
        """Whether most of the floor can still be reached with the solids on it."""
        rooms = self._rooms(solids)
        left = np.count_nonzero(self._reachable(np.minimum(self._standing, rooms)))
        beside, all_of_it = np.count_nonzero(self._open & (rooms > ROOM_M)), np.count_nonzero(self._open)
        return bool(left >= LEFT * beside and left >= LEAST * all_of_it)


def _box(number: int, floor: _Floor, placed: Sequence[Solid], rng: np.random.Generator, where: str) -> Solid:
    for _ in range(TRIES):
        xy, (width, depth) = floor.place(rng), rng.uniform(0.15, 0.35, 2)
        yaw = float(rng.uniform(-math.pi, math.pi))
        one = box(
            f"clutter_{number}", (float(xy[0]), float(xy[1])), (float(width), float(depth)), yaw, (0.0, 0.5)
        )
        apart = all(np.linalg.norm(np.array(other.center) - xy) > 0.35 for other in placed)
        clear = floor.is_clear(xy, 0.5 * math.hypot(width, depth))
        if apart and clear and floor.leaves_ways([*placed, one]):
            return one
    raise InputError(f"{where}: no room for box {number + 1} of the clutter")


def _mover(number: int, floor: _Floor, rng: np.random.Generator) -> Mover:
    xy = floor.place(rng)
    for _ in range(TRIES):
        if floor.is_clear(xy, 0.15):
            break
        xy = floor.place(rng)
    x, y = float(xy[0]), float(xy[1])
    solid = cylinder(f"walker_{number}", (0.0, 0.0), 0.15, HEIGHT)
    area = (x - 2.0, x + 2.0, y - 2.0, y + 2.0)
    return Mover(solid, xy[None], 0.3, wander=True, area=area, yields=True)
