"""The robot's memory of obstacles beside the newest sweep: what moves, and what no lidar sees.

Sweeps are compared with earlier ones. A point where an earlier sweep saw farther has moved there; a sweep
that looks like the earlier one, though the wheels have turned, says that something holds the robot.
"""

from __future__ import annotations

import math
from collections import deque

import numpy as np
import scipy
from numpy.typing import NDArray

from turtlebag.datasets.se2 import SE2, Array
from turtlebag.datasets.types import RobotModel
from turtlebag.pipeline.navigation.sensing import DeskewedScan
from turtlebag.planners.control.collision_monitor import depth_inside, padded
from turtlebag.planners.costmap import Costmap

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
TRAVEL_M, TURN_RAD, LEAST_POINTS = 0.1, 0.6, 30
"""Wheels are checked once odometry has gone so far; after so much of a turn the next check is begun (without
that, one of three drives with bumps sees half the floor). Fewer points say nothing."""
STILL_RATIO = 0.5
"""Standing still must explain the sweep by this factor better than odometry does (not measured)."""
BEYOND_M, SPACING_M = 0.05, 0.02
"""So far beyond the leading edge the thing is taken to stand, with points so far apart (not measured)."""
MEMORY_NS = 600 * 10**9
"""It is kept out of for so long: then odometry has drifted, and the thing may have been moved."""


class ObstacleMemory:
    """One for each driver. Bumps are in the frame that the driver plans in, odometry's or the map's."""

    def __init__(self, model: RobotModel) -> None:
        self.moving_odom = np.zeros((0, 2))
        """Points of the newest sweep of each lidar that are moving, (n, 2)."""
        self._moving: dict[int, Array] = {}
        self._footprint, self._zone = model.footprint, padded(model.footprint, STOP_M)
        self._sweeps: deque[DeskewedScan] = deque(maxlen=16)
        # the lidar, T_odom_base, and hits from there (n, 2)
        self._reference: tuple[int, SE2, Array] | None = None
        self._bumps: list[tuple[int, Array]] = []

    def observe(self, sweep: DeskewedScan) -> None:
        """Find what moves in a new sweep, by one a little older."""
        older = [
            s for s in self._sweeps if s.sensor == sweep.sensor and sweep.stamp_ns - s.stamp_ns >= BEFORE_NS
        ]
        self._moving[sweep.sensor] = np.zeros((0, 2))
        if older and sweep.stamp_ns - older[-1].stamp_ns < 2 * BEFORE_NS:
            self._moving[sweep.sensor] = moved_points(sweep, older[-1])
        self.moving_odom = np.concatenate([*self._moving.values()])
        self._sweeps.append(sweep)

    def stops(self, T_odom_base: SE2) -> bool:
        """Whether something that moves is too near: a person can avoid a standing robot more easily."""
        if len(self.moving_odom) == 0:
            return False
        return any(depth_inside(self._zone, x, y) > 0.0 for x, y in T_odom_base.inverse() @ self.moving_odom)

    def bumped(self, sweep: DeskewedScan, T_odom_base: SE2, v: float, T_frame_odom: SE2) -> bool:
        """Whether a new sweep shows that the robot, commanded `v` [m/s], pushes against something.

        That is remembered, before its leading edge.
        """
        if not self._slipping(sweep.sensor, T_odom_base, T_odom_base.inverse() @ sweep.hits_odom):
            return False
        xs, ys = self._footprint.T
        edge = xs.min() - BEYOND_M if v < 0.0 else xs.max() + BEYOND_M
        across = np.arange(ys.min(), ys.max() + SPACING_M, SPACING_M)
        line = np.stack([np.full(len(across), edge), across], axis=1)
        self._bumps.append((sweep.stamp_ns, T_frame_odom @ (T_odom_base @ line)))
        return True

    def begin_again(self) -> None:
        """Compare wheels and sweeps from the next one on; bumps are remembered."""
        self._reference = None

    def bumps(self, now_ns: int) -> Array:
        """Points (n, 2) of the bumps that still count."""
        self._bumps = [(t, line) for t, line in self._bumps if now_ns - t < MEMORY_NS]
        return np.concatenate([np.zeros((0, 2)), *(line for _, line in self._bumps)])

    def kept_out(self, costmap: Costmap, now_ns: int) -> Costmap:
        """The costmap, in the same frame, with the bumps as lethal."""
        points = self.bumps(now_ns)
        lethal = np.zeros_like(costmap.lethal)
        cells = np.floor((costmap.T_grid_map @ points) / costmap.resolution).astype(int)
        inside = np.all((cells >= 0) & (cells < lethal.shape[::-1]), axis=1)
        lethal[cells[inside, 1], cells[inside, 0]] = True
        return costmap.with_lethal(lethal) if inside.any() else costmap

    def _slipping(self, sensor: int, T_odom_base: SE2, points: Array) -> bool:
        """Whether a lidar's hits (n, 2) from the base fit its reference better without the odometry's
        motion."""
        if self._reference is None or min(len(points), len(self._reference[2])) < LEAST_POINTS:
            self._reference = sensor, T_odom_base, points
            return False
        of, before, earlier = self._reference
        if sensor != of:
            return False
        x, y, yaw = (before.inverse() @ T_odom_base).xyt.tolist()
        travelled = math.hypot(x, y) >= TRAVEL_M
        if travelled or abs(yaw) > TURN_RAD:
            self._reference = sensor, T_odom_base, points
        if not travelled:
            return False
        tree = scipy.spatial.cKDTree(earlier)
        still, moved = (misfit(tree, SE2.from_xyt(f * x, f * y, yaw) @ points) for f in (0.0, 1.0))
        return min(still, misfit(tree, points)) < STILL_RATIO * moved


