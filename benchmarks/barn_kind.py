"""Worlds of BARN's kind, as many as one likes: posts grown by a cellular automaton (Perille et al. 2020)."""

from __future__ import annotations

import math

import numpy as np
import scipy.ndimage

from benchmarks.plan_shortest import Lattice
from turtlebag.datasets.se2 import SE2
from turtlebag.datasets.seeds import stream
from turtlebag.planners.costmap import CostmapConfig, costmap_from_grid
from turtlebag.sim.robots import load_robot
from turtlebag.sim.shapes import Solid, cylinder
from turtlebag.sim.world import World
from turtlebag.sim.worlds import bounds_of

CELL_M, HIGH_M = 0.15, (0.0, 1.0)
COLUMNS, BEFORE, ROWS = 30, 34, 30
"""Cells across, rows of free floor before the posts begin, and rows of posts, as in BARN's files."""
PASSABLE = np.ones((5, 5))
"""Cells of floor along which there is a way through every one of BARN's 13 worlds at hand: 0.75 m."""
FILL, SMOOTHINGS = (0.15, 0.35), (2, 5)
"""Least and largest share of cells that are filled at first, and how often they are smoothed."""
START, GOAL = SE2.from_xyt(-2.25, 3.0, math.pi / 2.0), SE2.from_xyt(-2.25, 13.0, math.pi / 2.0)


def barn_like(seed: int) -> tuple[World, float]:
    """A world, and the length of the shortest way of the challenge's robot from START to GOAL [m]."""
    rng, robot = stream(seed, "worlds of BARN's kind"), load_robot("jackal")
    while True:
        filled = rng.random((ROWS, COLUMNS)) < rng.uniform(*FILL)
        for _ in range(rng.integers(SMOOTHINGS[0], SMOOTHINGS[1], endpoint=True)):
            filled = _smoothed(filled)
        if not _passable(filled):
            continue
        posts = _posts(filled)
        bounds = bounds_of((*posts, cylinder("goal", (float(GOAL.x), float(GOAL.y)), 1.0, HIGH_M)), 1.0)
        world = World(f"barn_like_{seed}", robot.name, START, posts, bounds, (), {})
        costmap = costmap_from_grid(world.rasterize(robot.lidar_height), CostmapConfig())
        return world, Lattice(costmap, robot.model).shortest(START, GOAL)


def _smoothed(filled: np.ndarray) -> np.ndarray:
    """More than four filled neighbours fill a cell, fewer than two empty it; beyond the sides all counts."""
    sides = np.pad(filled.astype(int), ((0, 0), (1, 1)), constant_values=1)
    near = scipy.ndimage.convolve(sides, np.ones((3, 3), int), mode="constant")[:, 1:-1] - filled
    return np.asarray((filled | (near > 4)) & (near >= 2))


def _passable(filled: np.ndarray) -> bool:
    sides = np.pad(filled, ((0, 0), (1, 1)), constant_values=True)
    parts, _ = scipy.ndimage.label(~scipy.ndimage.binary_dilation(sides, PASSABLE))
    return bool((set(parts[0].tolist()) & set(parts[-1].tolist())) - {0})


def _posts(filled: np.ndarray) -> tuple[Solid, ...]:
    """Posts in the filled cells, along both sides and behind the start."""
    cells = np.pad(filled, ((BEFORE, 0), (0, 0)))
    cells[:, [0, -1]] = True
    cells[0] = True
    at = [(-CELL_M * (c + 0.5), CELL_M * (r + 0.5)) for r, c in np.argwhere(cells).tolist()]
    return tuple(cylinder(f"post_{k}", xy, CELL_M / 2.0, HIGH_M) for k, xy in enumerate(at))
