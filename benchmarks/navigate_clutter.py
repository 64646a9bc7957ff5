"""Episodes among things that are not on the map: boxes, and people who walk about."""

from __future__ import annotations

import dataclasses
import math

import numpy as np

from benchmarks.navigate_cases import Case, floor, goal_request, named_floor, pose_on
from benchmarks.navigate_maps import Maps
from turtlebag.datasets.grid import OccupancyGrid
from turtlebag.datasets.se2 import SE2
from turtlebag.datasets.seeds import stream
from turtlebag.planners.costmap import CostmapConfig, costmap_from_grid
from turtlebag.sim.movers import Mover
from turtlebag.sim.shapes import Solid, box, cylinder

WALKER_ROOM_M = 0.5
"""Movers start where they have so much room: one that cannot move is a wall."""


def obstacles(maps: Maps, yields: bool, name: str, seed: int) -> Case:
    """House goals among five boxes and three movers; waffle_pi and burger in turn.

    Movers that do not yield walk on whoever stands in their way.
    """
    robot_name = ("waffle_pi", "burger")[seed % 2]
    house, robot, grid, cells = named_floor("turtlebot3_house", robot_name)
    rng = stream(seed, name)
    while True:
        boxes = tuple(_box(k, grid, cells, rng) for k in range(5))
        world = dataclasses.replace(house, shapes=house.shapes + boxes)
        true_grid, free = floor(world, robot)
        # Boxes that shut off much of the house would make many goals unreachable.
        if len(free) > 0.7 * len(cells):
            break
    start, goal = pose_on(true_grid, free, rng), pose_on(true_grid, free, rng)
    clearance = costmap_from_grid(true_grid, CostmapConfig()).clearance
    wide = free[clearance[free[:, 0], free[:, 1]] > WALKER_ROOM_M]
    movers = tuple(_mover(k, true_grid, wide, start, yields, rng) for k in range(3))
    world = dataclasses.replace(world, movers=movers)
    path = maps.slam("turtlebot3_house", robot_name)
    return Case(name, seed, world, robot, goal_request(seed, path, start, goal))


def _box(k: int, grid: OccupancyGrid, cells: np.ndarray, rng: np.random.Generator) -> Solid:
    x, y = grid.center_of(cells[rng.integers(len(cells))])
    size = (float(rng.uniform(0.2, 0.5)), float(rng.uniform(0.2, 0.5)))
    return box(f"box_{k}", (float(x), float(y)), size, float(rng.uniform(-3.0, 3.0)), (0.0, 0.5))


def _mover(
    k: int, grid: OccupancyGrid, cells: np.ndarray, start: SE2, yields: bool, rng: np.random.Generator
) -> Mover:
    while True:
        x, y = grid.center_of(cells[rng.integers(len(cells))])
        if math.hypot(x - start.x, y - start.y) > 1.5:
            break
    return Mover(
        solid=cylinder(f"mover_{k}", (0.0, 0.0), 0.2, (0.0, 1.0)),
        path=np.array([[x, y]]),
        speed=0.3,
        wander=True,
        area=(x - 2.0, x + 2.0, y - 2.0, y + 2.0),
        yields=yields,
    )