def misfit(tree: scipy.spatial.cKDTree, points: Array) -> float:
    """Mean distance of points to their nearest neighbours, cut at twice the way between two sweeps."""
    distance, _ = tree.query(points, distance_upper_bound=2.0 * TRAVEL_M)
    return float(np.minimum(distance, 2.0 * TRAVEL_M).mean())


def moved_points(sweep: DeskewedScan, earlier: DeskewedScan) -> Array:
    """Hits (n, 2) where an earlier sweep saw farther."""
    hits, T_lidar_odom = sweep.hits_odom, earlier.T_odom_lidar.inverse()
    if len(hits) == 0:
        return np.zeros((0, 2))
    ranges = profile(T_lidar_odom @ np.concatenate([earlier.hits_odom, earlier.passes_odom]))
    then = T_lidar_odom @ hits
    free = ranges[_bins(then)] > np.linalg.norm(then, axis=1) + SHIFT_M
    moved = np.ascontiguousarray(hits[free])
    return moved[in_company(moved, COMPANY, COMPANY_M)]


def profile(ends_lidar: Array) -> Array:
    """Least range by bearing (BINS,), from the ends (n, 2) of a sweep's beams; 0 without a beam."""
    ranges = np.full(BINS, np.inf)
    if len(ends_lidar):
        bins = _bins(ends_lidar)
        np.minimum.at(ranges, bins, np.linalg.norm(ends_lidar, axis=1))
    ranges[np.isinf(ranges)] = 0.0
    return np.asarray(scipy.ndimage.minimum_filter1d(ranges, 2 * NEIGHBOURS + 1, mode="wrap"))


def _bins(points: Array) -> NDArray[np.int64]:
    bearing = np.arctan2(points[:, 1], points[:, 0])
    return np.asarray(np.floor((bearing / (2.0 * np.pi) + 0.5) * BINS), dtype=np.int64) % BINS


def in_company(points: Array, count: int, reach: float) -> NDArray[np.bool_]:
    """Which points (n, 2) have at least `count` others within reach, (n,) of bool."""
    near = scipy.spatial.cKDTree(points).query_ball_point(points, reach, return_length=True)
    return np.asarray(near > count)
