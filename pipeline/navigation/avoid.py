"""The driver of the task `avoid`: no map, no goal, for a set time."""

from __future__ import annotations

import math
from collections.abc import Callable

from turtlebag.datasets.se2 import SE2
from turtlebag.datasets.types import Observation, RobotModel, Scan, Twist
from turtlebag.pipeline.navigation.guarded import Guard, View
from turtlebag.pipeline.navigation.sensing import Sensing
from turtlebag.planners.control.interface import SpeedLimits, ramped
from turtlebag.planners.tasks.avoid import (
    AvoidConfig,
    Decision,
    Sectors,
    decision_line,
    read_sectors,
    tutorial_rule,
)
from turtlebag.sim.simulator import CONTROL_HZ


class AvoidDriver:
    """Decides at every scan, and prints what it saw and decided."""

    def __init__(
        self,
        config: AvoidConfig,
        guard: Guard | None,
        model: RobotModel,
        sensing: Sensing,
        duration_s: float,
        say: Callable[[str], None],
    ) -> None:
        self.config = config
        self.guard = guard
        self.state = "wait"
        self.goal_index = -1
        self.finished = False
        self.estimate: SE2 | None = None
        self._limits = SpeedLimits.of(
            model, 1.0 / CONTROL_HZ, max_v=model.max_v, max_w=model.max_w, max_dv=model.max_dv
        )
        self.sensing = sensing
        self._duration_ns = round(duration_s * 1e9)
        self._say = say
        self._sectors = Sectors(math.inf, math.inf, math.inf)
        self._wanted = Twist()
        self._last = Twist()

    def step(self, observation: Observation) -> Twist:
        """The command of the newest scan; standing still before the first and at the end."""
        self.sensing.observe(observation)
        if observation.stamp_ns >= self._duration_ns:
            self.finished, self.state = True, "done"
            return Twist()
        if self.guard is None:
            if observation.scan is not None:
                self._decide(observation, observation.scan, None)
            return self._wanted
        return self._guarded(observation, self.guard)

    def stand_by(self, observation: Observation) -> None:
        """Look on while someone else drives; the time of the task goes on."""
        self.sensing.observe(observation)
        if observation.stamp_ns >= self._duration_ns:
            self.finished, self.state = True, "done"

    def resume(self, last: Twist) -> None:
        """Drive again, with nothing planned."""
        self._last, self._wanted = last, Twist()
        if self.guard is not None:
            self.guard.interrupted()

    def _guarded(self, observation: Observation, guard: Guard) -> Twist:
        sight = self.sensing.sight
        if sight is None:
            return Twist()
        if self.sensing.blind:
            self.state, self._wanted = "blind", Twist()
        view = View(
            observation.stamp_ns * 1e-9,
            observation.odometry.T_odom_base,
            sight.hits_odom,
            read_sectors(observation.scan) if observation.scan is not None else self._sectors,
        )
        if observation.scan is not None:
            self._sectors = view.sectors
            self._decide(observation, observation.scan, guard.decide(view, self._last))
        passed = guard.pass_on(self._wanted, view)
        self._last = ramped(passed, self._last, self._limits)
        return self._last

    def _decide(self, observation: Observation, scan: Scan, decision: Decision | None) -> None:
        sectors = read_sectors(scan)
        decision = decision or tutorial_rule(sectors, self.config)
        self._say(decision_line(observation.stamp_ns * 1e-9, sectors, decision))
        self.state, self._wanted = decision.action.replace(",", "").replace(" ", "_"), decision.command
