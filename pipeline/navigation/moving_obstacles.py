"""Moving obstacles: which points of the scan belong to them, and when to stop for them."""

from __future__ import annotations

from collections import deque

import numpy as np
import scipy
from numpy.typing import NDArray

from turtlebag.datasets.se2 import SE2, Array
from turtlebag.datasets.types import RobotModel
from turtlebag.pipeline.navigation.sensing import DeskewedScan
from turtlebag.planners.control.collision_monitor import depth_inside, padded

BEFORE_NS = 350_000_000
"""Sweeps are compared over this time: at 0.3 m/s, an object moves 10 cm, well beyond the noise."""
BINS, NEIGHBOURS = 360, 2
"""Bearings of a profile, one for each beam of an LDS-01; a beam also stands for this many on both sides."""
SHIFT_M = 0.06
"""A sweep that saw this much farther saw through the place: six standard deviations at 1 cm of noise."""
COMPANY, COMPANY_M = 3, 0.2
"""A moving point needs this many others nearby: a single one is noise."""
STOP_M = 0.35
"""Anything that moves within this distance of the footprint stops the robot, wherever it is going: at 0.3 m/s
it comes 0.2 m nearer before it is seen again and the robot has braked."""


class MovingWatch:
    """Stops the robot for moving obstacles nearby: a person can avoid a standing robot more easily.

    A point of the newest sweep is moving if a sweep a little older saw through its place.
    """

    def __init__(self, model: RobotModel) -> None:
        self.points_odom = np.zeros((0, 2))
        """Moving points of the newest sweep, (n, 2)."""
        self._zone = padded(model.footprint, STOP_M)
        self._profiles: deque[tuple[int, SE2, Array]] = deque(maxlen=16)

    def observe(self, sweep: DeskewedScan) -> None:
        """Add a sweep."""
        older = [p for p in self._profiles if sweep.stamp_ns - p[0] >= BEFORE_NS]
        self.points_odom = np.zeros((0, 2))
        if older and sweep.stamp_ns - older[-1][0] < 2 * BEFORE_NS:
            self.points_odom = moved_points(sweep, older[-1][1], older[-1][2])
        T = sweep.T_odom_lidar
        ends = T.inverse() @ np.concatenate([sweep.hits_odom, sweep.passes_odom])
        self._profiles.append((sweep.stamp_ns, T, profile(ends)))

    def stops(self, T_odom_base: SE2) -> bool:
        """Whether one of the points is that near."""
        return any(depth_inside(self._zone, x, y) > 0.0 for x, y in T_odom_base.inverse() @ self.points_odom)


def profile(ends_lidar: Array) -> Array:
    """Least range by bearing (BINS,), from the ends (n, 2) of a sweep's beams; 0 without a beam."""
    ranges = np.full(BINS, np.inf)
    if len(ends_lidar):
        bins = _bins(ends_lidar)
        np.minimum.at(ranges, bins, np.linalg.norm(ends_lidar, axis=1))
    ranges[np.isinf(ranges)] = 0.0
    dilated = [np.roll(ranges, k) for k in range(-NEIGHBOURS, NEIGHBOURS + 1)]
    return np.asarray(np.min(dilated, axis=0))


def moved_points(sweep: DeskewedScan, T_odom_lidar: SE2, ranges: Array) -> Array:
    """Hits (n, 2) where an older sweep, with that lidar pose and profile, saw farther."""
    hits = sweep.hits_odom
    if len(hits) == 0:
        return np.zeros((0, 2))
    then = T_odom_lidar.inverse() @ hits
    free = ranges[_bins(then)] > np.linalg.norm(then, axis=1) + SHIFT_M
    moved = np.ascontiguousarray(hits[free])
    return moved[in_company(moved, COMPANY, COMPANY_M)]


def _bins(points: Array) -> NDArray[np.int64]:
    bearing = np.arctan2(points[:, 1], points[:, 0])
    return np.asarray(np.floor((bearing / (2.0 * np.pi) + 0.5) * BINS), dtype=np.int64) % BINS


def in_company(points: Array, count: int, reach: float) -> NDArray[np.bool_]:
    """Which points (n, 2) have at least `count` others within reach, (n,) of bool."""
    near = scipy.spatial.cKDTree(points).query_ball_point(points, reach, return_length=True)
    return np.asarray(near > count)
