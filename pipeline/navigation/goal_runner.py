"""Pursuing one goal: plan, follow, watch out, recover, and say what became of it."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from turtlebag.datasets.se2 import SE2, Array
from turtlebag.datasets.types import RobotModel, Twist
from turtlebag.pipeline.navigation.moving_obstacles import Wary
from turtlebag.planners.control.goal_checker import GoalChecker, GoalCheckerConfig
from turtlebag.planners.control.interface import Controller
from turtlebag.planners.control.monitor import CollisionMonitor, moved
from turtlebag.planners.costmap import Costmap
from turtlebag.planners.footprint import footprint_clearance, path_clearance, sample_footprint
from turtlebag.planners.global_plan import NoPath, Plan, PlanConfig, plan_path
from turtlebag.planners.live import LiveLayer
from turtlebag.planners.tasks.recovery import Ladder, Manoeuvre, ProgressWatch, RecoveryConfig
from turtlebag.planners.tasks.sequence import Status

LOOK_AHEAD_M = 2.5
TIGHT_M = 0.02
"""A path along which the footprint comes this near to something counts as blocked."""

NOTHING = np.zeros((0, 2))


@dataclass(frozen=True, eq=False)
class Tools:
    """What a runner uses; the same for all goals of a run."""

    model: RobotModel
    controller: Controller
    monitor: CollisionMonitor
    wary: Wary
    live: LiveLayer
    plan: PlanConfig
    checker: GoalCheckerConfig
    recovery: RecoveryConfig


@dataclass(frozen=True)
class Verdict:
    """How the pursuit of a goal ended."""

    status: Status
    reason: str = ""


class GoalRunner:
    """One goal, in the frame of the live layer's costmap."""

    def __init__(self, tools: Tools, goal: SE2, seed: int, publish_plan: Callable[[SE2], None]) -> None:
        self.tools = tools
        self.goal = goal
        self.state = "plan"
        self._seed = seed
        self._plans = 0
        self._publish_plan = publish_plan
        self._checker = GoalChecker(tools.checker, goal)
        self._ladder = Ladder(tools.recovery, tools.live.clear)
        self._watch = ProgressWatch(tools.recovery)
        self._manoeuvre: Manoeuvre | None = None
        self._path: Plan | None = None
        self._planned_ns = 0
        self._planned_on = tools.live.static
        self._aimed_short = False
        self._held_ns = 0
        self._driven = 0.0
        self._at: SE2 | None = None
        self._points = self._moving = NOTHING
        self._samples = sample_footprint(tools.model, 0.03)
        self._trouble = ""

    def step(
        self,
        now_ns: int,
        pose: SE2,
        measured: Twist,
        last: Twist,
        points_base: Array,
        new_sweep: bool,
        moving_base: Array = NOTHING,
    ) -> tuple[Twist, Verdict | None]:
        """The next command, and the verdict when the pursuit is over.

        `points_base` (n, 2) are all points seen, `moving_base` those of things that move.
        """
        self._points, self._moving = points_base, moving_base
        self._note_progress(pose)
        if self._checker.reached(now_ns, pose, measured):
            return self.tools.controller.brake(last), Verdict("reached")
        if self._manoeuvre is not None:
            wanted = self._manoeuvre.command(now_ns, pose)
            if wanted is not None:
                self.state = self._manoeuvre.name
                return self._guarded(wanted, last, pose), None
            self._manoeuvre, self._path = None, None
            self._watch.reset()
        if self._path is None or (new_sweep and self._blocked(now_ns, pose)):
            verdict = self._replan(now_ns, pose)
            if verdict is not None or self._path is None:
                return self.tools.controller.brake(last), verdict
        wanted = self.tools.controller.command(pose, last, self.tools.live.costmap)
        self.state = self.tools.controller.state
        command = self._guarded(wanted, last, pose)
        return command, self._held_up(now_ns, pose, wanted, command)

    @property
    def recovering(self) -> bool:
        """Whether it is in trouble, and has not got on since."""
        return self._ladder.climbed

    def rest(self) -> None:
        """Time passes without the robot being meant to move."""
        self._watch.reset()

    def _note_progress(self, pose: SE2) -> None:
        if self._at is not None:
            self._driven += float(np.linalg.norm(pose.xy - self._at.xy))
        self._at = pose
        if self._driven > self.tools.recovery.progress and self._manoeuvre is None:
            self._driven = 0.0
            self._ladder.rest()

    def _replan(self, now_ns: int, pose: SE2) -> Verdict | None:
        """A new path; without one the way on is recovery, or giving up when there never was one."""
        self._plans += 1
        self._planned_ns = now_ns
        try:
            self._path = self._plan_on(self.tools.live.costmap, pose)
        except NoPath as error:
            self._path = None
            self.state = "plan"
            if not self.tools.live.marked:
                return Verdict("unreachable", str(error))
            return self._recover(now_ns, pose, f"blocked by an unmapped obstacle: {error}")
        self.tools.controller.set_path(self._path.poses)
        self._publish_plan(self._path.poses)
        return None

    def _plan_on(self, costmap: Costmap, pose: SE2) -> Plan:
        t = self.tools
        self._planned_on = t.live.static
        self._aimed_short = t.live.stands_in(self.goal)
        aim = t.live.aim(pose, self.goal, t.model.circumscribed_radius + min(t.plan.margins))
        return plan_path(costmap, t.model, pose, aim, t.plan, self._seed + 1000 * self._plans)

    def _blocked(self, now_ns: int, pose: SE2) -> bool:
        """Whether live obstacles stand on the path ahead, or it ends at the rim of a window now left."""
        live = self.tools.live
        if live.static is not self._planned_on and self._aimed_short:
            return True
        if (
            not live.marked
            or self._path is None
            or now_ns - self._planned_ns < self.tools.plan.replan_period * 1e9
        ):
            return False
        costmap = live.costmap
        poses = np.ascontiguousarray((costmap.T_grid_map @ self._path.poses).xyt)
        x, y, _ = (costmap.T_grid_map @ pose).xyt.tolist()
        clearance = path_clearance(
            costmap.clearance, costmap.resolution, self._samples, poses, x, y, LOOK_AHEAD_M
        )
        return bool(clearance < TIGHT_M)

    def _guarded(self, wanted: Twist, last: Twist, pose: SE2) -> Twist:
        """The command that the collision monitor lets pass."""
        factor = self._passed(wanted, pose)
        if factor >= 1.0:
            return wanted
        self.state = "held" if factor == 0.0 else self.state
        return self.tools.controller.ramp(Twist(wanted.v * factor, wanted.w * factor), last)

    def _passed(self, wanted: Twist, pose: SE2) -> float:
        """Factor 0..1 for a command, by the points seen and by the map."""
        monitor, costmap = self.tools.monitor, self.tools.live.static
        if self.tools.wary.holds(self._moving):
            return 0.0
        factor = monitor.limit(wanted, self._points)
        if factor > 0.0:
            x, y, yaw = (costmap.T_grid_map @ pose).xyt.tolist()
            factor = min(
                factor,
                monitor.limit_on_map(wanted, costmap.clearance, costmap.resolution, x, y, yaw),
            )
        return factor

    def _room_after(self, twist: Twist, amount: float, pose: SE2) -> float:
        """Room round the footprint [m] after a twist over an amount [m or rad]; -inf when it is held."""
        if self._passed(twist, pose) <= 0.5:
            return -np.inf
        costmap = self.tools.live.costmap
        x, y, yaw = (costmap.T_grid_map @ pose).xyt.tolist()
        after = moved(x, y, yaw, twist.v, twist.w, amount / max(abs(twist.v), abs(twist.w)))
        return float(footprint_clearance(costmap.clearance, costmap.resolution, self._samples, *after))

    def _held_up(self, now_ns: int, pose: SE2, wanted: Twist, command: Twist) -> Verdict | None:
        """Recovery when the monitor holds the robot, or when it does not get on."""
        moving = abs(wanted.v) > 0.005 or abs(wanted.w) > 0.03
        if moving and self._watch.stuck(now_ns, pose):
            return self._recover(now_ns, pose, "stuck: the robot made no progress")
        if not moving:
            self._watch.reset()
        return None

    def _recover(self, now_ns: int, pose: SE2, trouble: str) -> Verdict | None:
        self._watch.reset()
        self._driven = 0.0
        self._manoeuvre = self._ladder.climb(now_ns, pose, lambda t, far: self._room_after(t, far, pose))
        if self._manoeuvre is None:
            return Verdict("unreachable", f"{trouble}; given up after {self._ladder.used} recoveries")
        return None
