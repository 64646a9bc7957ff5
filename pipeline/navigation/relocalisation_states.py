"""The state machine of relocalisation; its diagram is in docs/architecture.md.

Pure bookkeeping of the localiser's status; it never sees a pose.
"""

from __future__ import annotations

from enum import Enum, StrEnum, auto
from typing import ClassVar

from pydantic import Field

from turtlebag.datasets.durations import Seconds, nanoseconds, seconds
from turtlebag.datasets.settings import Settings
from turtlebag.pipeline.localisation.lost_detection import DOUBTS


class State(StrEnum):
    """The robot's behaviour; the values are in the run log, except `drive`."""

    WIGGLE = "wiggle"
    """Turning back and forth to check the initial pose."""
    DRIVE = "drive"
    """Localised: driving to the goal."""
    LOOK = "look"
    """Stopped, turning back and forth."""
    ROAM = "roam"
    """Driving around reactively, avoiding obstacles."""
    RESTART = "restart"
    """Restarting global localisation, for one tick."""
    DISAMBIGUATE = "disambiguate"
    """Driving to where the scans expected under the pose hypotheses differ."""
    GIVE_UP = "give_up"
    """Giving up the goal, for one tick."""


class Event(Enum):
    """What changes a state."""

    DOUBTED = auto()
    FOUND = auto()
    TIMEOUT = auto()
    OUT_OF_TRIES = auto()
    NEXT_TICK = auto()
    ALIASED = auto()
    DECIDED = auto()


TRANSITIONS = {
    (State.WIGGLE, Event.FOUND): State.DRIVE,
    (State.WIGGLE, Event.DOUBTED): State.LOOK,
    (State.DRIVE, Event.DOUBTED): State.LOOK,
    (State.DRIVE, Event.ALIASED): State.DISAMBIGUATE,
    (State.DISAMBIGUATE, Event.DECIDED): State.DRIVE,
    (State.DISAMBIGUATE, Event.DOUBTED): State.LOOK,
    (State.LOOK, Event.FOUND): State.DRIVE,
    (State.LOOK, Event.TIMEOUT): State.ROAM,
    (State.ROAM, Event.FOUND): State.DRIVE,
    (State.ROAM, Event.TIMEOUT): State.RESTART,
    (State.ROAM, Event.OUT_OF_TRIES): State.GIVE_UP,
    (State.RESTART, Event.NEXT_TICK): State.LOOK,
    (State.GIVE_UP, Event.NEXT_TICK): State.DRIVE,
}


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


class RelocalisationStates:
    """The state, tick by tick, from `narrow` (the cloud), `agrees` (scans and map) and the updates so far."""

    def __init__(self, config: RelocaliseConfig, state: State = State.DRIVE) -> None:
        self.config = config
        self.state = state
        self._since_ns = self._trusted_ns = 0
        self._good_ns: int | None = None
        self._doubts = self._updates = self._updates_then = self._restarts = 0

    def update(self, now_ns: int, narrow: bool, agrees: bool, updates: int) -> State:
        """The state for this tick; RESTART and GIVE_UP last one tick."""
        if self.state in (State.RESTART, State.GIVE_UP):
            self.on(Event.NEXT_TICK, now_ns, updates)
        good = narrow and (agrees or now_ns < self._trusted_ns)
        if self.state in (State.LOOK, State.ROAM):
            self._search(now_ns, narrow, good, updates)
            return self.state
        self._count_doubts(now_ns, good, updates)
        return self.state

    def on(self, event: Event, now_ns: int, updates: int) -> None:
        """Apply the transition table."""
        self.state = TRANSITIONS[self.state, event]
        self._since_ns = now_ns
        if event not in (Event.ALIASED, Event.DECIDED):
            self._good_ns, self._doubts = None, 0
            self._updates = self._updates_then = updates

    def _count_doubts(self, now_ns: int, good: bool, updates: int) -> None:
        if good:
            self._doubts = 0
        elif updates > self._updates:
            self._doubts += 1
        self._updates = updates
        if self._doubts >= DOUBTS:
            self.on(Event.DOUBTED, now_ns, updates)

    def _search(self, now_ns: int, narrow: bool, good: bool, updates: int) -> None:
        if not good:
            self._good_ns = None
        elif self._good_ns is None:
            self._good_ns = now_ns
        looking, config = self.state is State.LOOK, self.config
        settled = self._good_ns is not None and now_ns - self._good_ns >= nanoseconds(SETTLED_S)
        over = seconds(now_ns - self._since_ns) >= (config.look if looking else config.roam)
        if updates > self._updates_then and (settled or (looking and over and narrow)):
            if not settled:
                self._trusted_ns = now_ns + nanoseconds(TRUST_S)
            self._restarts = 0
            self.on(Event.FOUND, now_ns, updates)
        elif over and not looking and self._restarts >= config.restarts:
            self._restarts = 0
            self.on(Event.OUT_OF_TRIES, now_ns, updates)
        elif over:
            self._restarts += not looking
            self.on(Event.TIMEOUT, now_ns, updates)
