"""The state machine that drives a goal; docs/how-it-drives.md has its diagram and its table.

Pure bookkeeping: it never sees a pose. States are nested: a transition of a state holds for all states
inside it that have none of their own for the event.
"""

from __future__ import annotations

from collections.abc import Callable
from enum import StrEnum, auto
from functools import cache
from typing import NamedTuple


class State(StrEnum):
    """What the robot is doing. The run log has a state's value, unless stated otherwise."""

    ANY = "any"
    """All of them."""
    DRIVE = "drive"
    """The robot knows where it is."""
    WAIT = "wait"
    """Without a goal, or before its first plan."""
    PURSUE = "pursue"
    """On the way to a goal."""
    PLAN = "plan"
    """Without a path."""
    FOLLOW = "follow"
    """Along the path; the run log has the controller's own word."""
    HELD = "held"
    """The collision monitor lets nothing through."""
    RECOVER = "recover"
    """In a recovery manoeuvre; the run log has its name."""
    RECOVER_HELD = "recover_held"
    """The same with nothing let through; `held` in the run log."""
    DONE = "done"
    """Every goal has its outcome."""
    LOST = "lost"
    """The robot does not trust its pose."""
    WIGGLE = "wiggle"
    """Turning back and forth to check the initial pose."""
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


class Suspension(StrEnum):
    """What keeps the robot from its goal while the machine rests; a teleop override does, too."""

    BLIND = "blind"
    """The lidar is silent."""
    NO_POSE = "no_pose"
    """There is no initial pose."""


class Event(StrEnum):
    """What changes a state."""

    GOAL = auto()
    RESET = auto()
    END = auto()
    PATH = auto()
    OBSTACLE = auto()
    STOP = auto()
    RELEASE = auto()
    TROUBLE = auto()
    RECOVERY = auto()
    OUTCOME = auto()
    DOUBT = auto()
    CERTAINTY = auto()
    TIMEOUT = auto()
    OUT_OF_TRIES = auto()
    NEXT_TICK = auto()
    ALIASES = auto()
    DECISION = auto()
    JUMP = auto()
    POSE = auto()
    SEARCH = auto()


class Action(StrEnum):
    """What is done at once with a transition."""

    FORGET = "forget the obstacles seen"
    SPREAD = "restart global localisation"
    REPORT_LOST = "give the goal up: lost"
    REPORT_ALIASES = "give the goal up: aliases"


class Transition(NamedTuple):
    """A row of the table. With itself as the target, a state and any state inside it stay."""

    state: State
    event: Event
    target: State
    action: Action | None = None


INSIDE = {
    State.DRIVE: State.ANY,
    State.WAIT: State.DRIVE,
    State.PURSUE: State.DRIVE,
    State.PLAN: State.PURSUE,
    State.FOLLOW: State.PURSUE,
    State.HELD: State.FOLLOW,
    State.RECOVER: State.PURSUE,
    State.RECOVER_HELD: State.RECOVER,
    State.DONE: State.DRIVE,
    State.LOST: State.ANY,
    State.WIGGLE: State.LOST,
    State.LOOK: State.LOST,
    State.ROAM: State.LOST,
    State.RESTART: State.LOST,
    State.DISAMBIGUATE: State.LOST,
    State.GIVE_UP: State.LOST,
}
"""The state that each one lies in."""

TRANSITIONS = (
    Transition(State.ANY, Event.POSE, State.WAIT, Action.FORGET),
    Transition(State.ANY, Event.SEARCH, State.WIGGLE, Action.FORGET),
    Transition(State.DRIVE, Event.RESET, State.WAIT),
    Transition(State.DRIVE, Event.END, State.DONE),
    Transition(State.DRIVE, Event.JUMP, State.WAIT, Action.FORGET),
    Transition(State.DRIVE, Event.DOUBT, State.LOOK, Action.FORGET),
    Transition(State.DRIVE, Event.ALIASES, State.DISAMBIGUATE),
    Transition(State.WAIT, Event.GOAL, State.PLAN),
    Transition(State.PURSUE, Event.OUTCOME, State.WAIT),
    Transition(State.PLAN, Event.PATH, State.FOLLOW),
    Transition(State.PLAN, Event.TROUBLE, State.RECOVER),
    Transition(State.FOLLOW, Event.OBSTACLE, State.PLAN),
    Transition(State.FOLLOW, Event.TROUBLE, State.RECOVER),
    Transition(State.FOLLOW, Event.STOP, State.HELD),
    Transition(State.HELD, Event.RELEASE, State.FOLLOW),
    Transition(State.RECOVER, Event.RECOVERY, State.PLAN),
    Transition(State.RECOVER, Event.STOP, State.RECOVER_HELD),
    Transition(State.RECOVER_HELD, Event.RELEASE, State.RECOVER),
    Transition(State.LOST, Event.RESET, State.LOST),
    Transition(State.LOST, Event.END, State.LOST),
    Transition(State.LOST, Event.JUMP, State.LOST, Action.FORGET),
    Transition(State.WIGGLE, Event.CERTAINTY, State.WAIT),
    Transition(State.WIGGLE, Event.DOUBT, State.LOOK),
    Transition(State.LOOK, Event.CERTAINTY, State.WAIT),
    Transition(State.LOOK, Event.TIMEOUT, State.ROAM),
    Transition(State.ROAM, Event.CERTAINTY, State.WAIT),
    Transition(State.ROAM, Event.TIMEOUT, State.RESTART, Action.SPREAD),
    Transition(State.ROAM, Event.OUT_OF_TRIES, State.GIVE_UP, Action.REPORT_LOST),
    Transition(State.RESTART, Event.NEXT_TICK, State.LOOK),
    Transition(State.GIVE_UP, Event.NEXT_TICK, State.WAIT),
    Transition(State.DISAMBIGUATE, Event.DECISION, State.WAIT, Action.FORGET),
    Transition(State.DISAMBIGUATE, Event.DOUBT, State.LOOK, Action.FORGET),
    Transition(State.DISAMBIGUATE, Event.TIMEOUT, State.DISAMBIGUATE, Action.REPORT_ALIASES),
)
_ROWS = {(row.state, row.event): row for row in TRANSITIONS}


@cache
def lineage(state: State) -> tuple[State, ...]:
    """A state and those it lies in, from the inside out."""
    outer = INSIDE.get(state)
    return (state,) if outer is None else (state, *lineage(outer))


class Machine:
    """The state of one goal after another. `perform` carries out the actions of the table."""

    def __init__(self, state: State = State.WAIT) -> None:
        self.state = state
        self.perform: Callable[[Action], None] = lambda action: None

    def within(self, state: State) -> bool:
        """Whether the state is this one or lies in it."""
        return state in lineage(self.state)

    def on(self, event: Event) -> None:
        """Apply the table; KeyError when the state has no transition for the event."""
        row = next((_ROWS[at, event] for at in lineage(self.state) if (at, event) in _ROWS), None)
        if row is None:
            raise KeyError(self.state, event)
        if row.target is not row.state:
            self.state = row.target
        if row.action is not None:
            self.perform(row.action)
