"""The classes to complete, one for each lesson. All poses are x [m], y [m], yaw [rad]."""

from __future__ import annotations

from typing import Protocol

from turtlebag.datasets.se2 import Array


class ScanMatcher(Protocol):
    """Lesson 2: the motion between two scans."""

    def match(self, points_a: Array, points_b: Array, guess: Array) -> Array:
        """`T_a_b` (3,): the pose of scan b seen from scan a.

        points_a (n, 2) and points_b (m, 2) are what the lidar saw, each in its own frame [m]; `guess` (3,) is
        `T_a_b` as the wheels measured it, up to 0.25 m and 0.2 rad off.
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
