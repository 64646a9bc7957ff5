"""Paths through gaps too narrow for the disc around the footprint: a lattice of every cell and 32 headings.

Where that disc fits, all headings of a cell are one state; elsewhere each heading is its
own. Moves are a step along the heading, forwards or backwards, and a turn on the spot to the next heading.
"""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

from turtlebag.datasets.se2 import SE2, Array
from turtlebag.planners.control.collision_monitor import padded
from turtlebag.planners.costmap import Costmap
from turtlebag.planners.footprint_motions import Ground, free_from, pull, turning
from turtlebag.planners.grid_distance import grid_distance
from turtlebag.planners.lattice_search import BLOCKED, Floor, ends, flood, number_cells, shortest
from turtlebag.planners.smoothing import SPACING_M, densify

_REACH = range(-3, 4)
HEADINGS = np.array(
    sorted(
        ((x, y) for x in _REACH for y in _REACH if math.gcd(x, y) == 1), key=lambda v: math.atan2(v[1], v[0])
    )
)
"""Steps (32, 2) as columns and rows, counter-clockwise; the widest gap is 18.4 degrees."""
YAWS = np.arctan2(HEADINGS[:, 1], HEADINGS[:, 0])
N = len(HEADINGS)
BACKWARDS, TURN = 2.0, 0.2
"""What driving backwards costs a cell, and turning by one heading, beside a cell forwards."""
SIDEWAYS = math.cos(2.0 * math.pi / N)
"""A step whose direction has a smaller cosine with the heading is no drive: off by a mean heading."""


class Lattice:
    """The lattice of one map for one footprint (n, 2) that keeps `room` [m] to lethal cells' centres."""

    def __init__(self, costmap: Costmap, footprint: Array, room: float) -> None:
        corners = padded(footprint, room) if room > 0.0 else footprint
        self._ground = Ground(costmap.clearance, costmap.resolution, corners)
        outer = float(np.linalg.norm(corners, axis=1).max())
        numbers, narrow = number_cells(costmap.clearance, inscribed_radius(corners), outer)
        stands, turns = np.zeros((2, narrow * N), dtype=np.int8)
        self._floor = Floor(self._ground, numbers, stands, turns, HEADINGS, YAWS, BACKWARDS, TURN)

    def joins(self, T_grid_start: SE2, T_grid_goal: SE2) -> bool:
        """Whether some way leads from one pose to the other."""
        states = [ends(self._floor, pose.xyt)[0] for pose in (T_grid_start, T_grid_goal)]
        return all(map(len, states)) and bool(flood(self._floor, *states))

    def way(self, T_grid_start: SE2, T_grid_goal: SE2) -> SE2 | None:
        """Poses (n,) of a short way; None when there is none."""
        (starts, costs), (goals, _) = (ends(self._floor, T.xyt) for T in (T_grid_start, T_grid_goal))
        if len(starts) == 0 or len(goals) == 0:
            return None
        row, col = (int(v) for v in np.floor(T_grid_goal.xy[::-1] / self._ground.res))
        rest = grid_distance(self._floor.numbers != BLOCKED, row, col, np.inf)
        states = shortest(self._floor, starts, costs, goals, rest)
        if len(states) == 0:
            return None
        points = np.concatenate(
            [T_grid_start.xy[None], (states[:, :2] + 0.5) * self._ground.res, T_grid_goal.xy[None]]
        )
        first, last = float(T_grid_start.yaw), float(T_grid_goal.yaw)
        tight = pull(self._ground, densify(points, self._ground.res), first, last)
        # Pulled into a corner from which it does not turn on, the lattice's own steps; last, with slips.
        ways = (
            tight,
            *((points, step_yaws(points, states[:, 2], first, last, slip)) for slip in (False, True)),
        )
        for kept, yaws in ways:
            poses = self._poses(kept, yaws, first, last)
            if free_from(self._ground, poses.xyt) == 0:
                break
        return poses

    def _poses(self, kept: Array, yaws: Array, first: float, last: float) -> SE2:
        """Poses along straight drives between corners (m, 2) in headings (m - 1,)."""
        headings = np.concatenate([[first], yaws, [last]])
        angles = [
            turning(self._ground, point, old, new)
            for point, old, new in zip(kept, headings, headings[1:], strict=False)
        ]
        return drive_poses(kept, headings, np.array(angles), SPACING_M)


def inscribed_radius(corners: Array) -> float:
    """Distance from the base origin to the nearest edge [m]."""
    edge = np.roll(corners, -1, axis=0) - corners
    across = edge[:, 0] * -corners[:, 1] - edge[:, 1] * -corners[:, 0]
    return float(np.abs(across / np.linalg.norm(edge, axis=1)).min())


def step_yaws(points: Array, headings: NDArray[np.int64], first: float, last: float, slip: bool) -> Array:
    """The heading of each step between points (n + 2, 2): forwards, unless a narrow state says backwards.

    With `slip` the first and the last step may go to the side, in the heading the robot has there.
    """
    around = np.concatenate([[first], np.where(headings >= 0, YAWS[headings], np.nan), [last]])
    ahead = np.diff(points, axis=0)
    yaws = np.arctan2(ahead[:, 1], ahead[:, 0])
    robot = np.where(np.isnan(around[1:]), around[:-1], around[1:])
    robot[-1] = around[-2] if np.isfinite(around[-2]) else last
    robot = np.where(np.isnan(robot), yaws, robot)
    along = np.cos(yaws - robot)
    out = np.where(along < 0.0, yaws + math.pi, yaws)
    moved = np.linalg.norm(ahead, axis=1) > 1e-9
    for k in (0, -1) if slip else ():
        moved[k] &= abs(along[k]) > SIDEWAYS
    return np.where(moved, out, robot)


def drive_poses(kept: Array, headings: Array, angles: Array, spacing: float) -> SE2:
    """Poses along straight drives between corners (m, 2), each looking as it is driven.

    `headings` (m + 1,) are those before and after each corner, `angles` (m,) how it is turned there.
    """
    xyt = [[*kept[0], headings[0]]]
    for k, angle in enumerate(angles):
        if abs(angle) > math.pi:  # the long way round, step by step
            xyt += [[*kept[k], headings[k] + angle * i / 3.0] for i in range(0 if k else 1, 3)]
        if k == len(kept) - 1:
            break
        a, b = kept[k], kept[k + 1]
        steps = max(1, math.ceil(float(np.linalg.norm(b - a)) / spacing))
        # The first pose of a drive is the corner, already turned; at the start it is the robot's own.
        xyt += [[*(a + (b - a) * i / steps), headings[k + 1]] for i in range(0 if k else 1, steps)]
    xyt.append([*kept[-1], headings[-1]])
    return SE2.from_array(np.array(xyt))
