"""Relocalisation of a lost robot: events for the state machine, and commands for its states of `LOST`."""

from __future__ import annotations

import numpy as np

from turtlebag.datasets.se2 import SE2
from turtlebag.datasets.types import Observation, Twist
from turtlebag.pipeline.localisation.pose_hypotheses import Aliasing, apart
from turtlebag.pipeline.navigation.disambiguation import Disambiguation
from turtlebag.pipeline.navigation.goal_runner import Tick, Tools
from turtlebag.pipeline.navigation.goal_states import Event, State
from turtlebag.pipeline.navigation.guarded_avoidance import GuardedAvoidance
from turtlebag.pipeline.navigation.online_localiser import OnlineLocaliser
from turtlebag.pipeline.navigation.pose_watch import PoseWatch
from turtlebag.pipeline.navigation.sensing import DeskewedScan
from turtlebag.planners.tasks.wiggle import Wiggle

JUMP = 0.25
"""An estimate that moves more than this [m or rad] with one scan was wrong before (not measured)."""
MOVED_STD = 0.05
"""Standard deviation [m and rad] of an estimate that was moved to the right hypothesis (not measured)."""


class Relocaliser:
    """Watches the localiser, and drives while the robot is lost."""

    def __init__(
        self,
        watch: PoseWatch,
        localiser: OnlineLocaliser,
        aliasing: Aliasing,
        tools: Tools,
        avoidance: GuardedAvoidance,
    ) -> None:
        self.watch = watch
        self.machine = watch.machine
        self.localiser = localiser
        self.disambiguation: Disambiguation | None = None
        """The drive that decides between pose hypotheses, while there are any."""
        self.tools = tools
        """Controller, costmap and planner."""
        self._aliasing, self._avoidance, self._wiggle = aliasing, avoidance, Wiggle()
        self._searches = 0  # whose result has been examined
        self._judged = 0  # filter updates by which the hypotheses have been judged
        self._T_map_odom: SE2 | None = None

    def update(self, observation: Observation, *, examine: bool) -> None:
        """Bring the machine to this tick's state; pose hypotheses are generated if there is a goal to
        `examine` them for."""
        now, machine, localiser = observation.stamp_ns, self.machine, self.localiser
        before = machine.state
        if before is State.WIGGLE:
            return
        driving = machine.within(State.DRIVE)
        if self._jumped(observation.odometry.T_odom_base):
            trusted = driving or before is State.DISAMBIGUATE
            if trusted and localiser.updates > 0:
                self.doubt(now)
            else:
                machine.on(Event.JUMP)
        if localiser.updates > 0 or not driving:
            self.watch.update(now, localiser.amcl.converged, localiser.amcl.agrees, localiser.updates)
        if machine.within(State.DRIVE) and examine:
            self._examine(now)
        elif machine.state is not State.DISAMBIGUATE and self.disambiguation is not None:
            self.disambiguation, self._searches = None, -1
        if machine.state is not before:
            self._begin_again()

    def locate(self, event: Event) -> None:
        """A pose estimate was set, or global localisation started: earlier doubts are void."""
        self.machine.on(event)
        self.watch.reset()
        self.disambiguation, self._searches = None, self.localiser.amcl.searches
        self.accept()
        self._begin_again()

    def accept(self) -> None:
        """Past jumps of the estimate are no reason for doubt."""
        self._T_map_odom = self.localiser.T_map_odom

    def doubt(self, now_ns: int) -> None:
        """Other evidence of being lost: look around at once."""
        self.watch.on(Event.DOUBT, now_ns, self.localiser.updates)

    def rest(self) -> None:
        """A teleop override has ended."""
        if self.disambiguation is not None:
            self.disambiguation.rest()

    def command(self, tick: Tick, T_odom_base: SE2, sweep: DeskewedScan | None) -> Twist:
        """The command while lost: without the map, avoiding obstacles by the scans."""
        state, brake = self.machine.state, self.tools.controller.brake
        if state is State.DISAMBIGUATE:
            return self._disambiguate(tick, T_odom_base, sweep)
        if tick.stop:
            return brake(tick.last)
        if state is State.ROAM and sweep is not None:
            return self._roam(tick, T_odom_base, sweep)
        if state in (State.WIGGLE, State.LOOK):
            return self._turn(tick)
        return brake(tick.last)

    def _turn(self, tick: Tick) -> Twist:
        """Back and forth as far as there is room; the end of WIGGLE is an event."""
        amcl, wiggling = self.localiser.amcl, self.machine.state is State.WIGGLE
        turn = self._wiggle.command(tick.now_ns, wiggling and amcl.converged)
        if turn is None and wiggling:
            lost = self._wiggle.gave_up and amcl.lost
            self.watch.on(Event.DOUBT if lost else Event.CERTAINTY, tick.now_ns, self.localiser.updates)
            self._wiggle = Wiggle()
        if turn is None:
            return self.tools.controller.brake(tick.last)
        factor = self.tools.monitor.limit(turn, tick.points_base)
        return self.tools.controller.ramp(Twist(0.0, turn.w * factor), tick.last)

    def _roam(self, tick: Tick, T_odom_base: SE2, sweep: DeskewedScan) -> Twist:
        wanted = self._avoidance.command(sweep, T_odom_base, tick.last, new_sweep=tick.new_sweep)
        return self.tools.controller.ramp(wanted, tick.last)

    def _disambiguate(self, tick: Tick, T_odom_base: SE2, sweep: DeskewedScan | None) -> Twist:
        """Drive to decide between the hypotheses, until one is left or it has taken too long."""
        drive, watch, updates = self.disambiguation, self.watch, self.localiser.updates
        assert drive is not None
        brake = self.tools.controller.brake(tick.last)
        if updates > self._judged:
            self._judged = updates
            hypothesis = drive.judge(self.localiser)
            if hypothesis is not None:
                self.disambiguation = None
                watch.on(Event.DECISION, tick.now_ns, updates)
                self._move_to(hypothesis)
                return brake
        if drive.over(tick.now_ns, watch.config.disambiguate):
            self.machine.on(Event.TIMEOUT)
            drive.begin_again(tick.now_ns)
            return brake
        command = drive.command(tick)
        if command is None and not tick.stop and sweep is not None:
            return self._roam(tick, T_odom_base, sweep)
        return brake if command is None else command

    def _begin_again(self) -> None:
        """Another state: what the last one was doing is over."""
        self._wiggle = Wiggle()
        self._avoidance.interrupted()

    def _jumped(self, T_odom_base: SE2) -> bool:
        """Whether the estimate has moved by anything but odometry since the last call.

        The robot then looks around before it drives on with the new estimate.
        """
        before, self._T_map_odom = self._T_map_odom, self.localiser.T_map_odom
        if before is None or self._T_map_odom is None or before is self._T_map_odom:
            return False
        return apart(before @ T_odom_base, self._T_map_odom @ T_odom_base, JUMP)

    def _examine(self, now_ns: int) -> None:
        """After a search, look for places that look like the estimate's; move it to a clearly better one."""
        localiser = self.localiser
        T_map_odom, keyframes, searches = localiser.T_map_odom, localiser.keyframes, localiser.amcl.searches
        if T_map_odom is None or not keyframes or localiser.amcl.lost or searches <= self._searches:
            return
        self._searches = searches
        hypotheses = self._aliasing.find(keyframes, T_map_odom)
        if len(hypotheses) > 1:
            self.disambiguation = Disambiguation(self._aliasing, hypotheses, self.tools, now_ns)
            self._judged = localiser.updates
            self.watch.on(Event.ALIASES, now_ns, localiser.updates)
        else:
            self._move_to(hypotheses[0])

    def _move_to(self, T_map_map: SE2) -> None:
        """Move the estimate if it is not there already; that is no reason for doubt."""
        if not np.allclose(T_map_map.xyt, 0.0):
            self.localiser.move(T_map_map, MOVED_STD**2 * np.eye(3))
            self._T_map_odom = self.localiser.T_map_odom
            self.machine.on(Event.JUMP)
