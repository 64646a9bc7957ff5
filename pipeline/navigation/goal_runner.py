"""Runs one goal: plan, follow, avoid obstacles, recover, and report the outcome."""

from __future__ import annotations

import functools
import math
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from turtlebag.datasets.bags.writer import BagWriter
from turtlebag.datasets.durations import nanoseconds
from turtlebag.datasets.se2 import SE2, Array
from turtlebag.datasets.types import RobotModel, Twist
from turtlebag.pipeline.navigation.goal_states import Event, Machine, State
from turtlebag.planners.control.collision_monitor import PADDING_M, CollisionMonitor, moved
from turtlebag.planners.control.controller import Controller, slowed
from turtlebag.planners.control.goal_checker import STOPPED_V, STOPPED_W, GoalChecker, GoalCheckerConfig
from turtlebag.planners.costmap import Costmap
from turtlebag.planners.footprint import (
    FootprintSamples,
    footprint_clearance,
    path_clearance,
    sample_footprint,
)
from turtlebag.planners.global_plan import plan_path
from turtlebag.planners.obstacle_layer import ON_MAP, ObstacleLayer
from turtlebag.planners.planner import NoPath, PlanConfig
from turtlebag.planners.tasks.patrol import Status
from turtlebag.planners.tasks.recovery import PROGRESS_M, Ladder, Manoeuvre, ProgressWatch, RecoveryConfig

LOOK_AHEAD_M = ON_MAP.obstacle_range
"""Obstacles farther along the path are no reason to plan anew: on a map none is marked from farther off."""


class Tick(NamedTuple):
    """The data of a control period for the goal runner."""

    now_ns: int
    pose: SE2
    measured: Twist
    last: Twist
    points_base: Array
    """Everything seen, (n, 2)."""
    new_sweep: bool
    stop: bool
    """Whether to stand still because something moves nearby."""


ON_THE_WAY = (0.25, 0.5, 0.75, 1.0)
"""Shares of a recovery's way at which its room is looked at: the lidar may not see behind the robot."""


@dataclass(frozen=True, eq=False)
class Tools:
    """What a runner uses; the same for all goals of a run."""

    model: RobotModel
    controller: Controller
    monitor: CollisionMonitor
    obstacles: ObstacleLayer
    plan: PlanConfig
    checker: GoalCheckerConfig
    recovery: RecoveryConfig
    publisher: BagWriter
    """Where goals and plans are written."""
    seed: int
    """Of the plans."""

    @functools.cached_property
    def samples(self) -> FootprintSamples:
        """Points of the footprint."""
        return sample_footprint(self.model)

    def passed(self, wanted: Twist, tick: Tick) -> float:
        """Factor 0..1 for a command, by the points seen and by the map."""
        if tick.stop:
            return 0.0
        costmap = self.obstacles.static
        factor = self.monitor.limit(wanted, tick.points_base)
        if factor > 0.0:
            x, y, yaw = (costmap.T_grid_map @ tick.pose).xyt.tolist()
            on_map = self.monitor.limit_on_map(wanted, costmap.clearance, costmap.resolution, x, y, yaw)
            factor = min(factor, on_map)
        return factor

    def room_after(self, twist: Twist, amount: float, tick: Tick) -> float:
        """Room round the footprint [m] after a twist over an amount [m or rad]; -inf when it is held."""
        if self.passed(twist, tick) <= 0.5:
            return -np.inf
        costmap = self.obstacles.costmap
        x, y, yaw = (costmap.T_grid_map @ tick.pose).xyt.tolist()
        taken = amount / max(abs(twist.v), abs(twist.w))
        poses = [moved(x, y, yaw, twist.v, twist.w, share * taken) for share in ON_THE_WAY]
        rooms = [
            float(footprint_clearance(costmap.clearance, costmap.resolution, self.samples, *pose))
            for pose in ((x, y, yaw), *poses)
        ]
        return -np.inf if min(rooms) < min(rooms[0], PADDING_M) else rooms[-1]


@dataclass(frozen=True)
class Verdict:
    """The outcome of a goal."""

    status: Status
    reason: str = ""


@dataclass(frozen=True, eq=False)
class _Route:
    """A path, when and on which map it was planned, and whether it ends short of the goal."""

    poses: SE2
    planned_ns: int
    static: Costmap
    short: bool


class _Recovery:
    """Recovery manoeuvres of a robot without progress, and whether it has made progress since."""

    def __init__(self, tools: Tools) -> None:
        self.ladder = Ladder(tools.recovery, tools.obstacles.clear)
        self.watch = ProgressWatch(tools.recovery.stuck_time)
        self._manoeuvre: Manoeuvre | None = None
        self._tools = tools
        self._driven = 0.0
        self._at: SE2 | None = None

    @property
    def name(self) -> str:
        """Of the manoeuvre under way, for the run log."""
        return "" if self._manoeuvre is None else self._manoeuvre.name

    def note(self, pose: SE2) -> None:
        """Count the distance driven: after enough of it the sequence starts over."""
        if self._at is not None:
            self._driven += math.dist(pose.xy, self._at.xy)
        self._at = pose
        if self._driven > PROGRESS_M and self._manoeuvre is None:
            self._driven = 0.0
            self.ladder.rest()

    def start(self, tick: Tick) -> bool:
        """Begin the next manoeuvre, if there is one left."""
        self.watch.reset()
        self._driven = 0.0
        room = functools.partial(self._tools.room_after, tick=tick)
        self._manoeuvre = self.ladder.climb(tick.now_ns, tick.pose, room)
        return self._manoeuvre is not None

    def command(self, tick: Tick) -> Twist | None:
        """The manoeuvre's command; None when it is over."""
        command = None if self._manoeuvre is None else self._manoeuvre.command(tick.now_ns, tick.pose)
        if command is None:
            self._manoeuvre = None
            self.watch.reset()
        return command


