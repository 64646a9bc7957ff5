"""The driver of the task `explore`: an unknown world mapped without a script."""

from __future__ import annotations

from collections.abc import Callable
from typing import Protocol

import numpy as np
from pydantic import BaseModel, ConfigDict, Field

from turtlebag.datasets.grid import OccupancyGrid
from turtlebag.datasets.se2 import SE2, Array
from turtlebag.datasets.spans import Seconds
from turtlebag.datasets.types import Observation, RobotModel, Twist
from turtlebag.pipeline.navigation.bump_memory import Unseen
from turtlebag.pipeline.navigation.goal_runner import GoalRunner, Tools
from turtlebag.pipeline.navigation.guarded import GuardConfig
from turtlebag.pipeline.navigation.localiser import Publisher
from turtlebag.pipeline.navigation.online_map import OnlineMap
from turtlebag.pipeline.navigation.sensing import Sensing, Sight
from turtlebag.pipeline.slam.slam import SlamConfig
from turtlebag.planners.control.goal_checker import GoalCheckerConfig
from turtlebag.planners.costmap import Costmap, CostmapConfig, costmap_from_grid
from turtlebag.planners.tasks.frontier import FrontierConfig, next_view


class MapPublisher(Publisher, Protocol):
    """A publisher of maps, too."""

    def map(self, stamp_ns: int, grid: OccupancyGrid) -> None:
        """The map so far."""
        ...


class ExploreConfig(BaseModel):
    """Seconds and metres."""

    model_config = ConfigDict(extra="forbid", frozen=True, allow_inf_nan=False)
    frontier: FrontierConfig = FrontierConfig()
    slam: SlamConfig = SlamConfig()
    costmap: CostmapConfig = CostmapConfig()
    checker: GoalCheckerConfig = GoalCheckerConfig(xy_goal_tolerance=0.2, yaw_goal_tolerance=3.2, stop=False)
    guard: GuardConfig = GuardConfig()
    """How slipping wheels are noticed, and how far it backs off then."""
    margin: float = Field(default=0.03, ge=0.0)
    """Clearance beyond the robot's circumscribed radius that ways must have."""
    look_after: Seconds = Field(default=12.0, gt=0.0)
    """The map is made anew after this long on the way to one place, too."""


