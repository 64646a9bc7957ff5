"""The driver of `goal` and `patrol`: localises, and runs the goals one after another.

Without a localiser (mapless goals) it trusts odometry: goals and costmap are in the odometry frame.
"""

from __future__ import annotations

from typing import Literal

from turtlebag.datasets.se2 import SE2
from turtlebag.datasets.types import Observation, Twist
from turtlebag.pipeline.navigation.driver import Driver
from turtlebag.pipeline.navigation.goal_runner import GoalRunner, Tools, Verdict
from turtlebag.pipeline.navigation.goal_states import Action, Event, Machine, State, Suspension
from turtlebag.pipeline.navigation.obstacle_memory import ObstacleMemory
from turtlebag.pipeline.navigation.online_localiser import OnlineLocaliser
from turtlebag.pipeline.navigation.relocalisation import Relocaliser
from turtlebag.pipeline.navigation.sensing import Sensing
from turtlebag.planners.control.goal_checker import STOPPED_V
from turtlebag.planners.global_plan import fits
from turtlebag.planners.tasks.patrol import GoalSequence

PATIENCE_S = 30.0
"""Time without a scan after which the goals are given up (not measured)."""
LOST = "the robot no longer knows where it is"
ALIKE = "two places on the map look alike, and no reachable view distinguishes them"
REASONS = {Action.REPORT_LOST: LOST, Action.REPORT_ALIASES: ALIKE}


