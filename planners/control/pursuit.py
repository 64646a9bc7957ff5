"""Regulated pure pursuit (Macenski et al. 2023): turn to the path, follow it, settle on the goal's pose."""

from __future__ import annotations

import math
from enum import StrEnum

import numpy as np

from turtlebag.datasets.se2 import SE2, wrapped
from turtlebag.datasets.types import RobotModel, Twist
from turtlebag.planners.control.along_path import arc_lengths, point_at, project
from turtlebag.planners.control.controller import Ramped, SpeedLimits, ramped
from turtlebag.planners.control.goal_checker import STOPPED_V, TOLERANCES
from turtlebag.planners.costmap import Costmap
from turtlebag.planners.footprint import footprint_clearance, sample_footprint

LOOKAHEAD_S, LOOKAHEAD_M = 1.3, (0.2, 0.6)
"""Lookahead time, and bounds of the lookahead distance. With a constant 0.3 m, a maze is passed at 2.7 cm
instead of 5."""
TURN_FIRST_RAD, TURNED_RAD = 0.75, 0.35
"""A bearing to the path, or the goal, larger than the first is reduced by turning on the spot until it is
below the second."""
NEAR_M, SLOWEST = 0.2, 0.35
"""With less clearance than this the robot slows down in proportion, at least to this share of the top speed.
Without it a maze is passed at 3.4 cm instead of 5."""
SETTLE_M = 0.12
"""Within this distance the robot steers for the goal itself."""
SETTLED = 0.012
"""Distance to the goal [m] at which the robot turns to the goal's yaw, and tolerance of that [rad]."""
RELEASE_M = TOLERANCES["default"][0]
"""If it drifts this far off while turning, it settles again."""
BRAKING = 0.6
"""Share of the commanded braking with which the end of the path is approached; with all, a jackal ends 1.6 cm
off."""
MAX_LATERAL = 1.2
"""Most lateral acceleration [m/s^2]."""
GAIN = 1.5
"""Gain of the approach to the goal on the remaining distance and angle, and twice that for turns on the spot
[1/s]: slower than any of the robots can brake."""


class Phase(StrEnum):
    """What the controller is doing; the words are in the run log."""

    IDLE = "idle"
    TURN = "turn"
    """Turning on the spot to the path."""
    FOLLOW = "follow"
    SETTLE = "settle"
    """Steering for the goal itself."""
    ALIGN = "align"
    """Turning to the goal's yaw."""
    ARRIVED = "arrived"