class ExploreDriver:
    """Map, choose a frontier, drive there, look, map again, until no frontier can be reached."""

    def __init__(
        self,
        config: ExploreConfig,
        model: RobotModel,
        sensing: Sensing,
        online: OnlineMap,
        make_tools: Callable[[Costmap], Tools],
        publisher: MapPublisher,
        duration_s: float,
        seed: int,
    ) -> None:
        self.state, self.goal_index, self.finished = "wait", -1, False
        self.estimate: SE2 | None = None
        self.online = online
        self.sensing = sensing
        self._config, self._model = config, model
        self._make_tools, self._publisher = make_tools, publisher
        self._end_ns, self._seed = round(duration_s * 1e9), seed
        self._unseen = Unseen(model, config.guard)
        self._tools: Tools | None = None
        self._runner: GoalRunner | None = None
        self._spent: list[Array] = []
        self._mapped_ns, self._seen_ns, self._now = 0, -(10**9), 0
        self._last = Twist()

    @property
    def grid(self) -> OccupancyGrid | None:
        """The map so far."""
        return self.online.grid

    def step(self, observation: Observation) -> Twist:
        """The command for the next control period."""
        self._now = observation.stamp_ns
        sight = self.sensing.observe(observation)
        self.online.observe(observation)
        self.estimate = self.online.T_map_odom @ observation.odometry.T_odom_base
        if not self.online.ready and self._now >= self._end_ns:
            self.state = "done"  # no scan ever came: there is nothing to draw
        if not self.online.ready or self.state == "done":
            return self._stop(observation)
        if self._now >= self._end_ns:
            return self._finish(observation)
        if self.sensing.blind:
            self.state = "blind"
            return self._stop(observation)
        away = self._back_off(observation, sight)
        if away is not None:
            return away
        if self._runner is None or (observation.scan is not None and self._late(self._runner)):
            self._choose(observation)
            if self._runner is None:
                return self._finish(observation)
        if sight is not None:
            self._see(sight)
        return self._pursue(self._runner, observation, sight is not None)

    def _late(self, runner: GoalRunner) -> bool:
        """Whether to look at the map anew on the way: not in trouble, or its recoveries would never end."""
        return self._now - self._mapped_ns > self._config.look_after * 1e9 and not runner.recovering

    def _back_off(self, observation: Observation, sight: Sight | None) -> Twist | None:
        """The command while getting away from something that no lidar sees; None when there is no need."""
        T_odom_base = observation.odometry.T_odom_base
        if sight is not None and self._unseen.noticed(sight, T_odom_base, self.online.T_map_odom, self._last):
            self.online.distrust()
            self._runner = None
        wanted = self._unseen.backing_off(self._now, T_odom_base)
        if wanted is None or self._tools is None:
            return None
        self.state = "back_off"
        factor = self._tools.monitor.limit(wanted, self.sensing.points_base(T_odom_base))
        self._last = self._tools.controller.ramp(Twist(wanted.v * factor, 0.0), self._last)
        return self._last

    def stand_by(self, observation: Observation) -> None:
        """Map on while someone else drives."""
        self._now = observation.stamp_ns
        self.sensing.observe(observation)
        self.online.observe(observation)
        self.estimate = self.online.T_map_odom @ observation.odometry.T_odom_base

    def resume(self, last: Twist) -> None:
        """Look for the next frontier from where the robot has been brought."""
        self._last, self._runner = last, None

    def _choose(self, observation: Observation) -> None:
        """Map, and pick the place to look from; no runner when there is none."""
        grid = self.online.update()
        self._mapped_ns, self._runner = self._now, None
        self._publisher.map(self._now, grid)
        self._publisher.map_to_odom(self._now, self.online.T_map_odom)
        self.estimate = self.online.T_map_odom @ observation.odometry.T_odom_base
        costmap = self._unseen.kept_out(costmap_from_grid(grid, self._config.costmap))
        radius = self._model.circumscribed_radius + self._config.margin
        goal = next_view(grid, costmap, self.estimate, radius, self._spent, self._config.frontier)
        if goal is None:
            return
        self.goal_index += 1
        self._publisher.goal(self._now, goal)
        self._tools = self._make_tools(costmap)
        if self.sensing.sight is not None:
            self._seen_ns = -(10**9)
            self._see(self.sensing.sight)
        self._runner = GoalRunner(self._tools, goal, self._seed + 1_000_000 * self.goal_index, self._plan)

    def _plan(self, poses: SE2) -> None:
        self._publisher.plan(self._now, poses)

    def _see(self, sight: Sight) -> None:
        if self._tools is None or sight.stamp_ns - self._seen_ns < self._tools.live.config.period * 1e9:
            return
        self._seen_ns = sight.stamp_ns
        T = self.online.T_map_odom
        self._tools.live.update(
            sight.stamp_ns * 1e-9, T @ sight.T_odom_lidar, T @ sight.hits_odom, T @ sight.passes_odom
        )

    def _pursue(self, runner: GoalRunner, observation: Observation, new_sweep: bool) -> Twist:
        odometry = observation.odometry
        assert self.estimate is not None
        points = self.sensing.points_base(odometry.T_odom_base)
        self._last, verdict = runner.step(
            self._now, self.estimate, odometry.twist, self._last, points, new_sweep
        )
        self.state = runner.state
        if verdict is not None:
            self._spent.append(np.asarray(runner.goal.xy))
            self._runner = None
        return self._last

    def _finish(self, observation: Observation) -> Twist:
        if self.state != "done":
            self._publisher.map(self._now, self.online.finish())
        self.state = "done"
        return self._stop(observation)

    def _stop(self, observation: Observation) -> Twist:
        """Brake; the run is over when it was done and the robot stands."""
        if self._tools is not None:
            self._last = self._tools.controller.brake(self._last)
        self.finished = self.state == "done" and abs(observation.odometry.twist.v) < 1e-3
        return self._last if self._tools is not None else Twist()
