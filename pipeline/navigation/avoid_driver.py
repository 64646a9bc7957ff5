"""The driver of the task `avoid`: no map, no goal, for a set time."""

from __future__ import annotations

from collections.abc import Callable

from turtlebag.datasets.durations import nanoseconds, seconds
from turtlebag.datasets.types import Observation, RobotModel, Twist
from turtlebag.pipeline.navigation.driver import Driver
from turtlebag.pipeline.navigation.goal_states import State, Suspension
from turtlebag.pipeline.navigation.guarded_avoidance import GuardedAvoidance
from turtlebag.pipeline.navigation.obstacle_memory import ObstacleMemory
from turtlebag.pipeline.navigation.sensing import DeskewedScan, Sensing
from turtlebag.planners.control.controller import SpeedLimits, ramped
from turtlebag.planners.tasks.sector_rule import AvoidConfig, Decision, decision_line, tutorial_rule
from turtlebag.sim.robots import PERIOD_S


class AvoidDriver(Driver):
    """Decides at every scan, and reports the sectors when the decision changes."""

    def __init__(
        self,
        config: AvoidConfig,
        model: RobotModel,
        sensing: Sensing,
        duration_s: float,
        say: Callable[[str], None],
    ) -> None:
        super().__init__(sensing)
        guarded = config.mode == "guarded"
        self._avoidance = GuardedAvoidance(model, ObstacleMemory(model)) if guarded else None
        self._limits = SpeedLimits.of(model, PERIOD_S)
        self._duration_ns = nanoseconds(duration_s)
        self._say = say

    def step(self, observation: Observation) -> Twist:
        """The command of the newest scan; standing still before the first and at the end."""
        self.stand_by(observation)
        sweep, T_odom_base = self.sensing.sweep, observation.odometry.T_odom_base
        if self.finished or sweep is None:
            return Twist()
        if self._avoidance is None:
            if observation.scan is not None:
                decision = tutorial_rule(sweep.sectors)
                self._tell(observation, sweep, decision)
                self._last = decision.command
            return self._last
        new_sweep = observation.scan is not None
        if self.sensing.blind:
            self.state = Suspension.BLIND.value
            self._avoidance.interrupted()
        wanted = self._avoidance.command(sweep, T_odom_base, self._last, new_sweep=new_sweep)
        if new_sweep:
            self._tell(observation, sweep, self._avoidance.decision)
        self._last = ramped(wanted, self._last, self._limits)
        return self._last

    def stand_by(self, observation: Observation) -> None:
        """Keep sensing during a teleop override; the task's clock runs on."""
        self.sensing.observe(observation)
        if observation.stamp_ns >= self._duration_ns:
            self.finished, self.state = True, State.DONE.value

    def resume(self, last: Twist) -> None:
        """Drive again, with nothing planned."""
        self._last = Twist() if self._avoidance is None else last
        if self._avoidance is not None:
            self._avoidance.interrupted()

    def _tell(self, observation: Observation, sweep: DeskewedScan, decision: Decision) -> None:
        """Say what was seen when something else is decided than before."""
        before, self.state = self.state, decision.action.replace(",", "").replace(" ", "_")
        if self.state != before:
            self._say(decision_line(seconds(observation.stamp_ns), sweep.sectors, decision))
