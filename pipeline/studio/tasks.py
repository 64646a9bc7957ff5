"""What a robot can be told to do: a driver each, with what is said of it."""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Literal

import numpy as np

from turtlebag.datasets.se2 import SE2
from turtlebag.datasets.types import Observation, Twist
from turtlebag.pipeline.localisation.amcl import Amcl
from turtlebag.pipeline.navigation.avoid import AvoidDriver
from turtlebag.pipeline.navigation.driver import Driver
from turtlebag.pipeline.navigation.drivers import Kit, make_avoider, make_explorer, make_mapless
from turtlebag.pipeline.navigation.explore import ExploreDriver
from turtlebag.pipeline.navigation.localiser import Localiser
from turtlebag.pipeline.navigation.navigator import NavigationDriver
from turtlebag.pipeline.navigation.online_map import OnlineMap
from turtlebag.pipeline.navigation.setup import DEFAULT_EXPLORE_S, MAX_SIMULATED_S, SINGLE_GOAL
from turtlebag.pipeline.studio.inputs import Pose, Stopover
from turtlebag.planners.control.interface import SpeedLimits, ramped
from turtlebag.planners.control.monitor import CollisionMonitor
from turtlebag.planners.tasks.avoid import in_words
from turtlebag.planners.tasks.sequence import GoalSequence
from turtlebag.planners.tasks.waypoints import Waypoint
from turtlebag.planners.tasks.wiggle import Wiggle
from turtlebag.sim.simulator import CONTROL_HZ

Kind = Literal["goal", "patrol", "avoid", "explore", "wiggle"]


@dataclass(frozen=True, eq=False)
class Task:
    """A driver at work since `begin_ns`; goals, for those that have some; `opening` is what is said first."""

    kind: Kind
    opening: str
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


def goal_task(kit: Kit, navigation: NavigationDriver, pose: Pose, now_ns: int) -> Task:
    """Drive to a goal on the map."""
    sequence = GoalSequence([_waypoint(pose)], kit.config.sequence.model_copy(update=SINGLE_GOAL))
    navigation.begin(sequence)
    return Task("goal", "drive to a goal", now_ns, navigation, sequence, on_map=True)


def mapless_goal_task(kit: Kit, T_map_odom: SE2, observation: Observation, pose: Pose) -> Task:
    """Drive to a goal by odometry and what is seen alone."""
    goal = Waypoint(T_map_odom.inverse() @ SE2.from_xyt(*pose), "", pose)
    sequence = GoalSequence([goal], kit.config.sequence.model_copy(update=SINGLE_GOAL))
    driver = make_mapless(kit, observation.odometry.T_odom_base, sequence)
    return Task("goal", "drive to a goal without a map", observation.stamp_ns, driver, sequence)


def patrol_task(
    kit: Kit, navigation: NavigationDriver, stopovers: Sequence[Stopover], laps: int, now_ns: int
) -> Task:
    """Drive to one goal after the other on the map."""
    waypoints = [_waypoint(stop.pose, stop.wait) for stop in stopovers]
    sequence = GoalSequence(waypoints, kit.config.sequence.model_copy(update={"laps": laps}))
    navigation.begin(sequence)
    opening = f"patrol of {len(waypoints)} goals" + (f", {laps} laps" if laps > 1 else "")
    return Task("patrol", opening, now_ns, navigation, sequence, on_map=True)


def avoid_task(kit: Kit, say: Callable[[str], None], now_ns: int) -> Task:
    """Drive about and touch nothing; `say` is told each decision that is another than the one before."""
    driver = make_avoider(kit, now_ns * 1e-9 + MAX_SIMULATED_S, _changes_only(say))
    return Task("avoid", "drive around and avoid obstacles", now_ns, driver)


def explore_task(kit: Kit, mapper: OnlineMap, now_ns: int) -> Task:
    """Map what can be reached."""
    driver = make_explorer(kit, mapper, now_ns * 1e-9 + DEFAULT_EXPLORE_S)
    return Task("explore", "explore and map", now_ns, driver)


def wiggle_task(kit: Kit, localiser: Localiser, now_ns: int) -> Task:
    """Turn to and fro until the particles have drawn together."""
    driver = WiggleDriver(kit, localiser)
    return Task("wiggle", "turn to and fro until the particles draw together", now_ns, driver, on_map=True)


class WiggleDriver(Driver):
    """Turns to and fro, as far as there is room; it only watches the localiser, which others feed."""

    def __init__(self, kit: Kit, localiser: Localiser) -> None:
        super().__init__(kit.sensing)
        model = kit.robot.model
        self._localiser = localiser
        self._wiggle = Wiggle()
        self._monitor = CollisionMonitor(model)
        self._limits = SpeedLimits.of(model, 1.0 / CONTROL_HZ)

    @property
    def spread(self) -> str:
        """How narrow the cloud is, for people."""
        amcl = self._localiser.amcl
        assert isinstance(amcl, Amcl)
        if not amcl.watch.updates:
            return "no scan was used yet"
        std = np.sqrt(np.diag(amcl.covariance))
        verdict = "have drawn together" if amcl.converged else "are still spread"
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


def _waypoint(pose: Pose, wait: float | None = None) -> Waypoint:
    return Waypoint(SE2.from_xyt(*pose), "", pose, wait)


def _changes_only(say: Callable[[str], None]) -> Callable[[str], None]:
    """Passes a decision on when its words, which stand after the numbers, are others than the last one's."""
    last = ""

    def told(line: str) -> None:
        nonlocal last
        words = line.rpartition("  ")[2]
        if words != last:
            last = words
            say(line.strip())

    return told