class NavigationDriver(Driver):
    """Drives on a map, or mapless without a `relocaliser`."""

    def __init__(
        self,
        tools: Tools,
        sensing: Sensing,
        sequence: GoalSequence,
        memory: ObstacleMemory,
        relocaliser: Relocaliser | None = None,
    ) -> None:
        super().__init__(sensing)
        self.tools, self.sequence, self.relocaliser = tools, sequence, relocaliser
        self.machine = Machine() if relocaliser is None else relocaliser.machine
        self.machine.perform = self._perform
        self._memory = memory
        self._runner: GoalRunner | None = None
        self._goal: SE2 | None = None
        self._doubts = 0  # how often the goal only seemed to have ended
        self._now = 0

    @property
    def localiser(self) -> OnlineLocaliser | None:
        """What estimates the pose on the map; None without a map."""
        return None if self.relocaliser is None else self.relocaliser.localiser

    def step(self, observation: Observation) -> Twist:
        """Localise, bring the machine to this tick's state, and do what that asks for."""
        now, relocaliser, machine = observation.stamp_ns, self.relocaliser, self.machine
        span_ns, self._now = now - self._now, now
        sweep, active = self.sensing.observe(observation), not self.sequence.finished
        if self.localiser is not None:
            self.localiser.observe(observation)
        T_frame_odom = self._frame(observation)
        if relocaliser is not None and not relocaliser.localiser.amcl.initialised:
            self.sequence.close_all("rejected", "no initial pose", now)
            return self._stop(Suspension.NO_POSE, finished=True)
        if relocaliser is not None and sweep is not None:
            self._memory.observe(sweep)
        if self.sensing.blind:
            return self._wait_for_scan(now)
        if relocaliser is not None:
            relocaliser.update(observation, examine=active)
            T_frame_odom = self._frame(observation)
            if machine.within(State.LOST) and active:
                return self._find(relocaliser, observation, span_ns)
        if sweep is not None and T_frame_odom is not None:
            self._see(sweep, T_frame_odom, self.tools.obstacles)
        goal = self._next_goal(now)
        if self.sequence.finished:
            machine.on(Event.END)
            return self._stop(State.DONE, finished=abs(self._last.v) <= STOPPED_V)
        if goal is None or T_frame_odom is None:
            machine.on(Event.RESET)
            return self._stop(State.WAIT)
        return self._pursue(goal, observation, T_frame_odom @ observation.odometry.T_odom_base)

    def begin(self, sequence: GoalSequence) -> None:
        """Replace the goals from the next step on; localisation continues."""
        self.sequence, self._goal, self.finished = sequence, None, False
        self.machine.on(Event.RESET)
        if self.relocaliser is not None:
            self.relocaliser.accept()

    def locate(self, T_map_base: SE2 | Literal["global"], T_odom_base: SE2) -> None:
        """Set a pose estimate, or start global localisation; obstacles seen from the old pose are dropped."""
        assert self.relocaliser is not None
        self.relocaliser.localiser.tell(T_map_base, T_odom_base)
        self.relocaliser.locate(Event.SEARCH if T_map_base == "global" else Event.POSE)

    def use(self, tools: Tools) -> None:
        """Replace the tools from the next step on, for example after a change of the costmap."""
        self.tools = tools
        if self.relocaliser is not None:
            self.relocaliser.tools = tools
        self.machine.on(Event.RESET)

    def stand_by(self, observation: Observation) -> None:
        """Keep localising and sensing during a teleop override; the goal's clock stops."""
        sweep = self.sensing.observe(observation)
        if self.localiser is not None:
            self.localiser.observe(observation)
        T_frame_odom = self._frame(observation)
        if sweep is not None and T_frame_odom is not None:
            self._see(sweep, T_frame_odom, self.tools.obstacles)
        self.sequence.postpone(observation.stamp_ns - self._now)
        self._now = observation.stamp_ns

    def resume(self, last: Twist) -> None:
        """Plan the goal again from where teleop has brought the robot."""
        super().resume(last)
        self.machine.on(Event.RESET)
        if self.relocaliser is not None:
            self.relocaliser.rest()

    def _perform(self, action: Action) -> None:
        """An action of the machine's table."""
        if action is Action.FORGET:
            self.tools.obstacles.clear()
        elif action is Action.SPREAD:
            assert self.relocaliser is not None
            self.relocaliser.localiser.amcl.initialise_globally()
        elif self.sequence.goal is not None:
            self.sequence.close("unreachable", REASONS[action], self._now)

    def _wait_for_scan(self, now: int) -> Twist:
        """Stand still; goals still time out, and are given up if the lidar stays silent."""
        if self._runner is not None:
            self._runner.rest()
        self.sequence.update(now, "the lidar is silent")
        if self.sensing.silent_s > PATIENCE_S:
            reason = f"the lidar has been silent for {PATIENCE_S:g} s"
            self.sequence.close_all("unreachable", reason, now)
        return self._stop(Suspension.BLIND, finished=self.sequence.finished)

    def _find(self, relocaliser: Relocaliser, observation: Observation, span_ns: int) -> Twist:
        """The command of a lost robot; while it decides between hypotheses, the goal's clock is stopped."""
        state, T_odom_base, sweep = self.machine.state, observation.odometry.T_odom_base, self.sensing.sweep
        drive = relocaliser.disambiguation
        if drive is not None and self.sequence.goal is not None:
            self.sequence.postpone(span_ns)
        if state not in (State.WIGGLE, State.GIVE_UP):
            self._next_goal(observation.stamp_ns, LOST if drive is None else "")
        T_map_odom = relocaliser.localiser.T_map_odom or SE2.identity()
        if drive is not None and observation.scan is not None and sweep is not None:
            self._see(sweep, T_map_odom, drive.tools.obstacles)
        tick = self._tick(observation, T_map_odom @ T_odom_base, stop=self._memory.stops(T_odom_base))
        self.state, self._last = state.value, relocaliser.command(tick, T_odom_base, sweep)
        return self._last

    def _next_goal(self, now: int, trouble: str = "") -> SE2 | None:
        """The goal of this tick; `trouble` is added to the reason if time is over for the last one."""
        goal = self.sequence.update(now, trouble)
        self.goal_index = self.sequence.index if goal is not None else -1
        return goal

    def _frame(self, observation: Observation) -> SE2 | None:
        """The odometry frame in the frame of goals and costmap; None while it is unknown.

        It jumps when the localiser's estimate is moved to another place.
        """
        if self.localiser is None:
            return SE2.identity()
        self.estimate = self.localiser.T_map_base(observation.odometry.T_odom_base)
        return self.localiser.T_map_odom

    def _pursue(self, goal: SE2, observation: Observation, pose: SE2) -> Twist:
        """The next step to a goal; one in an obstacle or off the map is rejected."""
        now, tools, machine = observation.stamp_ns, self.tools, self.machine
        if goal is not self._goal:
            self._goal, self._doubts = goal, 0
            machine.on(Event.RESET)
        if self._runner is None or machine.state is State.WAIT:
            tools.publisher.goal(now, goal)
            static = tools.obstacles.static
            if not tools.obstacles.stands_in(goal) and not fits(static, tools.model, goal):
                self.sequence.close("rejected", "the goal is in an obstacle or off the map", now)
                return self._stop(State.WAIT)
            self._runner = GoalRunner(tools, goal, tools.seed + 1_000_000 * self.sequence.index, machine)
            machine.on(Event.GOAL)
        stop = self._memory.stops(observation.odometry.T_odom_base)
        self._last, verdict = self._runner.step(self._tick(observation, pose, stop=stop))
        self.state = self._runner.state
        if verdict is not None:
            self._judge(verdict, pose, now)
        return self._last

    def _judge(self, verdict: Verdict, T_map_base: SE2, now: int) -> None:
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
            if doubtful and self._doubts < self.relocaliser.watch.config.restarts:
                self._doubts += 1
                self.relocaliser.doubt(now)
                return
        if doubtful and arrived:
            verdict = Verdict("unreachable", LOST)
        self.sequence.close(verdict.status, verdict.reason, now)
        self.machine.on(Event.OUTCOME)
        self.state = verdict.status

    def _stop(self, state: State | Suspension, *, finished: bool = False) -> Twist:
        """Brake to a standstill."""
        self.state, self.finished = state.value, finished
        self._last = self.tools.controller.brake(self._last)
        return self._last
