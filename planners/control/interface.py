"""What every local controller is: a follower of a path that turns poses into commands."""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from typing import Protocol

from turtlebag.datasets.parts import Answer
from turtlebag.datasets.se2 import SE2
from turtlebag.datasets.types import RobotModel, Twist
from turtlebag.planners.costmap import Costmap

ACCELERATION_SHARE = 0.8
"""Part of the robot's own acceleration that is asked for, and of its braking that is counted on."""


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

    It is asked once a control period while a path is followed. What it says passes the collision monitor,
    which may slow it down: `last` tells what became of it.
    """

    state: str
    """One word on what it is doing, for the log."""

    def __init__(self, model: RobotModel, period: float) -> None:
        """Drive such a robot, with a command every `period` [s]."""
        ...

    def set_path(self, poses: SE2) -> None:
        """Follow a new path, (n,) poses; the last one is the goal."""
        ...

    def command(self, pose: SE2, last: Twist, costmap: Costmap) -> Twist:
        """The next command, from the pose now, the command before, and what is in the way."""
        ...

    def ramp(self, target: Twist, last: Twist) -> Twist:
        """As near to a target as the acceleration limits allow in one period."""
        ...

    def brake(self, last: Twist) -> Twist:
        """The next command on the way to a standstill."""
        ...


def ramped(target: Twist, last: Twist, limits: SpeedLimits) -> Twist:
    """The target, as far as the acceleration limits let the last command change in one period.

    While the speed ramps, the rotation keeps the target's curvature.
    """
    dv, dw = limits.max_dv * limits.period, limits.max_dw * limits.period
    v = min(max(target.v, last.v - dv), last.v + dv)
    v = min(max(v, -limits.max_v), limits.max_v)
    wanted_w = target.w
    if target.v * v > 0.0:
        wanted_w = target.w * min(1.0, v / target.v)
    w = min(max(wanted_w, last.w - dw), last.w + dw)
    return Twist(v, min(max(w, -limits.max_w), limits.max_w))


class Ramped:
    """What controllers share: the robot's limits, narrowed by their configuration, on every command.

    `acceleration_share` is the part of the robot's own acceleration for driving; braking may use all.
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
        """As near to a target as the acceleration limits allow in one period."""
        return ramped(target, last, self.limits)

    def brake(self, last: Twist) -> Twist:
        """The next command on the way to a standstill, as hard as the robot itself may brake."""
        return ramped(Twist(), last, self.hardest)


def require_twist(part: object, method: str, command: object) -> None:
    """InputError unless a method has returned a command: `v` [m/s] and `w` [rad/s], finite."""
    answer = Answer(part, method)
    answer.require_a(Twist, command)
    assert isinstance(command, Twist)
    answer.require_finite("v", command.v)
    answer.require_finite("w", command.w)
