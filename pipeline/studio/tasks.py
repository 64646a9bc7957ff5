"""What a robot can be told to do: a driver each, with what is said of it."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass
from typing import Literal

import numpy as np

from turtlebag.datasets.types import Observation, Twist
from turtlebag.pipeline.localisation.amcl import Amcl
from turtlebag.pipeline.navigation.avoid import AvoidDriver
from turtlebag.pipeline.navigation.driver import Driver
from turtlebag.pipeline.navigation.drivers import Kit
from turtlebag.pipeline.navigation.explore import ExploreDriver
from turtlebag.pipeline.navigation.localiser import Localiser
from turtlebag.pipeline.navigation.setup import MAX_SIMULATED_S
from turtlebag.planners.control.interface import SpeedLimits, ramped
from turtlebag.planners.control.monitor import CollisionMonitor
from turtlebag.planners.tasks.avoid import in_words
from turtlebag.planners.tasks.sequence import GoalSequence
from turtlebag.planners.tasks.wiggle import Wiggle
from turtlebag.sim.robots import PERIOD_S

Kind = Literal["goal", "patrol", "avoid", "explore", "wiggle"]


@dataclass(frozen=True, eq=False)
class Task:
    """A driver at work since `begin_ns`; goals, for those that have some."""

    kind: Kind
    begin_ns: int
    driver: Driver
    sequence: GoalSequence | None = None
    on_map: bool = False
    """Whether it needs the map that is loaded."""

    @property
    def end_ns(self) -> int:
        """When it is broken off at the latest."""
        return self.begin_ns + round(MAX_SIMULATED_S * 1e9)

    @property
    def decision(self) -> str:
        """What was decided by the three sectors, for the task that goes by them."""
        return in_words(self.driver.state) if isinstance(self.driver, AvoidDriver) else ""

    @property
    def explorer(self) -> ExploreDriver | None:
        """The driver that maps by itself, if it is one."""
        return self.driver if isinstance(self.driver, ExploreDriver) else None


class WiggleDriver(Driver):
    """Turns to and fro, as far as there is room; it only watches the localiser, which others feed."""

    def __init__(self, kit: Kit, localiser: Localiser) -> None:
        super().__init__(kit.sensing)
        model = kit.robot.model
        self._localiser = localiser
        self._wiggle = Wiggle()
        self._monitor = CollisionMonitor(model)
        self._limits = SpeedLimits.of(model, PERIOD_S)

    @property
    def convergence(self) -> str:
        """How narrow the cloud is, for people."""
        amcl = self._localiser.amcl
        assert isinstance(amcl, Amcl)
        if not amcl.watch.updates:
            return "no scan has been used yet"
        std = np.sqrt(np.diag(amcl.covariance))
        verdict = "have converged" if amcl.converged else "have not converged yet"
        return f"particles {verdict}: {100.0 * std[:2].max():.0f} cm, {math.degrees(std[2]):.0f} degrees"

    def step(self, observation: Observation) -> Twist:
        """The turn of this tick; it has finished when the robot stands."""
        turn = self._wiggle.command(observation.stamp_ns, self._localiser.amcl.converged)
        self.state = "wiggle" if turn is not None else "done"
        wanted = Twist()
        if turn is not None:
            points = self.sensing.points_base(observation.odometry.T_odom_base)
            wanted = Twist(0.0, turn.w * self._monitor.limit(turn, points))
        self._last = ramped(wanted, self._last, self._limits)
        self.finished = turn is None and abs(self._last.w) < 1e-3
        return self._last

    def stand_by(self, observation: Observation) -> None:
        """Nothing to keep up with."""


def changes_only(say: Callable[[str], None]) -> Callable[[str], None]:
    """Passes a decision on when its words, which stand after the numbers, are others than the last one's."""
    last = ""

    def told(line: str) -> None:
        nonlocal last
        words = line.rpartition("  ")[2]
        if words != last:
            last = words
            say(line.strip())

    return told