class Pursuit(Ramped):
    """A controller (see turtlebag.planners.control.controller)."""

    def __init__(self, model: RobotModel, period: float) -> None:
        super().__init__(model, period)
        self.samples = sample_footprint(model)
        self.state: str = Phase.IDLE
        self._points = np.zeros((0, 2))
        self._lengths = np.zeros(0)
        self._goal = (0.0, 0.0, 0.0)
        self._s = 0.0

    def set_path(self, poses: SE2) -> None:
        """Follow a new path; the robot's position on it is searched from its start."""
        self._points = np.ascontiguousarray(poses.xy)
        self._lengths = arc_lengths(self._points)
        x, y, yaw = poses.xyt[-1].tolist()
        same_goal = self._goal == (x, y, yaw)
        self._goal = (x, y, yaw)
        self._s = 0.0
        # A new path while driving: no stop, unless it leads elsewhere.
        if not (same_goal and self.state == Phase.FOLLOW):
            self.state = Phase.TURN

    def command(self, pose: SE2, last: Twist, costmap: Costmap) -> Twist:
        """The next command; rotation on the spot, pursuit, or settling, by the state."""
        if len(self._points) < 2:
            return ramped(Twist(), last, self.limits)
        x, y, yaw = pose.xyt.tolist()
        if self.state in (Phase.TURN, Phase.FOLLOW):
            target = self._along_path(x, y, yaw, last, costmap)
        else:
            target = self._onto_goal(x, y, yaw, last)
        return ramped(target, last, self.limits)

    def remaining(self) -> float:
        """Length of the path still ahead [m]."""
        return float(self._lengths[-1] - self._s) if len(self._lengths) else 0.0

    def _along_path(self, x: float, y: float, yaw: float, last: Twist, costmap: Costmap) -> Twist:
        least, most = LOOKAHEAD_M
        self._s, _ = project(self._points, self._lengths, x, y, self._s - least, self._s + 1.0)
        remaining = self.remaining()
        if remaining < SETTLE_M:
            self.state = Phase.SETTLE
            return self._onto_goal(x, y, yaw, last)
        room = self._room(x, y, yaw, costmap)
        # Near obstacles it must not cut corners.
        reach = min(max(abs(last.v) * LOOKAHEAD_S, least), most, least + 2.0 * max(room, 0.0))
        px, py = point_at(self._points, self._lengths, self._s + reach)
        bearing = wrapped(math.atan2(py - y, px - x) - yaw)
        if self.state == Phase.FOLLOW and abs(bearing) > TURN_FIRST_RAD:
            self.state = Phase.TURN
        if self.state == Phase.TURN:
            if abs(bearing) > TURNED_RAD:
                rolling = abs(last.v) > STOPPED_V
                return Twist(0.0, last.w * 0.5 if rolling else turning_speed(self.limits, bearing))
            self.state = Phase.FOLLOW
        distance = max(math.hypot(px - x, py - y), SETTLE_M)
        curvature = 2.0 * math.sin(bearing) / distance
        v = regulated_speed(self.limits, room, curvature, remaining)
        return Twist(v, curvature * v)

    def _room(self, x: float, y: float, yaw: float, costmap: Costmap) -> float:
        gx, gy, gyaw = grid_pose(costmap, x, y, yaw)
        return footprint_clearance(costmap.clearance, costmap.resolution, self.samples, gx, gy, gyaw)

    def _onto_goal(self, x: float, y: float, yaw: float, last: Twist) -> Twist:
        gx, gy, goal_yaw = self._goal
        distance = math.hypot(gx - x, gy - y)
        bearing = wrapped(math.atan2(gy - y, gx - x) - yaw)
        backwards = abs(bearing) > math.pi / 2.0
        if self.state == Phase.SETTLE:
            steer = wrapped(bearing + math.pi) if backwards else bearing
            ahead = distance * math.cos(steer)
            # Done if near enough, or at the closest point of this straight run.
            if distance < SETTLED or (distance < RELEASE_M * 0.8 and ahead < 0.003):
                self.state = Phase.ALIGN
            elif abs(steer) > TURNED_RAD and distance > SETTLED:
                return Twist(0.0, turning_speed(self.limits, steer))
            else:
                v = min(0.5 * self.limits.max_v, GAIN * distance)
                return Twist(-v if backwards else v, GAIN * steer)
        error = wrapped(goal_yaw - yaw)
        if distance > RELEASE_M and abs(last.v) <= STOPPED_V:
            self.state = Phase.SETTLE
            return Twist()
        self.state = Phase.ARRIVED if abs(error) < SETTLED else Phase.ALIGN
        return Twist(0.0, 0.0 if self.state == Phase.ARRIVED else turning_speed(self.limits, error))


def regulated_speed(limits: SpeedLimits, room: float, curvature: float, remaining: float) -> float:
    """The speed [m/s] that clearance `room` [m], curvature [1/m] and remaining path [m] allow."""
    bend = abs(curvature)
    v = limits.max_v * min(1.0, max(SLOWEST, room / NEAR_M))
    v = min(v, math.sqrt(2.0 * BRAKING * limits.max_dv * remaining))
    return min(v, math.sqrt(MAX_LATERAL / bend), limits.max_w / bend) if bend > 0.0 else v


def turning_speed(limits: SpeedLimits, error: float) -> float:
    """Speed of a turn on the spot [rad/s]: fast at a distance, and slow enough to stop at the goal."""
    return math.copysign(min(limits.max_w, 2.0 * GAIN * abs(error)), error)


def grid_pose(costmap: Costmap, x: float, y: float, yaw: float) -> tuple[float, float, float]:
    """A pose in the map frame as one in the frame of the grid."""
    tx, ty, tyaw = costmap.T_grid_map.xyt.tolist()
    cos, sin = math.cos(tyaw), math.sin(tyaw)
    return tx + cos * x - sin * y, ty + sin * x + cos * y, yaw + tyaw
