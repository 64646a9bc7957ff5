"""Going to one pose after another on a map: localise, plan, follow, check, give up with a reason."""

from __future__ import annotations

from dataclasses import dataclass

from datasets.se2 import SE2
from datasets.types import Observation, RobotModel, Twist
from pipeline.navigation.localiser import Localiser, Publisher
from planners.control.goal_checker import GoalChecker, GoalCheckerConfig
from planners.control.interface import Controller
from planners.costmap import Costmap
from planners.global_plan import NoPath, PlanConfig, fits, plan_path
from planners.tasks.sequence import GoalSequence


@dataclass(frozen=True, eq=False)
class Parts:
    """What a navigator is made of."""

    model: RobotModel
    costmap: Costmap
    localiser: Localiser
    controller: Controller
    plan_config: PlanConfig
    checker_config: GoalCheckerConfig
    publisher: Publisher
    plan_seed: int


class NavigationDriver:
    """The driver of `goal` and `patrol` (see pipeline.navigation.driver)."""

    def __init__(self, parts: Parts, sequence: GoalSequence) -> None:
        self.parts = parts
        self.sequence = sequence
        self.state = "wait"
        self.goal_index = -1
        self.finished = False
        self.estimate: SE2 | None = None
        self._goal: SE2 | None = None
        self._checker: GoalChecker | None = None
        self._plans = 0
        self._last = Twist()

    def step(self, observation: Observation) -> Twist:
        """Localise, ask the task for the goal, follow the path to it."""
        now = observation.stamp_ns
        self.parts.localiser.observe(observation)
        self.estimate = self.parts.localiser.T_map_base(observation.odometry.T_odom_base)
        if not self.parts.localiser.amcl.initialised:
            self.sequence.reject_all("no initial pose", now)
            return self._stop("no_pose", finished=True)
        goal = self.sequence.update(now)
        self.goal_index = self.sequence.index if goal is not None else -1
        if self.sequence.finished:
            return self._stop("done", finished=abs(self._last.v) < 1e-3)
        if goal is None or self.estimate is None:
            self._goal = None
            return self._stop("wait")
        if goal is not self._goal and not self._start(goal, self.estimate, now):
            return self._stop("wait")
        return self._follow(observation, self.estimate)

    def _start(self, goal: SE2, estimate: SE2, now: int) -> bool:
        """Plan to a new goal; False when that is impossible, and its outcome is recorded."""
        self._goal = goal
        self._checker = GoalChecker(self.parts.checker_config, goal)
        self.parts.publisher.goal(now, goal)
        if not fits(self.parts.costmap, self.parts.model, goal):
            self.sequence.close("rejected", "the goal is in an obstacle or off the map", now)
            return False
        return self._plan(goal, estimate, now)

    def _plan(self, goal: SE2, estimate: SE2, now: int) -> bool:
        self._plans += 1
        seed = self.parts.plan_seed + 1000 * self._plans
        try:
            plan = plan_path(
                self.parts.costmap, self.parts.model, estimate, goal, self.parts.plan_config, seed
            )
        except NoPath as error:
            self.sequence.close("unreachable", str(error), now)
            return False
        self.parts.controller.set_path(plan.poses)
        self.parts.publisher.plan(now, plan.poses)
        return True

    def _follow(self, observation: Observation, estimate: SE2) -> Twist:
        now = observation.stamp_ns
        command = self.parts.controller.command(estimate, self._last, self.parts.costmap)
        self.state = self.parts.controller.state
        if self._checker is not None and self._checker.reached(now, estimate, observation.odometry.twist):
            self.sequence.close("reached", "", now)
            return self._stop("reached")
        self._last = command
        return command

    def _stop(self, state: str, *, finished: bool = False) -> Twist:
        """Brake to a standstill."""
        self.state, self.finished = state, finished
        self._last = self.parts.controller.brake(self._last)
        return self._last
