"""Watches the localiser's status, and says when the robot is lost and when it knows where it is again."""

from __future__ import annotations

from typing import ClassVar

from pydantic import Field

from turtlebag.datasets.durations import Seconds, nanoseconds, seconds
from turtlebag.datasets.settings import Settings
from turtlebag.pipeline.localisation.lost_detection import DOUBTS
from turtlebag.pipeline.navigation.goal_states import Event, Machine, State

SETTLED_S = 1.0
"""How long the cloud must be narrow and the scans agree before it drives on: five scans (not measured)."""
TRUST_S = 15.0
"""How long scan agreement is then not checked again: people and boxes are not on the map (not measured)."""


class RelocaliseConfig(Settings, allow_inf_nan=False):
    """Time limits in seconds, and the number of restarts."""

    RENAMED: ClassVar = {"tell_apart": "disambiguate"}

    look: Seconds = Field(default=5.0, gt=0.0)
    """Time to turn back and forth; if the cloud is narrow then, it is trusted."""
    roam: Seconds = Field(default=45.0, gt=0.0)
    """Time to drive around reactively until the cloud settles."""
    restarts: int = Field(default=2, ge=0, le=1000)
    """Restarts of global localisation after that, before the goal is given up.

    Also the number of times it looks around at a goal that only seems to be reached."""
    disambiguate: Seconds = 120.0
    """Time for active disambiguation between pose hypotheses; then the goal is given up."""


class PoseWatch:
    """Counts doubts and time for the state machine; it never sees a pose."""

    def __init__(self, config: RelocaliseConfig, machine: Machine) -> None:
        self.config, self.machine = config, machine
        self.reset()

    def reset(self) -> None:
        """Doubts and restarts so far do not count."""
        self._since_ns = self._trusted_ns = 0
        self._good_ns: int | None = None
        self._doubts = self._updates = self._updates_then = self._restarts = 0

    def update(self, now_ns: int, narrow: bool, agrees: bool, updates: int) -> State:
        """The state for this tick, from `narrow` (the cloud), `agrees` (scans and map), the updates so far.

        RESTART and GIVE_UP last one tick.
        """
        if self.machine.state in (State.RESTART, State.GIVE_UP):
            self.on(Event.NEXT_TICK, now_ns, updates)
        good = narrow and (agrees or now_ns < self._trusted_ns)
        if self.machine.state in (State.LOOK, State.ROAM):
            self._search(now_ns, narrow, good, updates)
        else:
            self._count_doubts(now_ns, good, updates)
        return self.machine.state

    def on(self, event: Event, now_ns: int, updates: int) -> None:
        """An event of the machine that begins another count, or goes on with this one."""
        self._since_ns = now_ns
        if event not in (Event.ALIASES, Event.DECISION):
            self._good_ns, self._doubts = None, 0
            self._updates = self._updates_then = updates
        self.machine.on(event)

    def _count_doubts(self, now_ns: int, good: bool, updates: int) -> None:
        if good:
            self._doubts = 0
        elif updates > self._updates:
            self._doubts += 1
        self._updates = updates
        if self._doubts >= DOUBTS:
            self.on(Event.DOUBT, now_ns, updates)

    def _search(self, now_ns: int, narrow: bool, good: bool, updates: int) -> None:
        if not good:
            self._good_ns = None
        elif self._good_ns is None:
            self._good_ns = now_ns
        looking, config = self.machine.state is State.LOOK, self.config
        settled = self._good_ns is not None and now_ns - self._good_ns >= nanoseconds(SETTLED_S)
        over = seconds(now_ns - self._since_ns) >= (config.look if looking else config.roam)
        if updates > self._updates_then and (settled or (looking and over and narrow)):
            if not settled:
                self._trusted_ns = now_ns + nanoseconds(TRUST_S)
            self._restarts = 0
            self.on(Event.CERTAINTY, now_ns, updates)
        elif over and not looking and self._restarts >= config.restarts:
            self._restarts = 0
            self.on(Event.OUT_OF_TRIES, now_ns, updates)
        elif over:
            self._restarts += not looking
            self.on(Event.TIMEOUT, now_ns, updates)
