"""What to do about not knowing where the robot is: one state machine, its diagram in docs/architecture.md.

Pure bookkeeping over what the localiser says of itself; it never sees a pose.
"""

from __future__ import annotations

from enum import Enum, StrEnum, auto

from pydantic import Field

from turtlebag.datasets.durations import Seconds, nanoseconds, seconds
from turtlebag.datasets.settings import Settings
from turtlebag.pipeline.localisation.agreement import DOUBTS


class State(StrEnum):
    """What the robot does; the words stand in the run log, but for `drive`."""

    WIGGLE = "wiggle"
    """It turns to and fro before it believes the pose that it was told."""
    DRIVE = "drive"
    """It takes itself to know where it is."""
    LOOK = "look"
    """It has stopped, and turns to and fro."""
    ROAM = "roam"
    """It drives about, touching nothing."""
    RESTART = "restart"
    """It forgets every pose, for one tick."""
    COMPARE = "tell_apart"
    """It drives to where its pose hypotheses would look different."""
    GIVE_UP = "give_up"
    """It gives up the goal, for one tick."""
    PUSHED = "pushed"
    """Someone is pushing it: it stands still until that has been over for a while."""


class Event(Enum):
    """What changes a state."""

    DOUBTED = auto()
    FOUND = auto()
    TIME_OVER = auto()
    TRIES_OVER = auto()
    SAID = auto()
    ALIKE = auto()
    DECIDED = auto()
    PUSHED = auto()


TRANSITIONS = {
    (State.WIGGLE, Event.FOUND): State.DRIVE,
    (State.WIGGLE, Event.DOUBTED): State.LOOK,
    (State.DRIVE, Event.DOUBTED): State.LOOK,
    (State.DRIVE, Event.ALIKE): State.COMPARE,
    (State.DRIVE, Event.PUSHED): State.PUSHED,
    (State.PUSHED, Event.PUSHED): State.PUSHED,
    (State.PUSHED, Event.TIME_OVER): State.DRIVE,
    (State.PUSHED, Event.DOUBTED): State.LOOK,
    (State.COMPARE, Event.DECIDED): State.DRIVE,
    (State.COMPARE, Event.DOUBTED): State.LOOK,
    (State.LOOK, Event.FOUND): State.DRIVE,
    (State.LOOK, Event.TIME_OVER): State.ROAM,
    (State.ROAM, Event.FOUND): State.DRIVE,
    (State.ROAM, Event.TIME_OVER): State.RESTART,
    (State.ROAM, Event.TRIES_OVER): State.GIVE_UP,
    (State.RESTART, Event.SAID): State.LOOK,
    (State.GIVE_UP, Event.SAID): State.DRIVE,
}


SETTLED_S = 1.0
"""So long the cloud must be narrow and the scans agree before it goes on."""
TRUST_S = 15.0
"""So long it is not asked again whether the scans agree: people and boxes are not on the map."""
PUSHED_S = 2.0
"""For so long after it was pushed the robot stands still: whoever pushes may not have done yet."""


class RelocaliseConfig(Settings, allow_inf_nan=False):
    """Seconds, but for `restarts`."""

    look: Seconds = Field(default=5.0, gt=0.0)
    """It turns to and fro for so long; a cloud that is narrow then is trusted: no better place was found."""
    roam: Seconds = Field(default=45.0, gt=0.0)
    """It drives about for so long, touching nothing, until the cloud settles."""
    restarts: int = Field(default=2, ge=0)
    """Then it forgets every pose and begins again, so often; then the goal is given up.

    So often, too, it looks about where a goal only seems to have ended."""
    tell_apart: Seconds = 120.0
    """Two places look alike: it drives for so long to where they would not; then the goal is given up."""


class RelocalisationStates:
    """The state, tick by tick, from `narrow` (the cloud), `agrees` (scans and map) and the updates so far."""

    def __init__(self, config: RelocaliseConfig, state: State = State.DRIVE) -> None:
        self.config = config
        self.state = state
        self._since_ns = self._trusted_ns = 0
        self._good_ns: int | None = None
        self._doubts = self._updates = self._updates_then = self._restarts = 0

    def update(self, now_ns: int, narrow: bool, agrees: bool, updates: int) -> State:
        """What to do now; RESTART and GIVE_UP are said once."""
        if self.state in (State.RESTART, State.GIVE_UP):
            self.on(Event.SAID, now_ns, updates)
        good = narrow and (agrees or now_ns < self._trusted_ns)
        if self.state in (State.LOOK, State.ROAM):
            self._search(now_ns, narrow, good, updates)
            return self.state
        if self.state is State.PUSHED and now_ns - self._since_ns > nanoseconds(PUSHED_S):
            self.on(Event.TIME_OVER, now_ns, updates)
        self._count_doubts(now_ns, good, updates)
        return self.state

    def on(self, event: Event, now_ns: int, updates: int) -> None:
        """Go where the table of transitions says."""
        self.state = TRANSITIONS[self.state, event]
        self._since_ns = now_ns
        if event not in (Event.ALIKE, Event.DECIDED, Event.PUSHED):
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
            self.on(Event.TRIES_OVER, now_ns, updates)
        elif over:
            self._restarts += not looking
            self.on(Event.TIME_OVER, now_ns, updates)