class GoalRunner:
    """One goal, in the frame of the obstacle layer's costmap.

    It drives the machine through the states of `PURSUE`; one that has none of its own begins in `PLAN`.
    """

    def __init__(self, tools: Tools, goal: SE2, seed: int, machine: Machine | None = None) -> None:
        self.tools = tools
        self.goal = goal
        self.state = State.PLAN.value
        """What it was doing in the last tick, for the run log."""
        self._machine = machine or Machine(State.PLAN)
        self._seed = seed
        self._plans = 0
        self._checker = GoalChecker(tools.checker, goal)
        self._recovery = _Recovery(tools)
        self._route: _Route | None = None

    def step(self, tick: Tick) -> tuple[Twist, Verdict | None]:
        """The next command, and the verdict when the pursuit is over."""
        controller, recovery, machine = self.tools.controller, self._recovery, self._machine
        recovery.note(tick.pose)
        if self._checker.reached(tick.now_ns, tick.pose, tick.measured):
            return controller.brake(tick.last), Verdict("reached")
        if machine.within(State.RECOVER):
            wanted = recovery.command(tick)
            if wanted is not None:
                self.state = recovery.name
                return self._guarded(wanted, tick), None
            machine.on(Event.RECOVERY)
        elif self._route is not None and tick.new_sweep and self._blocked(self._route, tick):
            machine.on(Event.OBSTACLE)
        if machine.state is State.PLAN:
            verdict = self._plan(tick)
            if verdict is not None or machine.state is not State.FOLLOW:
                return controller.brake(tick.last), verdict
        wanted = controller.command(tick.pose, tick.last, self.tools.obstacles.costmap)
        self.state = str(controller.state)
        return self._guarded(wanted, tick), self._held_up(tick, wanted)

    @property
    def recovering(self) -> bool:
        """Whether it is in trouble and has made no progress since."""
        return self._recovery.ladder.climbed

    def rest(self) -> None:
        """Time passes in which the robot is not supposed to move."""
        self._recovery.watch.reset()

    def _plan(self, tick: Tick) -> Verdict | None:
        """Plan a new path; without one the robot recovers, or gives up if there never was one."""
        t, self._route = self.tools, None
        self._plans += 1
        radius = t.model.circumscribed_radius + min(t.plan.margins)
        t.obstacles.let_out(tick.pose, radius)
        try:
            aim = t.obstacles.aim(tick.pose, self.goal, radius)
            seed = self._seed + 1000 * self._plans
            plan = plan_path(t.obstacles.costmap, t.model, tick.pose, aim, t.plan, seed)
        except NoPath as error:
            self.state = State.PLAN.value
            if not t.obstacles.marked:
                return Verdict("unreachable", str(error))
            return self._recover(tick, f"blocked by an unmapped obstacle: {error}")
        self._route = _Route(plan.poses, tick.now_ns, t.obstacles.static, t.obstacles.stands_in(self.goal))
        t.controller.set_path(plan.poses)
        t.publisher.plan(tick.now_ns, plan.poses)
        self._machine.on(Event.PATH)
        return None

    def _blocked(self, route: _Route, tick: Tick) -> bool:
        """Whether observed obstacles block the path ahead, or it ends at the edge of a window that has moved
        on.

        An obstacle blocks it where the monitor would stop the footprint.
        """
        obstacles = self.tools.obstacles
        if obstacles.static is not route.static and route.short:
            return True
        if not obstacles.marked or tick.now_ns - route.planned_ns < nanoseconds(obstacles.marking.replan_s):
            return False
        costmap = obstacles.costmap
        poses = np.ascontiguousarray((costmap.T_grid_map @ route.poses).xyt)
        x, y, _ = (costmap.T_grid_map @ tick.pose).xyt.tolist()
        clearance = path_clearance(
            costmap.clearance, costmap.resolution, self.tools.samples, poses, x, y, LOOK_AHEAD_M
        )
        return bool(clearance < PADDING_M)

    def _guarded(self, wanted: Twist, tick: Tick) -> Twist:
        """The command as limited by the collision monitor."""
        factor, machine = self.tools.passed(wanted, tick), self._machine
        if factor == 0.0:
            machine.on(Event.STOP)
            self.state = State.HELD.value
        elif machine.state in (State.HELD, State.RECOVER_HELD):
            machine.on(Event.RELEASE)
        if factor >= 1.0:
            return wanted
        return slowed(self.tools.controller, wanted, factor, tick.last)

    def _held_up(self, tick: Tick, wanted: Twist) -> Verdict | None:
        """Recovery if the monitor holds the robot, or if it makes no progress."""
        moving = abs(wanted.v) > STOPPED_V or abs(wanted.w) > STOPPED_W
        if moving and self._recovery.watch.stuck(tick.now_ns, tick.pose):
            return self._recover(tick, "stuck: the robot made no progress")
        if not moving:
            self._recovery.watch.reset()
        return None

    def _recover(self, tick: Tick, trouble: str) -> Verdict | None:
        """Begin the next manoeuvre; a verdict when there is none left."""
        if not self._recovery.start(tick):
            used = self._recovery.ladder.used
            return Verdict("unreachable", f"{trouble}; given up after {used} recoveries")
        self._route = None
        self._machine.on(Event.TROUBLE)
        return None
