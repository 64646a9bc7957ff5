"""Relocalisation of a lost robot: events for `relocalisation_states.py`, and commands for its states."""

from __future__ import annotations

import numpy as np

from turtlebag.datasets.se2 import SE2
from turtlebag.datasets.types import Observation, Twist
from turtlebag.pipeline.localisation.pose_hypotheses import Aliasing, apart
from turtlebag.pipeline.navigation.disambiguation import Disambiguation
from turtlebag.pipeline.navigation.goal_runner import Tick, Tools
from turtlebag.pipeline.navigation.guarded_avoidance import GuardedAvoidance
from turtlebag.pipeline.navigation.online_localiser import OnlineLocaliser
from turtlebag.pipeline.navigation.relocalisation_states import Event, RelocalisationStates, State
from turtlebag.pipeline.navigation.sensing import DeskewedScan, Sensing
from turtlebag.planners.tasks.wiggle import Wiggle

JUMP = 0.25
"""An estimate that moves more than this [m or rad] with one scan was wrong before (not measured)."""
MOVED_STD = 0.05
"""Standard deviation [m and rad] of an estimate that was moved to the right hypothesis (not measured)."""


class Relocaliser:
    """Watches the localiser, and drives while the robot is lost."""

    def __init__(
        self,
        machine: RelocalisationStates,
        localiser: OnlineLocaliser,
        aliasing: Aliasing,
        tools: Tools,
        avoidance: GuardedAvoidance,
    ) -> None:
        self.machine = machine
        self.localiser = localiser
        self.disambiguation: Disambiguation | None = None
        """The drive that decides between pose hypotheses, while there are any."""
        self.void = False
        """Whether plans and obstacles are void because this tick revealed a wrong pose."""
        self.tools = tools
        """Controller, costmap and planner."""
        self._aliasing, self._avoidance, self._wiggle = aliasing, avoidance, Wiggle()
        self._searches = 0  # whose result has been examined
        self._judged = 0  # filter updates by which the hypotheses have been judged
        self._T_map_odom: SE2 | None = None

    def update(self, observation: Observation, *, examine: bool) -> State:
        """The state for this tick; pose hypotheses are generated if there is a goal to `examine` them for."""
        now, machine, localiser = observation.stamp_ns, self.machine, self.localiser
        before, self.void = machine.state, False
        if before is State.WIGGLE:
            return before
        self.void = self._jumped(observation.odometry.T_odom_base)
        driving = before in (State.DRIVE, State.DISAMBIGUATE)
        if self.void and driving and localiser.updates > 0:
            self.doubt(now)
        if machine.state is not State.DRIVE or localiser.updates > 0:
            machine.update(now, localiser.amcl.converged, localiser.amcl.agrees, localiser.updates)
        if machine.state is State.RESTART:
            localiser.amcl.initialise_globally()
        if machine.state not in (State.DRIVE, State.DISAMBIGUATE):
            self.void |= driving
            if self.disambiguation is not None:
                self.disambiguation, self._searches = None, -1
        elif machine.state is State.DRIVE and examine:
            self._examine(now)
        if machine.state is not before:
            self._wiggle = Wiggle()
            self._avoidance.interrupted()
        return machine.state

    def told(self, state: State) -> None:
        """A pose estimate was set, or global localisation started: earlier doubts are void."""
        self.machine, self.disambiguation = RelocalisationStates(self.machine.config, state), None
        self._searches = self.localiser.amcl.searches
        self.accept()
        self._wiggle = Wiggle()
        self._avoidance.interrupted()

    def accept(self) -> None:
        """Past jumps of the estimate are no reason for doubt."""
        self._T_map_odom = self.localiser.T_map_odom

    def doubt(self, now_ns: int) -> None:
        """Other evidence of being lost: look around at once."""
        self.machine.on(Event.DOUBTED, now_ns, self.localiser.updates)

    def rest(self) -> None:
        """A teleop override has ended."""
        if self.disambiguation is not None:
            self.disambiguation.rest()

    def turn_or_roam(self, observation: Observation, last: Twist, sensing: Sensing) -> Twist:
        """The command while lost: without the map, avoiding obstacles by the scans."""
        now, state, T_odom_base = observation.stamp_ns, self.machine.state, observation.odometry.T_odom_base
        controller = self.tools.controller
        if state is State.ROAM and sensing.sweep is not None:
            return self._roam(observation, last, sensing.sweep)
        if state not in (State.WIGGLE, State.LOOK):
            return controller.brake(last)
        amcl, wiggling = self.localiser.amcl, state is State.WIGGLE
        turn = self._wiggle.command(now, wiggling and amcl.converged)
        if turn is None and wiggling:
            lost = self._wiggle.gave_up and amcl.lost
            self.machine.on(Event.DOUBTED if lost else Event.FOUND, now, self.localiser.updates)
            self._wiggle = Wiggle()
        if turn is None:
            return controller.brake(last)
        factor = self.tools.monitor.limit(turn, sensing.points_base(T_odom_base))
        return controller.ramp(Twist(0.0, turn.w * factor), last)

    def _roam(self, observation: Observation, last: Twist, sweep: DeskewedScan) -> Twist:
        T_odom_base, new = observation.odometry.T_odom_base, observation.scan is not None
        wanted = self._avoidance.command(sweep, T_odom_base, last, new_sweep=new)
        return self.tools.controller.ramp(wanted, last)

    def disambiguate(self, tick: Tick, observation: Observation, sweep: DeskewedScan | None) -> Twist | None:
        """The command of active disambiguation; None if it has taken too long."""
        assert self.disambiguation is not None
        if self.localiser.updates > self._judged:
            self._judged = self.localiser.updates
            left = self.disambiguation.judge(self.localiser)
            if left is not None:
                self.disambiguation, self.void = None, True
                self.machine.on(Event.DECIDED, tick.now_ns, self.localiser.updates)
                self._move_to(left)
                return self.tools.controller.brake(tick.last)
        if self.disambiguation.over(tick.now_ns, self.machine.config.disambiguate):
            return None
        command = self.disambiguation.command(tick)
        if command is None and not tick.stop and sweep is not None:
            return self._roam(observation, tick.last, sweep)
        return self.tools.controller.brake(tick.last) if command is None else command

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
        found = self._aliasing.find(keyframes, T_map_odom)
        if len(found) > 1:
            self.disambiguation = Disambiguation(self._aliasing, found, self.tools, now_ns)
            self._judged = localiser.updates
            self.machine.on(Event.ALIASED, now_ns, localiser.updates)
        else:
            self._move_to(found[0])

    def _move_to(self, T_map_map: SE2) -> None:
        """Move the estimate if it is not there already; that is no reason for doubt."""
        if not np.allclose(T_map_map.xyt, 0.0):
            self.localiser.move(T_map_map, MOVED_STD**2 * np.eye(3))
            self._T_map_odom, self.void = self.localiser.T_map_odom, True
