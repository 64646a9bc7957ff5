"""Whose command is executed: the driver's, or that of a person who takes over."""

from __future__ import annotations

from typing import Literal

from turtlebag.datasets.durations import seconds
from turtlebag.datasets.types import Observation, RobotModel, Twist
from turtlebag.pipeline.navigation.driver import Task
from turtlebag.pipeline.navigation.teleop_override import Interval, Source
from turtlebag.planners.control.collision_monitor import CollisionMonitor
from turtlebag.planners.control.controller import SpeedLimits, ramped
from turtlebag.sim.robots import PERIOD_S

Owner = Literal["navigation", "teleop"]


class CommandOwner:
    """Arbitrates between a driver and teleop: whose command is executed in each tick.

    `monitor` also limits teleop commands; without it a person can push obstacles.
    """

    def __init__(
        self, driver: Task, model: RobotModel, source: Source, monitor: CollisionMonitor | None
    ) -> None:
        self.driver = driver
        self.owner: Owner = "navigation"
        self.asked: list[Interval] = []
        """The overrides so far, as a script that repeats them."""
        self.command = Twist()
        """The command in the last tick."""
        self._source = source
        self._monitor = monitor
        self._limits = SpeedLimits.of(model, PERIOD_S)

    @property
    def state(self) -> str:
        """The driver's state, or `teleop`."""
        return self.driver.state if self.owner == "navigation" else "teleop"

    def step(self, observation: Observation) -> Twist:
        """The command of this tick's owner."""
        asked = self._source.asked(observation.stamp_ns)
        if asked is None:
            if self.owner == "teleop":
                self.driver.resume(self.command)
            self.owner = "navigation"
            self.command = self.driver.step(observation)
            return self.command
        self.owner = "teleop"
        self._note(observation.stamp_ns, asked)
        self.driver.stand_by(observation)
        self.command = self._allowed(asked, observation)
        return self.command

    def _allowed(self, asked: Twist, observation: Observation) -> Twist:
        """The teleop command within the robot's limits, reduced so as not to hit anything the lidar sees."""
        wanted = ramped(asked, self.command, self._limits)
        if self._monitor is None:
            return wanted
        points = self.driver.sensing.points_base(observation.odometry.T_odom_base)
        factor = self._monitor.limit(wanted, points)
        if factor >= 1.0:
            return wanted
        return ramped(Twist(wanted.v * factor, wanted.w * factor), self.command, self._limits)

    def _note(self, stamp_ns: int, asked: Twist) -> None:
        begin, end = round(seconds(stamp_ns), 9), round(seconds(stamp_ns) + PERIOD_S, 9)
        last = self.asked[-1] if self.asked else None
        if last is not None and (last.v, last.w) == (asked.v, asked.w) and begin - last.end < 0.5 * PERIOD_S:
            self.asked[-1] = last.model_copy(update={"end": end})
        else:
            self.asked.append(Interval(begin=begin, end=end, v=asked.v, w=asked.w))
