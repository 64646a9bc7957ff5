"""Actions of the teleop scripts' driver: straight lines and turns on the spot, as generators of commands.

Each action is sent the true state after every step and returns the last one it saw.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Generator

import numpy as np

from turtlebag.datasets.se2 import Array, wrapped
from turtlebag.datasets.types import Twist
from turtlebag.sim.simulator import Truth

Action = Generator[Twist, Truth, Truth]

BRAKING = 0.4
"""Deceleration that the driver plans with [m/s^2]."""
TURN_BRAKING = 1.5
"""The same for turning [rad/s^2]."""
STEERING = 2.0
"""Yaw rate per heading error while driving straight [1/s]."""
NEAR_M, NEAR_RAD = 0.004, 0.01
CREEP_V, CREEP_W = 0.02, 0.06
LOOK_AHEAD_M, ARRIVED_M, RESAMPLED_M = 0.2, 0.05, 0.02
WEAVE_STEPS = 90
"""Control steps of one swing to and fro."""
PATIENCE_STEPS = 300
"""Time without progress after which an action gives up."""


class Stuck(Exception):
    """The robot does not go where the driver steers it."""


class Driver:
    """Drives at cruise speeds v [m/s] and w [rad/s]."""

    def __init__(self, v: float, w: float) -> None:
        self._v, self._w = v, w

    def wait(self, truth: Truth, steps: int) -> Action:
        """Stand still for a number of control steps."""
        for _ in range(steps):
            truth = yield Twist()
        return truth

    def turn(self, truth: Truth, angle: float) -> Action:
        """Turn on the spot by an angle [rad] of any size, then stand."""
        left, yaw = angle, float(truth.T_world_base.yaw)
        patience = _Patience(0.05)
        while abs(left) > NEAR_RAD:
            patience.check(abs(left), truth)
            rate = min(self._w, max(CREEP_W, math.sqrt(2.0 * TURN_BRAKING * abs(left))))
            truth = yield Twist(0.0, math.copysign(rate, left))
            now = float(truth.T_world_base.yaw)
            left, yaw = left - wrapped(now - yaw), now
        return (yield from self._stand(truth))

    def drive(self, truth: Truth, distance: float) -> Action:
        """Drive straight by a distance [m] along the present heading (negative: backwards), then stand."""
        x, y, yaw = (float(value) for value in truth.T_world_base.xyt)
        target = (x + distance * math.cos(yaw), y + distance * math.sin(yaw))
        return (yield from self._straight(truth, target, math.copysign(1.0, distance)))

    def through(self, truth: Truth, points: Array) -> Action:
        """Drive through world points (n, 2): turn on the spot to face each, then straight to it."""
        for x, y in points.tolist():
            px, py, yaw = (float(value) for value in truth.T_world_base.xyt)
            if math.hypot(x - px, y - py) < 2.0 * NEAR_M:
                continue
            truth = yield from self.turn(truth, wrapped(math.atan2(y - py, x - px) - yaw))
            truth = yield from self._straight(truth, (x, y), 1.0)
        return truth

    def flow(self, truth: Truth, points: Array, weave: float = 0.0) -> Action:
        """Drive along world points (n, 2) without stopping, by pure pursuit; then stand.

        `weave` [rad] swings the heading to and fro all the while: what mapping guides warn of.
        """
        line = _resampled(np.vstack([truth.T_world_base.xy, points]))
        at, steps = 0, 0
        patience = _Patience(0.02)
        while True:
            x, y, yaw = truth.T_world_base.xyt.tolist()
            while at < len(line) - 1 and math.hypot(line[at, 0] - x, line[at, 1] - y) < LOOK_AHEAD_M:
                at += 1
            left = math.hypot(line[at, 0] - x, line[at, 1] - y)
            if at == len(line) - 1 and left < ARRIVED_M:
                break
            patience.check(left + (len(line) - at) * RESAMPLED_M, truth)
            swing = weave * min(left / LOOK_AHEAD_M, 1.0) * math.sin(2.0 * math.pi * steps / WEAVE_STEPS)
            aim = math.atan2(line[at, 1] - y, line[at, 0] - x)
            truth = yield self._toward(wrapped(aim + swing - yaw))
            steps += 1
        return (yield from self._stand(truth))

    def circle(self, truth: Truth, radius: float) -> Action:
        """Once round on a circle to the left that comes back to this place, driving and turning at once."""
        speed = min(self._v, self._w * radius)
        left, yaw = 2.0 * math.pi, float(truth.T_world_base.yaw)
        patience = _Patience(0.05)
        while left > NEAR_RAD:
            patience.check(left, truth)
            truth = yield Twist(speed, speed / radius)
            now = float(truth.T_world_base.yaw)
            left, yaw = left - wrapped(now - yaw), now
        return truth

    def follow_wall(
        self, truth: Truth, room: Callable[[float, float], float], aside: float, steps: int
    ) -> Action:
        """Keep the wall to the right at a distance `aside` [m] of the base, for a number of steps.

        `room(x, y)` is the distance to the nearest obstacle: the driver keeps to its level line.
        """
        for _ in range(steps):
            x, y, yaw = truth.T_world_base.xyt.tolist()
            x, y = x + 0.05 * math.cos(yaw), y + 0.05 * math.sin(yaw)
            away_x, away_y = room(x + 0.01, y) - room(x - 0.01, y), room(x, y + 0.01) - room(x, y - 0.01)
            along = math.atan2(-away_x, away_y)
            back = math.atan(3.0 * (room(x, y) - aside))
            truth = yield self._toward(wrapped(along - back - yaw))
        return (yield from self._stand(truth))

    def _toward(self, error: float) -> Twist:
        """Forward while turning by a heading error [rad], the slower the larger it is."""
        slow = max(math.cos(error), 0.0) ** 2
        return Twist(self._v * slow, max(-self._w, min(self._w, 2.0 * STEERING * error)))

    def _straight(self, truth: Truth, target: tuple[float, float], direction: float) -> Action:
        start = truth.T_world_base.xyt.tolist()
        line = math.atan2(target[1] - start[1], target[0] - start[0])
        patience = _Patience(0.02)
        while True:
            x, y, yaw = truth.T_world_base.xyt.tolist()
            dx, dy = target[0] - x, target[1] - y
            # Distance left along the line, and how far the line lies to the left.
            left = dx * math.cos(line) + dy * math.sin(line)
            if left < NEAR_M:
                break
            patience.check(left, truth)
            off = -dx * math.sin(line) + dy * math.cos(line)
            facing = line if direction > 0.0 else line + math.pi
            wanted = wrapped(facing + direction * math.atan2(off, 0.3) - yaw)
            speed = min(self._v, max(CREEP_V, math.sqrt(2.0 * BRAKING * left)))
            rate = max(-self._w, min(self._w, STEERING * wanted))
            truth = yield Twist(direction * speed, rate)
        return (yield from self._stand(truth))

    def _stand(self, truth: Truth) -> Action:
        """Command zero until the robot stands still."""
        for _ in range(30):
            truth = yield Twist()
            if abs(truth.twist.v) < 0.002 and abs(truth.twist.w) < 0.005:
                break
        return truth


class _Patience:
    """Raises Stuck when what is left has not shrunk by `progress` for a while."""

    def __init__(self, progress: float) -> None:
        self._progress, self._best, self._steps = progress, math.inf, 0

    def check(self, left: float, truth: Truth) -> None:
        if left < self._best - self._progress:
            self._best, self._steps = left, 0
        self._steps += 1
        if self._steps > PATIENCE_STEPS:
            x, y, _ = truth.T_world_base.xyt.tolist()
            raise Stuck(f"the robot is stuck at {x:.2f}, {y:.2f}")


def _resampled(points: Array) -> Array:
    """Points along a polyline (n, 2), RESAMPLED_M apart."""
    lengths = np.concatenate([[0.0], np.cumsum(np.linalg.norm(np.diff(points, axis=0), axis=1))])
    at = np.append(np.arange(0.0, lengths[-1], RESAMPLED_M), lengths[-1])
    return np.stack([np.interp(at, lengths, points[:, axis]) for axis in (0, 1)], axis=-1)
