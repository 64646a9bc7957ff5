"""Bump memory: obstacles that the lidar cannot see, noticed when wheels turn but scans do not change."""

from __future__ import annotations

import math

import numpy as np
import scipy

from turtlebag.datasets.se2 import SE2, Array
from turtlebag.datasets.types import RobotModel, Twist
from turtlebag.pipeline.navigation.sensing import DeskewedScan
from turtlebag.planners.costmap import Costmap
from turtlebag.planners.tasks.recovery import Move
from turtlebag.planners.tasks.sector_rule import SLOW_V, TURN_W

# Sweeps are compared once odometry has gone so far; after so much of a turn the next is begun with (without
# that, one of three drives with bumps sees half the floor). Fewer points say nothing.
TRAVEL_M, TURN_RAD, LEAST_POINTS = 0.1, 0.6, 30
# Standing still must explain the sweep by this factor better than odometry does (not measured).
STILL_RATIO = 0.5
# So far beyond the leading edge the thing is taken to stand; points along it are so far apart (not measured).
BEYOND_M, SPACING_M = 0.05, 0.02
# It is kept out of for so long: then odometry has drifted, and the thing may have been moved.
MEMORY_NS = 600 * 10**9
# Backing off from it: how far, for how long at most, and how long with turning away. With a second more than
# either takes for the times, the worst of 12 drives touches 31 times for 17.
BACK_OFF_M, BACK_OFF_NS, ESCAPE_NS = 0.25, 4 * 10**9, 10 * 10**9


class SlipWatch:
    """Tells turning wheels from a moving robot by comparing sweeps."""

    def __init__(self) -> None:
        self._pose: SE2 | None = None
        self._points = np.zeros((0, 2))

    def reset(self) -> None:
        """Start from the next sweep."""
        self._pose = None

    def slipping(self, T_odom_base: SE2, hits_odom: Array) -> bool:
        """Whether the new sweep fits the remembered one better without the odometry's motion."""
        points = T_odom_base.inverse() @ hits_odom
        if self._pose is None or len(points) < LEAST_POINTS or len(self._points) < LEAST_POINTS:
            self._pose, self._points = T_odom_base, points
            return False
        x, y, yaw = (self._pose.inverse() @ T_odom_base).xyt.tolist()
        if math.hypot(x, y) < TRAVEL_M:
            if abs(yaw) > TURN_RAD:
                self._pose, self._points = T_odom_base, points
            return False
        tree = scipy.spatial.cKDTree(self._points)
        still = misfit(tree, SE2.from_xyt(0.0, 0.0, yaw) @ points)
        moved = misfit(tree, SE2.from_xyt(x, y, yaw) @ points)
        stood = misfit(tree, points)
        self._pose, self._points = T_odom_base, points
        return min(still, stood) < STILL_RATIO * moved


def misfit(tree: scipy.spatial.cKDTree, points: Array) -> float:
    """Mean distance of points to their nearest neighbours, cut at twice the way between two sweeps."""
    distance, _ = tree.query(points, distance_upper_bound=2.0 * TRAVEL_M)
    return float(np.minimum(distance, 2.0 * TRAVEL_M).mean())


class Escape:
    """Back off, then turn an angle [rad], or as much of both as a few seconds allow."""

    def __init__(self, now_ns: int, start: SE2, distance: float, angle: float) -> None:
        self._until_ns, self._angle = now_ns + ESCAPE_NS, angle
        back = Twist(math.copysign(SLOW_V, distance), 0.0)
        self._move = Move(start, back, abs(distance), now_ns + BACK_OFF_NS, "back off")

    def command(self, now_ns: int, T_odom_base: SE2) -> Twist | None:
        """The twist of this tick; None when it is over."""
        twist = self._move.command(now_ns, T_odom_base)
        if twist is None and self._move.twist.v:
            turn = Twist(0.0, math.copysign(TURN_W, self._angle))
            self._move = Move(T_odom_base, turn, abs(self._angle), self._until_ns, "turn away")
            twist = self._move.command(now_ns, T_odom_base)
        return twist


class BumpMemory:
    """Watches for slipping wheels; remembers what must have stopped them, in the frame of the poses given."""

    def __init__(self, model: RobotModel) -> None:
        self.escape: Escape | None = None
        """The way out of where it is, while it is on it."""
        self._footprint = model.footprint
        self._slip = SlipWatch()
        self._bumps: list[tuple[int, Array]] = []

    def interrupted(self) -> None:
        """What was being watched, and the escape, are over; places stay known."""
        self.escape = None
        self._slip.reset()

    def noticed(
        self, sweep: DeskewedScan, T_odom_base: SE2, last: Twist, turn: float, T_frame_odom: SE2
    ) -> bool:
        """Whether a new sweep shows that the robot pushes against something; that is remembered.

        An escape begins then: back, and away from it by `turn` [rad].
        """
        if self.escape is not None or not self._slip.slipping(T_odom_base, sweep.hits_odom):
            return False
        xs, ys = self._footprint.T
        edge = xs.min() - BEYOND_M if last.v < 0.0 else xs.max() + BEYOND_M
        across = np.arange(ys.min(), ys.max() + SPACING_M, SPACING_M)
        line = np.stack([np.full(len(across), edge), across], axis=1)
        self._bumps.append((sweep.stamp_ns, T_frame_odom @ (T_odom_base @ line)))
        back = BACK_OFF_M if last.v < 0.0 else -BACK_OFF_M
        self.escape = Escape(sweep.stamp_ns, T_odom_base, back, turn)
        return True

    def escaping(self, now_ns: int, T_odom_base: SE2) -> Twist | None:
        """The command of the escape; None when there is none, or when it is over."""
        command = None if self.escape is None else self.escape.command(now_ns, T_odom_base)
        if self.escape is not None and command is None:
            self.interrupted()
        return command

    def points(self, now_ns: int) -> Array:
        """Points (n, 2) of what is remembered still."""
        self._bumps = [(t, line) for t, line in self._bumps if now_ns - t < MEMORY_NS]
        return np.concatenate([np.zeros((0, 2)), *(line for _, line in self._bumps)])

    def kept_out(self, costmap: Costmap, now_ns: int) -> Costmap:
        """The costmap, in the same frame, with everything remembered as lethal."""
        points = self.points(now_ns)
        lethal = np.zeros_like(costmap.lethal)
        cells = np.floor((costmap.T_grid_map @ points) / costmap.resolution).astype(int)
        inside = np.all((cells >= 0) & (cells < lethal.shape[::-1]), axis=1)
        lethal[cells[inside, 1], cells[inside, 0]] = True
        return costmap.with_lethal(lethal) if inside.any() else costmap
