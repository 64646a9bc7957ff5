"""What drives the robot in a run: sees observations, returns commands."""

from __future__ import annotations

from typing import Protocol

from turtlebag.datasets.se2 import SE2
from turtlebag.datasets.types import Observation, Twist
from turtlebag.pipeline.navigation.sensing import Sensing


class Driver(Protocol):
    """A task in closed loop. It never sees the truth."""

    state: str
    """One word on what it is doing, for the run log."""
    goal_index: int
    """Which goal it pursues, -1 for none."""
    finished: bool
    """Whether the task is over."""
    estimate: SE2 | None
    """Where it takes itself to be in the map; None when it does not know, or needs no map."""

    sensing: Sensing
    """What it has seen of odometry and sweeps."""

    def step(self, observation: Observation) -> Twist:
        """The command for the next control period."""
        ...

    def stand_by(self, observation: Observation) -> None:
        """Take in an observation of a tick in which someone else drives; goals wait meanwhile."""
        ...

    def resume(self, last: Twist) -> None:
        """Drive again from the next step on, after the command that someone else gave last."""
        ...
