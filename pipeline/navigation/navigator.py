"""The driver of `goal` and `patrol`: localises, asks the task where to go, runs goal after goal.

Without a localiser (mapless goals) it trusts odometry: goals and costmap are in the odometry frame.
"""

from __future__ import annotations

from collections.abc import Callable

from turtlebag.datasets.se2 import SE2
from turtlebag.datasets.types import Observation, Twist
from turtlebag.pipeline.navigation.disambiguation import ALIKE, Telling
from turtlebag.pipeline.navigation.goal_runner import GoalRunner, Tools, Verdict
from turtlebag.pipeline.navigation.localiser import Localiser, Publisher
from turtlebag.pipeline.navigation.moving_obstacles import MovingWatch
from turtlebag.pipeline.navigation.seeker import Seeker
from turtlebag.pipeline.navigation.sensing import Sensing, Sight
from turtlebag.planners.global_plan import fits
from turtlebag.planners.live import LiveLayer
from turtlebag.planners.tasks.sequence import GoalSequence
from turtlebag.planners.tasks.wiggle import Wiggle

PATIENCE_S = 30.0
"""Without a scan for so long the goals are given up."""
LOST = "the robot no longer knows where it is"
DOUBTS_PER_GOAL = 2
PUSHED_NS = 2_000_000_000
"""For so long after it was pushed the robot stands still: whoever pushes may not have done yet."""


