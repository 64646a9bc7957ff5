"""The hands of the simulated person: straight lines and turns on the spot, as generators of commands.

Each action is sent the truth after every step and returns the last one it saw.
"""

from __future__ import annotations

import math
from collections.abc import Generator

from datasets.se2 import Array
from datasets.types import Twist
from sim.simulator import Truth

Action = Generator[Twist, Truth, Truth]

BRAKING = 0.4
"""Deceleration that the driver plans with [m/s^2]."""
TURN_BRAKING = 1.5
"""The same for turning [rad/s^2]."""
STEERING = 2.0
"""Yaw rate per heading error while driving straight [1/s]."""
NEAR_M, NEAR_RAD = 0.004, 0.01
CREEP_V, CREEP_W = 0.02, 0.06
PATIENCE_STEPS = 300
"""Without getting nearer to its aim for so long, an action gives up."""


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
            left, yaw = left - _wrapped(now - yaw), now
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
            truth = yield from self.turn(truth, _wrapped(math.atan2(y - py, x - px) - yaw))
            truth = yield from self._straight(truth, (x, y), 1.0)
        return truth

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
            wanted = _wrapped(facing + direction * math.atan2(off, 0.3) - yaw)
            speed = min(self._v, max(CREEP_V, math.sqrt(2.0 * BRAKING * left)))
            rate = max(-self._w, min(self._w, STEERING * wanted))
            truth = yield Twist(direction * speed, rate)
        return (yield from self._stand(truth))

    def _stand(self, truth: Truth) -> Action:
        """Let go until the robot stands."""
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


def _wrapped(angle: float) -> float:
    return (angle + math.pi) % (2.0 * math.pi) - math.pi
