"""The contract of a local controller: it follows a path, pose in, command out."""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from typing import Protocol

from turtlebag.datasets.se2 import SE2
from turtlebag.datasets.types import RobotModel, Twist
from turtlebag.planners.costmap import Costmap

ACCELERATION_SHARE = 0.8
"""Share of the robot's acceleration that is commanded, and of its braking that is relied on."""


@dataclass(frozen=True)
class SpeedLimits:
    """Limits that a command must obey: speeds [m/s, rad/s], changes [m/s^2, rad/s^2], period [s]."""

    max_v: float
    max_w: float
    max_dv: float
    max_dw: float
    period: float

    @staticmethod
    def of(
        model: RobotModel,
        period: float,
        *,
        max_v: float = math.inf,
        max_w: float = math.inf,
        max_dv: float = math.inf,
    ) -> SpeedLimits:
        """The robot's own limits, or narrower ones."""
        return SpeedLimits(
            min(model.max_v, max_v), min(model.max_w, max_w), min(model.max_dv, max_dv), model.max_dw, period
        )


class Controller(Protocol):
    """A local controller; poses are in the frame of its path (map, or odom for mapless goals).

    It is called once per control period while a path is followed. Its command passes the collision monitor,
    which may reduce it: `last` is the command that was executed.
    """

    state: str
    """What it is doing, in one word, for the log."""

    def __init__(self, model: RobotModel, period: float) -> None:
        """For this robot, with one command per `period` [s]."""
        ...

    def set_path(self, poses: SE2) -> None:
        """Follow a new path, (n,) poses; the last one is the goal."""
        ...

    def command(self, pose: SE2, last: Twist, costmap: Costmap) -> Twist:
        """The next command, from the current pose, the last command and the obstacles."""
        ...

    def ramp(self, target: Twist, last: Twist) -> Twist:
        """The command closest to a target within the acceleration limits of one period."""
        ...

    def brake(self, last: Twist) -> Twist:
        """The next command when braking to a standstill."""
        ...


def ramped(target: Twist, last: Twist, limits: SpeedLimits) -> Twist:
    """The command closest to the target within the acceleration limits of one period.

    While the speed ramps, the rotation keeps the target's curvature; a robot that brakes keeps to its arc,
    along which it was known to be able to stop.
    """
    dv, dw = limits.max_dv * limits.period, limits.max_dw * limits.period
    v = min(max(target.v, last.v - dv), last.v + dv)
    v = min(max(v, -limits.max_v), limits.max_v)
    wanted_w = target.w
    if target.v * v > 0.0:
        wanted_w = target.w * min(1.0, v / target.v)
    elif target == Twist() and last.v != 0.0:
        wanted_w = last.w * v / last.v
    w = min(max(wanted_w, last.w - dw), last.w + dw)
    return Twist(v, min(max(w, -limits.max_w), limits.max_w))


def slowed(controller: Controller, wanted: Twist, factor: float, last: Twist) -> Twist:
    """The next command towards `factor` (0 to 1) of a wanted one, on its arc while the robot is still faster:
    what lies on that arc is what made it slow down."""
    slower = controller.ramp(Twist(wanted.v * factor, wanted.w * factor), last)
    if wanted.v == 0.0:
        return slower
    return controller.ramp(Twist(slower.v, wanted.w * slower.v / wanted.v), last)


class Ramped:
    """Base of controllers: applies the robot's limits, or narrower configured ones, to every command.

    `acceleration_share` is the share of the robot's acceleration used for driving; braking may use all.
    """

    def __init__(
        self,
        model: RobotModel,
        period: float,
        *,
        max_v: float = math.inf,
        max_w: float = math.inf,
        acceleration_share: float = ACCELERATION_SHARE,
    ) -> None:
        self.limits = SpeedLimits.of(
            model, period, max_v=max_v, max_w=max_w, max_dv=acceleration_share * model.max_dv
        )
        self.hardest = replace(self.limits, max_dv=model.max_dv)

    def ramp(self, target: Twist, last: Twist) -> Twist:
        """The command closest to a target within the acceleration limits of one period."""
        return ramped(target, last, self.limits)

    def brake(self, last: Twist) -> Twist:
        """The next command when braking to a standstill, as hard as the robot can."""
        return ramped(Twist(), last, self.hardest)
