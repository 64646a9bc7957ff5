"""The collision monitor: whatever the command, the robot stops before obstacles that the lidar sees."""

from __future__ import annotations

import math

import numpy as np

from turtlebag.datasets.kernels import njit
from turtlebag.datasets.se2 import Array
from turtlebag.datasets.types import RobotModel, Twist
from turtlebag.planners.control.controller import ACCELERATION_SHARE
from turtlebag.planners.footprint import Field32, footprint_clearance, sample_footprint

PADDING_M = 0.02
"""The footprint is checked this much larger, at poses half as far apart along the way."""
REACTION_S = 0.1
"""Time at the commanded speed before braking is felt: three control periods."""


class CollisionMonitor:
    """Limits commands to those that can still be stopped in time.

    Two sources of evidence: the points of the last sweep, and (localised) a clearance field with the
    keep-out areas that no lidar sees.
    """

    def __init__(self, model: RobotModel) -> None:
        self._footprint = padded(model.footprint, PADDING_M)
        self._reach = model.circumscribed_radius + PADDING_M
        self._samples = sample_footprint(model)
        self._braking = ACCELERATION_SHARE * model.max_dv

    def limit(self, command: Twist, points_base: Array) -> float:
        """Factor 0..1 for the command, from points (n, 2) in the base frame now.

        A point already inside the padded footprint does not forbid motions that lead away from it.
        """
        v, w = command.v, command.w
        if (v == 0.0 and w == 0.0) or len(points_base) == 0:
            return 1.0
        speed = max(abs(v), abs(w) * self._reach)
        horizon = self._stopping_distance(speed) / speed
        free = free_time(
            np.ascontiguousarray(points_base),
            self._footprint,
            self._reach,
            v,
            w,
            horizon,
            0.5 * PADDING_M / speed,
        )
        if free >= horizon:
            return 1.0
        # The speed u from which it stops within the free way d: d = u t + u^2 / (2 b).
        b, t = self._braking, REACTION_S
        allowed = -b * t + math.sqrt(b * b * t * t + 2.0 * b * free * speed)
        return min(1.0, allowed / speed)

    def free_way(self, v: float, points_base: Array, most: float) -> float:
        """How far [m], up to `most`, straight driving at v is free of points (n, 2) in the base frame."""
        points, horizon = np.ascontiguousarray(points_base), most / abs(v)
        free = free_time(points, self._footprint, self._reach, v, 0.0, horizon, 0.5 * PADDING_M / abs(v))
        return abs(v) * free

    def _stopping_distance(self, speed: float) -> float:
        return speed * REACTION_S + 0.5 * speed * speed / self._braking

    def limit_on_map(
        self, command: Twist, field: Field32, resolution: float, x: float, y: float, yaw: float
    ) -> float:
        """The same against a clearance field, for a pose in its grid frame."""
        v, w = command.v, command.w
        speed = max(abs(v), abs(w) * self._reach)
        if speed == 0.0:
            return 1.0
        horizon = self._stopping_distance(speed) / speed
        here = footprint_clearance(field, resolution, self._samples, x, y, yaw)
        for part in (0.5, 1.0):
            t = part * horizon
            nx, ny, nyaw = moved(x, y, yaw, v, w, t)
            room = footprint_clearance(field, resolution, self._samples, nx, ny, nyaw)
            if room <= 0.0 and room < here:
                return 0.0
        return 1.0


def padded(polygon: Array, padding: float) -> Array:
    """A convex polygon with its edges moved outwards; corners (n, 2), counter-clockwise."""
    edge = np.roll(polygon, -1, axis=0) - polygon
    normal = np.stack([edge[:, 1], -edge[:, 0]], axis=1) / np.linalg.norm(edge, axis=1, keepdims=True)
    before = np.roll(normal, 1, axis=0)
    # Both edges at a corner move by the padding: solve n1.d = n2.d = padding.
    scale = padding / (1.0 + np.sum(normal * before, axis=1, keepdims=True))
    return np.asarray(polygon + scale * (normal + before), dtype=np.float64)


@njit(cache=True)
def moved(x: float, y: float, yaw: float, v: float, w: float, t: float) -> tuple[float, float, float]:
    """The pose after driving an arc for a time."""
    if abs(w) < 1e-6:
        return x + v * t * math.cos(yaw), y + v * t * math.sin(yaw), yaw + w * t
    r = v / w
    end = yaw + w * t
    return x + r * (math.sin(end) - math.sin(yaw)), y - r * (math.cos(end) - math.cos(yaw)), end


@njit(cache=True)
def depth_inside(polygon: Array, x: float, y: float) -> float:
    """How deep a point lies inside a convex polygon (n, 2), counter-clockwise; negative outside."""
    least = np.inf
    n = len(polygon)
    for k in range(n):
        ax, ay = polygon[k, 0], polygon[k, 1]
        ex, ey = polygon[(k + 1) % n, 0] - ax, polygon[(k + 1) % n, 1] - ay
        least = min(least, (ex * (y - ay) - ey * (x - ax)) / math.hypot(ex, ey))
    return least


@njit(cache=True)
def free_time(
    points: Array, polygon: Array, reach: float, v: float, w: float, horizon: float, dt: float
) -> float:
    """How long the polygon can follow the arc (v, w) before a point gets into it, at most `horizon` [s].

    Points inside already count only once they get deeper than they were.
    """
    near = np.empty(len(points), dtype=np.int64)
    start = np.empty(len(points))
    count = 0
    limit = reach + abs(v) * horizon
    for k in range(len(points)):
        if math.hypot(points[k, 0], points[k, 1]) <= limit:
            near[count] = k
            start[count] = depth_inside(polygon, points[k, 0], points[k, 1])
            count += 1
    if count == 0:
        return horizon
    steps = max(1, math.ceil(horizon / dt))
    for i in range(1, steps + 1):
        t = horizon * i / steps
        x, y, yaw = moved(0.0, 0.0, 0.0, v, w, t)
        c, s = math.cos(yaw), math.sin(yaw)
        for j in range(count):
            px, py = points[near[j], 0] - x, points[near[j], 1] - y
            depth = depth_inside(polygon, c * px + s * py, -s * px + c * py)
            if depth > 0.0 and depth > start[j] + 1e-4:
                return horizon * (i - 1) / steps
    return horizon
