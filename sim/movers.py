"""Moving obstacles: boxes and cylinders that follow a path or wander, at their own speed."""

from __future__ import annotations

import math
from collections.abc import Iterable
from dataclasses import dataclass

import numpy as np

from turtlebag.datasets.se2 import Array
from turtlebag.sim.nearby import Nearby
from turtlebag.sim.shapes import Sections, Solid, sections

WANDER_MARGIN_M = 0.15
YIELD_M = 0.25


@dataclass(frozen=True, eq=False)
class Mover:
    """A solid that moves without turning.

    `solid` stands at the origin of its own frame. It follows `path` (n, 2) to its end and back, or
    round and round with `loop`, or with `wander` roams inside `area` (x_min, x_max, y_min, y_max),
    starting at path[0] and turning away from what stands there. A mover that `yields` waits while
    the robot is in its way.
    """

    solid: Solid
    path: Array
    speed: float
    loop: bool = False
    wander: bool = False
    area: tuple[float, float, float, float] = (-math.inf, math.inf, -math.inf, math.inf)
    yields: bool = False

    @property
    def radius(self) -> float:
        """Of the circle about its origin that holds it [m]."""
        x_min, x_max, y_min, y_max = self.solid.bounds()
        return math.hypot(max(-x_min, x_max), max(-y_min, y_max))


class MovingSolid:
    """One mover under way; where it is depends on the seed, the steps taken and, if it yields, the robot."""

    def __init__(self, mover: Mover, standing: Nearby, robot_radius: float, rng: np.random.Generator) -> None:
        self.mover, self.standing, self._rng = mover, standing, rng
        self.outline = sections([mover.solid], mover.solid.z_min)
        """Where it would stand at the origin of its own frame."""
        self._reach = mover.radius + robot_radius + YIELD_M
        self.position = np.array(mover.path[0], dtype=np.float64)
        self.velocity = np.zeros(2)
        self._leg, self._direction = 0, 1
        self._heading = float(rng.uniform(-math.pi, math.pi)) if mover.wander else 0.0

    def step(self, dt: float, robot_xy: Array) -> None:
        """Move on for one control step."""
        before = self.position
        if not (self.mover.yields and self._in_the_way(robot_xy)):
            left = self.mover.speed * dt
            self.position = self._roam(left) if self.mover.wander else self._follow(left)
        self.velocity = (self.position - before) / dt

    def _in_the_way(self, robot_xy: Array) -> bool:
        offset = robot_xy - self.position
        ahead = self._ahead()
        return bool(np.hypot(*offset) < self._reach and offset @ ahead > 0.0)

    def _ahead(self) -> Array:
        if self.mover.wander:
            return np.array([math.cos(self._heading), math.sin(self._heading)])
        return self.mover.path[self._target()] - self.position

    def _target(self) -> int:
        n = len(self.mover.path)
        if self.mover.loop:
            return (self._leg + 1) % n
        return min(max(self._leg + self._direction, 0), n - 1)

    def _follow(self, left: float) -> Array:
        position = self.position
        for _ in range(2 * len(self.mover.path)):
            target = self.mover.path[self._target()]
            distance = float(np.linalg.norm(target - position))
            if distance > left:
                return position + (target - position) * (left / distance)
            position, left = np.array(target, dtype=np.float64), left - distance
            self._leg = self._target()
            if not self.mover.loop and self._leg in (0, len(self.mover.path) - 1):
                self._direction = 1 if self._leg == 0 else -1
        return position

    def _roam(self, left: float) -> Array:
        x_min, x_max, y_min, y_max = self.mover.area
        for _ in range(16):
            new = self.position + left * np.array([math.cos(self._heading), math.sin(self._heading)])
            inside = x_min <= new[0] <= x_max and y_min <= new[1] <= y_max
            if inside and self.standing.room(*new.tolist()) > self.mover.radius + WANDER_MARGIN_M:
                return new
            self._heading = float(self._rng.uniform(-math.pi, math.pi))
        return self.position


def outlines(moving: Iterable[MovingSolid]) -> Sections:
    """Outlines of all the given movers where they stand now."""
    return sum((one.outline.moved(one.position) for one in moving), sections([], 0.0))
