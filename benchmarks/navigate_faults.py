"""Episodes in which something goes wrong: carried off, slipping wheels, a silent lidar, a wrong map or pose.

Each in the arena (burger, the patrol) and in the house (waffle_pi and burger in turn, one goal).
"""

from __future__ import annotations

import dataclasses
import math

import numpy as np

from benchmarks.drives import Maps
from benchmarks.navigate_cases import (
    HOUSE,
    Case,
    floor,
    goal_case,
    house_robot,
    named_floor,
    patrol,
    pose_on,
    random_goal,
)
from turtlebag.datasets.grid import OccupancyGrid
from turtlebag.datasets.se2 import SE2
from turtlebag.datasets.seeds import stream
from turtlebag.planners.costmap import CostmapConfig, costmap_from_grid
from turtlebag.planners.tasks.waypoints import tutorial_patrol
from turtlebag.sim.faults import FaultConfig
from turtlebag.sim.shapes import Solid, box
from turtlebag.sim.world import World

OFF_M, OFF_RAD = 0.5, math.radians(30.0)
FAR_M = 4.0
"""Goals of episodes with a fault are this far from the start: there is time for it."""
CARRIED_M = 1.5
DOORS = ((2.3, 0.4, 1), (2.3, 4.63, 1), (-6.3092, 0.925, 0), (6.2195, -0.175, 0))
"""Doors of the house: middle [m], and 1 for one in a wall along y. None has a way round."""
DOOR_M, THICK_M = 0.9, 0.15


def drive_to(maps: Maps, place: str, name: str, seed: int) -> Case:
    """What is done while the fault happens: the patrol in the arena, a far goal in the house."""
    if place == "arena":
        return patrol(maps, name, seed)
    for attempt in range(1000):
        case = random_goal(maps, HOUSE, house_robot(seed), name, seed + 100_000 * attempt)
        assert case.request.goal is not None
        if np.linalg.norm(case.start.xy - case.request.goal.xy) > FAR_M:
            return case.asked(seed=seed)
    raise ValueError("no two places so far apart")


def offset(maps: Maps, place: str, name: str, seed: int) -> Case:
    """The robot is told a pose that is wrong by 0.5 m and 30 degrees."""
    case = drive_to(maps, place, name, seed)
    rng = stream(seed, "offset")
    angle, sign = rng.uniform(-math.pi, math.pi), rng.choice([-1.0, 1.0])
    wrong = case.start @ SE2.from_xyt(OFF_M * math.cos(angle), OFF_M * math.sin(angle), sign * OFF_RAD)
    return case.asked(initial_pose=wrong)


def kidnap(maps: Maps, place: str, name: str, seed: int) -> Case:
    """Carried off once, 1.5 m or more."""
    case = drive_to(maps, place, name, seed)
    rng = stream(seed, "kidnap")
    grid, cells = allowed_floor(case, place)
    while np.linalg.norm((pose := pose_on(grid, cells, rng)).xy - case.start.xy) <= CARRIED_M:
        pass
    when = rng.uniform(20.0, 60.0) if place == "arena" else rng.uniform(6.0, 14.0)
    return case.simulated(faults=FaultConfig(kidnap=((when, *pose.xyt.tolist()),)))


def allowed_floor(case: Case, place: str) -> tuple[OccupancyGrid, np.ndarray]:
    """Cells (n, 2) to be put down on: where the robot may be by its own keep-out areas."""
    if place != "arena":
        return named_floor(case.world.name, case.robot.name)[2:]
    grid = case.world.rasterize(case.robot.lidar_height)
    costmap = costmap_from_grid(grid, CostmapConfig(), tutorial_patrol().keepout)
    return grid, np.argwhere(costmap.clearance > case.robot.model.circumscribed_radius + 0.05)


def slip(maps: Maps, place: str, name: str, seed: int) -> Case:
    """Twice for 2 s: both wheels lose 70 % of their turning, later one of them 60 %."""
    rng = stream(seed, "slip")
    first, second = rng.uniform(5.0, 10.0), rng.uniform(14.0, 20.0)
    one = (0.6, 0.0) if rng.random() < 0.5 else (0.0, 0.6)
    spans = ((first, first + 2.0, 0.7, 0.7), (second, second + 2.0, *one))
    return drive_to(maps, place, name, seed).simulated(faults=FaultConfig(slip=spans))


def dropout(maps: Maps, place: str, name: str, seed: int) -> Case:
    """The lidar is silent for 2 s, twice."""
    rng = stream(seed, "dropout")
    first, second = rng.uniform(4.0, 10.0), rng.uniform(14.0, 20.0)
    spans = ((first, first + 2.0), (second, second + 2.0))
    return drive_to(maps, place, name, seed).simulated(faults=FaultConfig(scan_silent=spans))


def closed_ring(maps: Maps, name: str, seed: int) -> Case:
    """The arena's ring is shut between two waypoints: the patrol must find the other way round."""
    rng = stream(seed, "door")
    # The patrol's minute for a waypoint is not enough for the long way.
    case = patrol(maps, name, seed).asked(timeout_s=150.0)
    x, y = (float(rng.choice([-1.0, 1.0])) * part for part in (0.75, 1.8))
    wall = box("shut_ring", (x, y), (0.1, 1.5), 0.0, (0.0, 0.5))  # from the pillars to the arena's wall
    return dataclasses.replace(case, world=with_solid(case.world, wall))


def closed_door(maps: Maps, name: str, seed: int) -> Case:
    """The only door to the goal's part of the house, open on the map, is shut: to say so is right."""
    rng = stream(seed, "door")
    world, spec, grid, cells = named_floor(HOUSE, house_robot(seed))
    x, y, along_y = DOORS[seed // 2 % len(DOORS)]
    size = (THICK_M, DOOR_M) if along_y else (DOOR_M, THICK_M)
    shut = with_solid(world, box("shut_door", (x, y), size, 0.0, (0.0, 2.0)))
    _, outside = floor(shut, spec)
    inside = np.array(sorted({tuple(c) for c in cells.tolist()} - {tuple(c) for c in outside.tolist()}))
    # Not in the doorway itself.
    room = inside[np.hypot(*(grid.center_of(inside) - (x, y)).T) > 1.0]
    start, goal = pose_on(grid, outside, rng), pose_on(grid, room, rng)
    path = maps.slam(HOUSE, spec.name)
    return goal_case(name, seed, shut, spec, path, start, goal, wanted="unreachable")


def with_solid(world: World, solid: Solid) -> World:
    """The world with something in it that its map does not show."""
    return dataclasses.replace(world, shapes=(*world.shapes, solid))
