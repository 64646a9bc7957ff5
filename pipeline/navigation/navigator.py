"""The driver of `goal` and `patrol`: localises, and runs the goals one after another.

Without a localiser (mapless goals) it trusts odometry: goals and costmap are in the odometry frame.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal

from turtlebag.datasets.se2 import SE2
from turtlebag.datasets.types import Observation, Twist
from turtlebag.pipeline.navigation.driver import Driver
from turtlebag.pipeline.navigation.goal_runner import GoalRunner, Tools, Verdict
from turtlebag.pipeline.navigation.moving_obstacles import MovingWatch
from turtlebag.pipeline.navigation.online_localiser import OnlineLocaliser
from turtlebag.pipeline.navigation.relocalisation import Relocaliser
from turtlebag.pipeline.navigation.relocalisation_states import State
from turtlebag.pipeline.navigation.sensing import Sensing
from turtlebag.planners.control.goal_checker import STOPPED_V
from turtlebag.planners.global_plan import fits
from turtlebag.planners.tasks.patrol import GoalSequence

PATIENCE_S = 30.0
"""Time without a scan after which the goals are given up (not measured)."""
LOST = "the robot no longer knows where it is"
ALIKE = "two places on the map look alike, and no reachable view distinguishes them"


@dataclass
class _Pursuit:
    """A goal, how often it only seemed to have ended, and its runner; None until it is planned (again)."""

    goal: SE2
    doubted: int = 0
    runner: GoalRunner | None = None


class NavigationDriver(Driver):
    """Drives on a map, or mapless without a `relocaliser`."""

    def __init__(
        self, tools: Tools, sensing: Sensing, sequence: GoalSequence, relocaliser: Relocaliser | None = None
    ) -> None:
        super().__init__(sensing)
        self.tools, self.sequence, self.relocaliser = tools, sequence, relocaliser
        self._moving = MovingWatch(tools.model)
        self._pursuit: _Pursuit | None = None
        self._now = 0

    def step(self, observation: Observation) -> Twist:
        """Localise, get the current goal, and run it."""
        now, relocaliser = observation.stamp_ns, self.relocaliser
        span_ns, self._now = now - self._now, now
        sweep = self.sensing.observe(observation)
        T_frame_odom = self._localise(observation)
        if relocaliser is not None and not relocaliser.localiser.amcl.initialised:
            self.sequence.close_all("rejected", "no initial pose", now)
            return self._stop("no_pose", finished=True)
        if relocaliser is not None and sweep is not None:
            self._moving.observe(sweep)
        if self.sensing.blind:
            return self._wait_for_scan(now)
        if relocaliser is not None:
            state = relocaliser.update(observation, examine=not self.sequence.finished)
            if relocaliser.void:
                self._forget()
                T_frame_odom = self._localised(relocaliser.localiser, observation)
            if state is not State.DRIVE and not self.sequence.finished:
                return self._find(relocaliser, state, observation, span_ns)
        if sweep is not None and T_frame_odom is not None:
            self._see(sweep, T_frame_odom, self.tools.obstacles)
        goal = self.sequence.update(now)
        self.goal_index = self.sequence.index if goal is not None else -1
        if self.sequence.finished:
            return self._stop("done", finished=abs(self._last.v) <= STOPPED_V)
        if goal is None or T_frame_odom is None:
            self._forget_route()
            return self._stop("wait")
        if self._pursuit is None or goal is not self._pursuit.goal:
            self._pursuit = _Pursuit(goal)
        return self._pursue(self._pursuit, observation, T_frame_odom @ observation.odometry.T_odom_base)

    def begin(self, sequence: GoalSequence) -> None:
        """Replace the goals from the next step on; localisation continues."""
        self.sequence, self._pursuit, self.finished = sequence, None, False
        if self.relocaliser is not None:
            self.relocaliser.accept()

    def told(self, T_map_base: SE2 | Literal["global"], T_odom_base: SE2) -> None:
        """Set a pose estimate, or start global localisation; obstacles seen from the old pose are dropped."""
        assert self.relocaliser is not None
        self.relocaliser.localiser.tell(T_map_base, T_odom_base)
        self.relocaliser.told(State.WIGGLE if T_map_base == "global" else State.DRIVE)
        self._forget()

    def use(self, tools: Tools) -> None:
        """Replace the tools from the next step on, for example after a change of the costmap."""
        self.tools = tools
        if self.relocaliser is not None:
            self.relocaliser.tools = tools
        self._forget_route()

    def stand_by(self, observation: Observation) -> None:
        """Keep localising and sensing during a teleop override; the goal's clock stops."""
        sweep = self.sensing.observe(observation)
        if self.relocaliser is None or self.relocaliser.localiser.amcl.initialised:
            T_frame_odom = self._localise(observation)
            if sweep is not None and T_frame_odom is not None:
                self._see(sweep, T_frame_odom, self.tools.obstacles)
        self.sequence.postpone(observation.stamp_ns - self._now)
        self._now = observation.stamp_ns

    def resume(self, last: Twist) -> None:
        """Plan the goal again from where teleop has brought the robot."""
        super().resume(last)
        self._forget_route()
        if self.relocaliser is not None:
            self.relocaliser.rest()

    def _wait_for_scan(self, now: int) -> Twist:
        """Stand still; goals still time out, and are given up if the lidar stays silent."""
        self._rest()
        self.sequence.update(now, "the lidar is silent")
        if self.sensing.silent_s > PATIENCE_S:
            reason = f"the lidar has been silent for {PATIENCE_S:g} s"
            self.sequence.close_all("unreachable", reason, now)
        return self._stop("blind", finished=self.sequence.finished)

    def _find(self, relocaliser: Relocaliser, state: State, observation: Observation, span_ns: int) -> Twist:
        """The command while the robot does not drive to its goal; a goal may be given up meanwhile."""
        now, sequence = observation.stamp_ns, self.sequence
        self.state = state.value
        if state is State.DISAMBIGUATE:
            return self._disambiguate(relocaliser, observation, span_ns)
        if state is State.GIVE_UP and sequence.goal is not None:
            sequence.close("unreachable", LOST, now)
        elif state is not State.WIGGLE:
            goal = sequence.update(now, LOST)
            self.goal_index = sequence.index if goal is not None else -1
        if self._moving.stops(observation.odometry.T_odom_base):
            self._last = self.tools.controller.brake(self._last)
        else:
            self._last = relocaliser.turn_or_roam(observation, self._last, self.sensing)
        return self._last

    def _disambiguate(self, relocaliser: Relocaliser, observation: Observation, span_ns: int) -> Twist:
        """Drive to decide between the hypotheses while the goal's clock is stopped.

        A goal is given up if nothing has decided between them in time.
        """
        now, T_map_odom = observation.stamp_ns, relocaliser.localiser.T_map_odom
        assert relocaliser.disambiguation is not None
        assert T_map_odom is not None
        if self.sequence.goal is not None:
            self.sequence.postpone(span_ns)
        goal = self.sequence.update(now)
        self.goal_index = -1 if goal is None else self.sequence.index
        if observation.scan is not None and self.sensing.sweep is not None:
            self._see(self.sensing.sweep, T_map_odom, relocaliser.disambiguation.tools.obstacles)
        T_odom_base = observation.odometry.T_odom_base
        stop = self._moving.stops(T_odom_base)
        tick = self._tick(observation, T_map_odom @ T_odom_base, stop=stop)
        command = relocaliser.disambiguate(tick, observation, self.sensing.sweep)
        if relocaliser.void:
            self._forget()
        if command is not None:
            self._last = command
            return command
        if goal is not None:
            self.sequence.close("unreachable", ALIKE, now)
        relocaliser.disambiguation.begin_again(now)
        self._last = self.tools.controller.brake(self._last)
        return self._last

    def _forget(self) -> None:
        """Drop plans and obstacles from a wrong pose."""
        self.tools.obstacles.clear()
        self._forget_route()

    def _forget_route(self) -> None:
        if self._pursuit is not None:
            self._pursuit.runner = None

    def _rest(self) -> None:
        """Standing still now does not count as lack of progress."""
        if self._pursuit is not None and self._pursuit.runner is not None:
            self._pursuit.runner.rest()

    def _localise(self, observation: Observation) -> SE2 | None:
        """The odometry frame in the frame of goals and costmap; None while it is unknown."""
        if self.relocaliser is None:
            return SE2.identity()
        self.relocaliser.localiser.observe(observation)
        return self._localised(self.relocaliser.localiser, observation)

    def _localised(self, localiser: OnlineLocaliser, observation: Observation) -> SE2 | None:
        """Use the localiser's pose, which jumps when the estimate is moved to another place."""
        self.estimate = localiser.T_map_base(observation.odometry.T_odom_base)
        return localiser.T_map_odom

    def _pursue(self, pursuit: _Pursuit, observation: Observation, pose: SE2) -> Twist:
        """The next step to a goal; one in an obstacle or off the map is rejected."""
        now, obstacles = observation.stamp_ns, self.tools.obstacles
        if pursuit.runner is None:
            self.tools.publisher.goal(now, pursuit.goal)
            if not obstacles.stands_in(pursuit.goal) and not fits(
                obstacles.static, self.tools.model, pursuit.goal
            ):
                self.sequence.close("rejected", "the goal is in an obstacle or off the map", now)
                return self._stop("wait")
            seed = self.tools.seed + 1_000_000 * self.sequence.index
            pursuit.runner = GoalRunner(self.tools, pursuit.goal, seed)
        stop = self._moving.stops(observation.odometry.T_odom_base)
        self._last, verdict = pursuit.runner.step(self._tick(observation, pose, stop=stop))
        self.state = pursuit.runner.state
        if verdict is not None:
            self._judge(pursuit, verdict, pose, now)
        return self._last

    def _judge(self, pursuit: _Pursuit, verdict: Verdict, T_map_base: SE2, now: int) -> None:
        """End the goal, unless it only seems reached or unreachable because the robot is elsewhere.

        Where the robot believes it has arrived, the newest scan must not contradict that; where it believes
        it stands in a wall of the map, it is wrong before any scan says so. It then looks around, a limited
        number of times; a goal that scans still contradict is not reached.
        """
        arrived, doubtful = verdict.status == "reached", False
        if self.relocaliser is not None:
            localiser = self.relocaliser.localiser
            doubtful = not fits(self.tools.obstacles.static, self.tools.model, T_map_base)
            doubtful = doubtful or (localiser.contradicted if arrived else localiser.amcl.lost)
            if doubtful and pursuit.doubted < self.relocaliser.machine.config.restarts:
                pursuit.doubted += 1
                self.relocaliser.doubt(now)
                self._forget()
                return
        if doubtful and arrived:
            verdict = Verdict("unreachable", LOST)
        self.sequence.close(verdict.status, verdict.reason, now)
        self._forget_route()
        self.state = verdict.status

    def _stop(self, state: str, *, finished: bool = False) -> Twist:
        """Brake to a standstill."""
        self.state, self.finished = state, finished
        self._last = self.tools.controller.brake(self._last)
        return self._last