class NavigationDriver:
    """Drives on a map (see turtlebag.pipeline.navigation.driver)."""

    def __init__(
        self,
        tools: Tools,
        sensing: Sensing,
        localiser: Localiser | None,
        sequence: GoalSequence,
        publisher: Publisher,
        plan_seed: int,
        wiggle: Wiggle | None = None,
        seeker: Seeker | None = None,
        telling: Callable[[Callable[[SE2], None]], Telling] | None = None,
    ) -> None:
        self.tools = tools
        self.sensing = sensing
        self.localiser = localiser
        self.sequence = sequence
        self.state = "wait"
        self.goal_index = -1
        self.finished = False
        self.estimate: SE2 | None = None
        self._publisher = publisher
        self._plan_seed = plan_seed
        self._runner: GoalRunner | None = None
        self._last = Twist()
        self._now = 0
        self._wiggle, self._seeker = wiggle, seeker
        self._telling = None if telling is None else telling(self._publish_plan)
        self._seen_ns = -(10**9)
        self._moving = MovingWatch()
        self._doubted, self._seeking = 0, False
        self._pushes = 0
        self._pushed_ns: int | None = None
        self._goal: SE2 | None = None

    def step(self, observation: Observation) -> Twist:
        """Localise, ask the task for the goal, pursue it."""
        before, self._now = self._now, observation.stamp_ns
        now = self._now
        sight = self.sensing.observe(observation)
        T_frame_odom = self._localise(observation)
        if self.localiser is not None and not self.localiser.amcl.initialised:
            self.sequence.reject_all("no initial pose", now)
            return self._stop("no_pose", finished=True)
        if sight is not None and self.localiser is not None:
            self._moving.observe(sight)
        if self.sensing.blind:
            return self._wait_for_sight(now)
        if self._wiggle is not None and self.localiser is not None:
            return self._look_about(self._wiggle, self.localiser, observation)
        if self._seek(observation) or self._tell_apart(observation, sight, now - before):
            return self._last
        if sight is not None and T_frame_odom is not None:
            self._see(sight, T_frame_odom, self.tools.live)
        goal = self.sequence.update(now)
        self.goal_index = self.sequence.index if goal is not None else -1
        if self.sequence.finished:
            return self._stop("done", finished=abs(self._last.v) < 1e-3)
        if goal is None or T_frame_odom is None:
            self._runner = None
            return self._stop("wait")
        if self._pushed(now):
            return self._stop("pushed")
        if goal is not self._goal:
            self._goal, self._doubted = goal, 0
        if self._runner is None or goal is not self._runner.goal:
            self._runner = self._start(goal, now)
            if self._runner is None:
                return self._stop("wait")
        pose = T_frame_odom @ observation.odometry.T_odom_base
        return self._pursue(self._runner, observation, pose, sight is not None)

    def stand_by(self, observation: Observation) -> None:
        """Localise and look on while someone else drives; the goal's clock stands."""
        sight = self.sensing.observe(observation)
        if self.localiser is None or self.localiser.amcl.initialised:
            T_frame_odom = self._localise(observation)
            if sight is not None and T_frame_odom is not None:
                self._see(sight, T_frame_odom, self.tools.live)
        self.sequence.postpone(observation.stamp_ns - self._now)
        self._now = observation.stamp_ns

    def resume(self, last: Twist) -> None:
        """Pursue the goal anew from where the robot has been brought."""
        self._last, self._runner = last, None
        if self._telling is not None:
            self._telling.rest()

    def _look_about(self, wiggle: Wiggle, localiser: Localiser, observation: Observation) -> Twist:
        """Turn to and fro until the filter knows where it is; goals are given up when it never does."""
        now = observation.stamp_ns
        wanted = wiggle.command(now, localiser.amcl.converged)
        if wanted is None:
            self._wiggle = None
            if wiggle.gave_up and self._seeker is not None and self._seeker.doubts(localiser):
                self._seeker.look_about(now, localiser)
            return self._stop("wiggle")
        self.state = "wiggle"
        points = self.sensing.points_base(observation.odometry.T_odom_base)
        factor = self.tools.monitor.limit(wanted, points)
        self._last = self.tools.controller.ramp(Twist(0.0, wanted.w * factor), self._last)
        return self._last

    def _wait_for_sight(self, now: int) -> Twist:
        """Stand still; goals run out of time, and are given up when the lidar stays silent."""
        if self._runner is not None:
            self._runner.rest()
        self.sequence.update(now, "the lidar is silent")
        if self.sensing.silent_s > PATIENCE_S:
            self.sequence.fail_all(f"the lidar has been silent for {PATIENCE_S:g} s", now)
        return self._stop("blind", finished=self.sequence.finished)

    def _seek(self, observation: Observation) -> bool:
        """Whether the robot is lost, in which case it looks for itself; a goal may be given up for that."""
        seeker, localiser, now = self._seeker, self.localiser, observation.stamp_ns
        if seeker is None or localiser is None:
            return False
        jumped = seeker.jumped(observation, localiser)
        action = seeker.check(now, localiser)
        if jumped or (action != "go" and not self._seeking):
            self._forget()
        if action != "go" and self._telling is not None:
            self._telling.doubt()
        self._seeking = action != "go"
        if not self._seeking:
            return False
        if action == "give_up" and self.sequence.goal is not None:
            self.sequence.close("unreachable", LOST, now)
        elif self.sequence.update(now, LOST) is not None:
            self.goal_index = self.sequence.index
        self.state = action
        moving = self._moving.points_base(observation.odometry.T_odom_base)
        if self.tools.wary.holds(moving):
            self._last = self.tools.controller.brake(self._last)
        else:
            self._last = seeker.command(observation, self._last)
        return True

    def _tell_apart(self, observation: Observation, sight: Sight | None, span_ns: int) -> bool:
        """Whether the robot drives to find out which of two places it is at; its goal's clock stands.

        A goal is given up when there is nothing that tells them apart, or not in time.
        """
        telling, localiser, now = self._telling, self.localiser, observation.stamp_ns
        if telling is None or localiser is None or self.sequence.finished:
            return False
        T_map_odom = localiser.T_map_odom
        if not telling.examine(now, localiser):
            self._follow(T_map_odom, localiser)
            return False
        if self.sequence.goal is not None:
            self.sequence.postpone(span_ns)
        goal = self.sequence.update(now)
        if sight is not None and T_map_odom is not None:
            self._see(sight, T_map_odom, telling.live)
        T_odom_base = observation.odometry.T_odom_base
        points, moving = self.sensing.points_base(T_odom_base), self._moving.points_base(T_odom_base)
        command = telling.step(observation, localiser, self._last, points, sight is not None, moving)
        self.state, self.goal_index = "tell_apart", -1 if goal is None else self.sequence.index
        self._last = self.tools.controller.brake(self._last) if command is None else command
        if command is None:
            if goal is not None:
                self.sequence.close("unreachable", ALIKE, now)
            telling.begin_again(now)
        elif telling.contest is None:
            self._forget()
            self._follow(T_map_odom, localiser)
        return True

    def _follow(self, before: SE2 | None, localiser: Localiser) -> None:
        """Where the estimate has been moved to the right one of two places, that is no reason for doubt."""
        if localiser.T_map_odom is not before:
            self._forget()
            if self._seeker is not None:
                self._seeker.accept(localiser)

    def _forget(self) -> None:
        """Drop what was planned and seen by a pose that was wrong."""
        self.tools.live.clear()
        self._runner = None

    def _localise(self, observation: Observation) -> SE2 | None:
        """Odometry's frame in the frame of goals and costmap; None while it is not known."""
        if self.localiser is None:
            return SE2.identity()
        self.localiser.observe(observation)
        self.estimate = self.localiser.T_map_base(observation.odometry.T_odom_base)
        return self.localiser.T_map_odom

    def _see(self, sight: Sight, T_frame_odom: SE2, live: LiveLayer) -> None:
        if sight.stamp_ns - self._seen_ns < live.config.period * 1e9:
            return
        self._seen_ns = sight.stamp_ns
        live.update(
            sight.stamp_ns * 1e-9,
            T_frame_odom @ sight.T_odom_lidar,
            T_frame_odom @ sight.hits_odom,
            T_frame_odom @ sight.passes_odom,
        )

    def _start(self, goal: SE2, now: int) -> GoalRunner | None:
        """A runner for a new goal; None when the goal is rejected, which is recorded."""
        self._publisher.goal(now, goal)
        live = self.tools.live
        if not live.stands_in(goal) and not fits(live.static, self.tools.model, goal):
            self.sequence.close("rejected", "the goal is in an obstacle or off the map", now)
            return None
        seed = self._plan_seed + 1_000_000 * self.sequence.index
        return GoalRunner(self.tools, goal, seed, self._publish_plan)

    def _publish_plan(self, poses: SE2) -> None:
        self._publisher.plan(self._now, poses)

    def _pursue(self, runner: GoalRunner, observation: Observation, pose: SE2, new_sweep: bool) -> Twist:
        now, odometry = observation.stamp_ns, observation.odometry
        points = self.sensing.points_base(odometry.T_odom_base)
        moving = self._moving.points_base(odometry.T_odom_base)
        self._last, verdict = runner.step(now, pose, odometry.twist, self._last, points, new_sweep, moving)
        self.state = runner.state
        if verdict is not None:
            self._judge(verdict, pose, now)
        return self._last

    def _judge(self, verdict: Verdict, T_map_base: SE2, now: int) -> None:
        """Close the goal, unless it only seems reached, or unreachable, as the robot is elsewhere.

        It looks about then, so often; a goal where the scans still speak against it is not reached.
        """
        arrived = verdict.status == "reached"
        doubtful = False
        if self._seeker is not None and self.localiser is not None:
            in_a_wall = not fits(self.tools.live.static, self.tools.model, T_map_base)
            doubtful = self._seeker.doubts(self.localiser, arrived=arrived, in_a_wall=in_a_wall)
            if doubtful and self._doubted < DOUBTS_PER_GOAL:
                self._doubted += 1
                self._seeker.look_about(now, self.localiser)
                self._forget()
                return
        if doubtful and arrived:
            verdict = Verdict("unreachable", LOST)
        self.sequence.close(verdict.status, verdict.reason, now)
        self._runner = None
        self.state = verdict.status

    def _pushed(self, now: int) -> bool:
        """Whether someone is pushing the robot: it stands still until that is over."""
        pushes = 0 if self.localiser is None else self.localiser.amcl.pushes
        if pushes != self._pushes:
            self._pushes, self._pushed_ns = pushes, now
        if self._pushed_ns is None or now - self._pushed_ns > PUSHED_NS:
            return False
        if self._runner is not None:
            self._runner.rest()
        return True

    def _stop(self, state: str, *, finished: bool = False) -> Twist:
        """Brake to a standstill."""
        self.state, self.finished = state, finished
        self._last = self.tools.controller.brake(self._last)
        return self._last
