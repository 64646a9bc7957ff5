"""The robot's software in a session: it localises, maps and runs a task, all at once.

Tasks are the drivers of `navigate`, and one more that turns back and forth (wiggle).
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass
from typing import Literal

import numpy as np

from turtlebag.datasets.durations import nanoseconds
from turtlebag.datasets.grid import OccupancyGrid
from turtlebag.datasets.se2 import SE2
from turtlebag.datasets.types import Observation, Twist
from turtlebag.pipeline.localisation.amcl import Amcl
from turtlebag.pipeline.navigation.avoid_driver import AvoidDriver
from turtlebag.pipeline.navigation.driver import Driver
from turtlebag.pipeline.navigation.driver_setup import MAX_SIMULATED_S
from turtlebag.pipeline.navigation.drivers import make_navigator
from turtlebag.pipeline.navigation.explore_driver import ExploreDriver
from turtlebag.pipeline.navigation.kit import Kit
from turtlebag.pipeline.navigation.navigator import NavigationDriver
from turtlebag.pipeline.navigation.online_localiser import OnlineLocaliser
from turtlebag.pipeline.navigation.online_map import OnlineMap
from turtlebag.pipeline.slam.online.mapper import Mapper
from turtlebag.planners.control.collision_monitor import CollisionMonitor
from turtlebag.planners.control.controller import SpeedLimits, ramped
from turtlebag.planners.costmap import Costmap
from turtlebag.planners.obstacle_layer import ObstacleLayer
from turtlebag.planners.tasks.patrol import GoalSequence
from turtlebag.planners.tasks.sector_rule import in_words
from turtlebag.planners.tasks.wiggle import Wiggle
from turtlebag.sim.robots import PERIOD_S

DRAWN_EVERY_NS = 2 * 10**9
"""While mapping, loops are closed and the map is drawn this often, if the robot has moved since."""
MOVED_M, MOVED_RAD = 0.05, 0.05


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
        return self.begin_ns + nanoseconds(MAX_SIMULATED_S)

    @property
    def decision(self) -> str:
        """What was decided by the three sectors, for the task that goes by them."""
        return in_words(self.driver.state) if isinstance(self.driver, AvoidDriver) else ""

    @property
    def explorer(self) -> ExploreDriver | None:
        """The driver, if it is exploring."""
        return self.driver if isinstance(self.driver, ExploreDriver) else None


class WiggleDriver(Driver):
    """Turns back and forth, as far as there is room; it only watches the localiser, which the pilot feeds."""

    def __init__(self, kit: Kit, localiser: OnlineLocaliser) -> None:
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


class Pilot(Driver):
    """A driver of whatever task there is; without one it stands still. It never sees the truth."""

    def __init__(self, kit: Kit) -> None:
        super().__init__(kit.sensing)
        self.kit = kit
        self.task: Task | None = None
        self.navigation: NavigationDriver | None = None
        """Localises on the map that is loaded, and drives on it; None without a map."""
        self.mapper: OnlineMap | None = None
        """Of the map that was begun here; None when there is none."""
        self.mapping = False
        self._limits = SpeedLimits.of(kit.robot.model, PERIOD_S)
        self._drawn_ns = 0
        self._drawn_at = SE2.identity()
        self.state = "idle"

    @property
    def localiser(self) -> OnlineLocaliser | None:
        """That of the navigation; None without a map."""
        return None if self.navigation is None else self.navigation.localiser

    @property
    def T_map_odom(self) -> SE2:
        """Odometry's frame on the map; the same as the map's while nothing else is known."""
        if self.localiser is not None:
            return self.localiser.T_map_odom or SE2.identity()
        return SE2.identity() if self.mapper is None else self.mapper.T_map_odom

    @property
    def slam(self) -> Mapper | None:
        """What has mapped a scan at least."""
        return None if self.mapper is None else self.mapper.mapper

    @property
    def localised(self) -> bool:
        """Whether there is a pose on a map that was loaded."""
        return self.localiser is not None and self.localiser.T_map_odom is not None

    @property
    def told(self) -> bool:
        """Whether a pose estimate was set or global localisation started."""
        return self.localiser is not None and self.localiser.amcl.initialised

    def load(self, grid: OccupancyGrid, costmap: Costmap, now_ns: int) -> None:
        """Go by this map from now on; no pose on it is known, and what was mapped here is forgotten."""
        idle = GoalSequence((), self.kit.config.sequence)
        self.navigation = make_navigator(self.kit, grid, costmap, idle)
        self.mapper, self.mapping = None, False
        self.kit.publisher.map(now_ns, grid)

    def start_mapping(self) -> None:
        """Begin a new map, and go by it."""
        self.navigation = None
        kit = self.kit
        online = OnlineMap(kit.robot.T_base_lidar, kit.config.explore.slam, kit.lidars())
        self.mapper, self.mapping = online, True

    def keep_out(self, costmap: Costmap) -> None:
        """The map that is loaded has other places to keep out of."""
        assert self.navigation is not None
        self.navigation.use(self.kit.tools(ObstacleLayer(costmap)))

    def begin(self, task: Task) -> None:
        """Do this from the next step on."""
        self.task = task
        task.driver.resume(self._last)

    def end_task(self) -> None:
        """Do nothing more."""
        self.task, self.state, self.goal_index = None, "idle", -1
        if self.navigation is not None:
            self.navigation.begin(GoalSequence((), self.kit.config.sequence))

    def step(self, observation: Observation) -> Twist:
        """The command of the task, or a standstill."""
        self._look(observation)
        if self.task is None:
            self._last = ramped(Twist(), self._last, self._limits)
        else:
            self._last = self.task.driver.step(observation)
        self._note(observation)
        return self._last

    def stand_by(self, observation: Observation) -> None:
        """Localise and map on while someone drives by hand."""
        self._look(observation)
        if self.task is not None:
            self.task.driver.stand_by(observation)
        self._note(observation)

    def resume(self, last: Twist) -> None:
        """Go on with the task from where the robot has been brought."""
        super().resume(last)
        if self.task is not None:
            self.task.driver.resume(last)

    def _look(self, observation: Observation) -> None:
        """Feed what the task itself does not."""
        self.sensing.observe(observation)
        driver = None if self.task is None else self.task.driver
        if self.mapping and self.mapper is not None and (self.task is None or self.task.explorer is None):
            self.mapper.observe(observation)
            self._draw(self.mapper, observation)
        if self.navigation is not None and driver is not self.navigation:
            self.navigation.stand_by(observation)
        if self.localiser is not None:
            self.localiser.scan_poses.clear()  # a session writes them as it goes on

    def _draw(self, mapper: OnlineMap, observation: Observation) -> None:
        now, T_odom_base = observation.stamp_ns, observation.odometry.T_odom_base
        if observation.scan is None or not mapper.ready or now - self._drawn_ns < DRAWN_EVERY_NS:
            return
        x, y, yaw = (self._drawn_at.inverse() @ T_odom_base).xyt.tolist()
        if mapper.grid is not None and abs(yaw) < MOVED_RAD and x * x + y * y < MOVED_M**2:
            return
        self._drawn_ns, self._drawn_at = now, T_odom_base
        self.kit.publisher.map(now, mapper.update())
        self.kit.publisher.map_to_odom(now, mapper.T_map_odom)

    def _note(self, observation: Observation) -> None:
        known = self.localised or self.mapper is not None
        self.estimate = self.T_map_odom @ observation.odometry.T_odom_base if known else None
        if self.task is not None:
            self.state, self.goal_index = self.task.driver.state, self.task.driver.goal_index
