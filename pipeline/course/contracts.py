"""The classes to complete. All poses are x [m], y [m], yaw [rad].

Lesson 3 completes a part of the mapper, `slam.graph.back_end.BackEnd`, and lesson 7 two of the navigation,
`planners.planner.GlobalPlanner` and `planners.control.controller.Controller`.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Protocol

import numpy as np
from numpy.typing import NDArray

from turtlebag.datasets.se2 import SE2, Array
from turtlebag.pipeline.slam.graph.constraints import Constraint


class WheelOdometry(Protocol):
    """Lesson 1: where the robot is, by its wheels."""

    def __init__(self, radius: float, track: float, start: Array) -> None:
        """`radius` of a wheel and distance `track` between both [m]; `start` (3,) is the first pose."""
        ...

    def update(self, left: float, right: float) -> Array:
        """The pose (3,), after the wheels reached these angles [rad], which grow when it drives ahead.

        The first call says what the angles are at the start; they need not be 0.
        """
        ...


class ScanMatcher(Protocol):
    """Lesson 2: the motion between two scans."""

    def match(self, points_a: Array, points_b: Array, guess: Array) -> Array:
        """`T_a_b` (3,): the pose of scan b seen from scan a.

        points_a (n, 2) and points_b (m, 2) are what the lidar saw, each in its own frame [m]; `guess` (3,) is
        `T_a_b` as the wheels measured it, up to 0.25 m and 0.2 rad off.
        """
        ...


class LoopCheck(Protocol):
    """Lesson 4: which loops are right."""

    def accept(
        self, T_map_keys: SE2, steps: Sequence[Constraint], loops: Sequence[Constraint]
    ) -> NDArray[np.bool_]:
        """Whether to accept each loop, (n_loops,) of True and False.

        `T_map_keys` are the poses (n,) by the steps alone; constraints are `T_i_j` (3,) with the
        `information` (3, 3) of that measurement. Most loops are right; the others are of places that look
        alike.
        """
        ...


class GridMapper(Protocol):
    """Lesson 5: the map of scans from known poses."""

    def __init__(self, resolution: float, origin: Array, shape: Array) -> None:
        """`resolution` is the size of a cell [m], `origin` (2,) the corner of cell (0, 0) [m], `shape` rows
        and columns; row 0 has the lowest y."""
        ...

    def map(self, poses: Array, ranges: Array, angles: Array) -> Array:
        """The probability that each cell is occupied, (rows, cols), 0.5 where nothing is known.

        `poses` (n, 3) are those of the lidar, `ranges` (n, m) [m] are inf where nothing was seen within
        3.5 m, `angles` (m,) are the directions of the beams at the lidar. Somebody walked through the room.
        """
        ...


class ParticleFilter(Protocol):
    """Lesson 6: where the robot is on a known map."""

    def __init__(self, distance: Array, resolution: float, origin: Array, start: Array, seed: int) -> None:
        """`distance` (rows, cols) is that of each cell to the nearest wall [m], row 0 at the lowest y.

        `origin` (2,) is the corner of cell (0, 0) [m], `resolution` the size of a cell [m]. `start` (3,) is
        where the robot may be: up to 0.3 m and 0.2 rad off. `seed` is for your random numbers.
        """
        ...

    def update(self, motion: Array, points: Array) -> Array:
        """The pose in the map (3,), after a motion and a scan.

        `motion` (3,) is in the robot's frame, as the wheels measured it; `points` (n, 2) too [m].
        """
        ...


class Avoider(Protocol):
    """Lesson 8: drive without a map."""

    def __init__(self, angles: Array, max_v: float, max_w: float) -> None:
        """`angles` (n,) of the beams at the robot [rad], 0 ahead; the robot's top speeds [m/s, rad/s]."""
        ...

    def command(self, ranges: Array) -> Array:
        """Speed ahead [m/s] and turning speed to the left [rad/s], (2,), from a scan (n,) [m].

        inf is a beam that saw nothing. The command holds until the next scan, 0.2 s later.
        """
        ...
