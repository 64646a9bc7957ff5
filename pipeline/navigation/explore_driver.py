"""The driver of the task `explore`: maps an unknown world by frontier exploration."""

from __future__ import annotations

import dataclasses
from dataclasses import dataclass

import numpy as np

from turtlebag.datasets.durations import nanoseconds
from turtlebag.datasets.grid import OccupancyGrid
from turtlebag.datasets.se2 import Array
from turtlebag.datasets.types import Observation, Twist
from turtlebag.pipeline.navigation.bump_reflex import BumpReflex
from turtlebag.pipeline.navigation.driver import Driver
from turtlebag.pipeline.navigation.goal_runner import GoalRunner, Tools
from turtlebag.pipeline.navigation.goal_states import State, Suspension
from turtlebag.pipeline.navigation.obstacle_memory import ObstacleMemory
from turtlebag.pipeline.navigation.online_map import OnlineMap
from turtlebag.pipeline.navigation.sensing import DeskewedScan, Sensing
from turtlebag.planners.control.collision_monitor import PADDING_M
from turtlebag.planners.control.goal_checker import STOPPED_V
from turtlebag.planners.costmap import CostmapConfig, costmap_from_grid
from turtlebag.planners.obstacle_layer import ObstacleLayer
from turtlebag.planners.tasks.frontier import next_view

LOOK_AFTER_S = 12.0
"""The map is made anew after this long on the way to one place, too."""


@dataclass
class _Way:
    """To one place to look from, chosen on the map of a time."""

    runner: GoalRunner
    since_ns: int


class ExploreDriver(Driver):
    """Map, choose a frontier, drive there, look, map again, until no frontier can be reached."""

    def __init__(
        self, config: CostmapConfig, sensing: Sensing, online: OnlineMap, tools: Tools, duration_s: float
    ) -> None:
        super().__init__(sensing)
        self.online = online
        self._config, self.tools = config, tools
        self._end_ns = nanoseconds(duration_s)
        self._memory = ObstacleMemory(tools.model)
        self._reflex = BumpReflex(self._memory)
        self._way: _Way | None = None
        self._done = False
        self._spent: list[Array] = []

    @property
    def grid(self) -> OccupancyGrid | None:
        """The map so far."""
        return self.online.grid

    def step(self, observation: Observation) -> Twist:
        """The command for the next control period."""
        now = observation.stamp_ns
        self.stand_by(observation)
        if not self.online.ready and now >= self._end_ns:
            self._done = True  # no scan ever came: there is nothing to draw
        if not self.online.ready or self._done:
            return self._stop(observation)
        if now >= self._end_ns:
            return self._finish(observation)
        if self.sensing.blind:
            self.state = Suspension.BLIND.value
            return self._stop(observation)
        sweep = None if observation.scan is None else self.sensing.sweep
        away = self._back_off(observation, sweep)
        if away is not None:
            return away
        if self._way is None or (sweep is not None and self._late(self._way, now)):
            self._choose(observation)
            if self._way is None:
                return self._finish(observation)
        if sweep is not None:
            self._see(sweep, self.online.T_map_odom, self.tools.obstacles)
        return self._pursue(self._way.runner, observation)

    def stand_by(self, observation: Observation) -> None:
        """Keep mapping during a teleop override."""
        self.sensing.observe(observation)
        self.online.observe(observation)
        self.estimate = self.online.T_map_odom @ observation.odometry.T_odom_base

    def resume(self, last: Twist) -> None:
        """Look for the next frontier from where the robot has been brought."""
        super().resume(last)
        self._way = None

    def _late(self, way: _Way, now: int) -> bool:
        """Whether to look at the map anew on the way: not in trouble, or its recoveries would never end."""
        return now - way.since_ns > nanoseconds(LOOK_AFTER_S) and not way.runner.recovering

    def _back_off(self, observation: Observation, sweep: DeskewedScan | None) -> Twist | None:
        """The command while getting away from something that no lidar sees; None when there is no need."""
        T_odom_base, T_map_odom = observation.odometry.T_odom_base, self.online.T_map_odom
        if sweep is not None and self._reflex.triggered(sweep, T_odom_base, self._last, 0.0, T_map_odom):
            self.online.distrust()
            self._way = None
        wanted = self._reflex.command(observation.stamp_ns, T_odom_base)
        if wanted is None:
            return None
        self.state = "back_off"
        factor = self.tools.monitor.limit(wanted, self.sensing.points_base(T_odom_base))
        self._last = self.tools.controller.ramp(Twist(wanted.v * factor, 0.0), self._last)
        return self._last

    def _choose(self, observation: Observation) -> None:
        """Map, and pick the place to look from; no runner when there is none."""
        now, grid, publisher = observation.stamp_ns, self.online.update(), self.tools.publisher
        self._way = None
        publisher.map(now, grid)
        publisher.map_to_odom(now, self.online.T_map_odom)
        self.estimate = self.online.T_map_odom @ observation.odometry.T_odom_base
        costmap = self._memory.kept_out(costmap_from_grid(grid, self._config), now)
        radius = self.tools.model.circumscribed_radius + PADDING_M
        goal = next_view(grid, costmap, self.estimate, radius, self._spent)
        if goal is None:
            return
        self.goal_index += 1
        publisher.goal(now, goal)
        obstacles = ObstacleLayer(costmap)
        self.tools = dataclasses.replace(self.tools, obstacles=obstacles)
        if self.sensing.sweep is not None:
            self._see(self.sensing.sweep, self.online.T_map_odom, self.tools.obstacles)
        runner = GoalRunner(self.tools, goal, self.tools.seed + 1_000_000 * self.goal_index)
        self._way = _Way(runner, now)

    def _pursue(self, runner: GoalRunner, observation: Observation) -> Twist:
        assert self.estimate is not None
        self._last, verdict = runner.step(self._tick(observation, self.estimate))
        self.state = runner.state
        if verdict is not None:
            self._spent.append(np.asarray(runner.goal.xy))
            self._way = None
        return self._last

    def _finish(self, observation: Observation) -> Twist:
        if not self._done:
            self.tools.publisher.map(observation.stamp_ns, self.online.finish())
        self._done = True
        return self._stop(observation)

    def _stop(self, observation: Observation) -> Twist:
        """Brake; the run is over when it was done and the robot stands."""
        if self._done:
            self.state = State.DONE.value
        self._last = self.tools.controller.brake(self._last)
        self.finished = self._done and abs(observation.odometry.twist.v) <= STOPPED_V
        return self._last
