"""The driver of the task `avoid`: no map, no goal, for a set time."""

from __future__ import annotations

from collections.abc import Callable

from datasets.se2 import SE2
from datasets.types import Observation, Twist
from planners.tasks.avoid import AvoidConfig, decision_line, read_sectors, tutorial_rule


class AvoidDriver:
    """Decides at every scan, and prints what it saw and decided."""

    def __init__(self, config: AvoidConfig, duration_s: float, say: Callable[[str], None]) -> None:
        self.config = config
        self.state = "wait"
        self.goal_index = -1
        self.finished = False
        self.estimate: SE2 | None = None
        self._duration_ns = round(duration_s * 1e9)
        self._say = say
        self._command = Twist()

    def step(self, observation: Observation) -> Twist:
        """The command of the newest scan; standing still before the first and at the end."""
        if observation.stamp_ns >= self._duration_ns:
            self.finished, self.state = True, "done"
            return Twist()
        if observation.scan is not None:
            sectors = read_sectors(observation.scan)
            decision = tutorial_rule(sectors, self.config)
            self._say(decision_line(observation.stamp_ns * 1e-9, sectors, decision))
            self.state, self._command = decision.action.split()[0].strip(","), decision.command
        return self._command
