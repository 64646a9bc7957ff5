"""The state machine of a goal, and its table and diagram in the docs."""

import re
from pathlib import Path

import pytest

from turtlebag.pipeline.navigation.goal_states import (
    INSIDE,
    TRANSITIONS,
    Action,
    Event,
    Machine,
    State,
    Suspension,
    lineage,
)

PAGE = (Path(__file__).parents[2] / "docs" / "how-it-drives.md").read_text()
LEAVES = set(State) - set(INSIDE.values()) | {State.FOLLOW, State.RECOVER}


def after(*events, state=State.WAIT):
    """The state after some events, and the actions on the way."""
    machine, actions = Machine(state), []
    machine.perform = actions.append
    for event in events:
        machine.on(event)
    return machine.state, actions


def test_the_table_in_the_docs_is_that_of_the_code():
    rows = re.findall(r"^\| `(\w+)` \| ([a-z ]+) \| `(\w+)`(?:, (stays))? \| (.*) \|$", PAGE, re.MULTILINE)
    code = []
    for row in TRANSITIONS:
        stays = "stays" if row.target is row.state else ""
        event = row.event.value.replace("_", " ")
        code.append((row.state.value, event, row.target.value, stays, row.action.value if row.action else ""))
    assert rows == code


def test_the_diagram_in_the_docs_is_the_table():
    drawn = re.findall(r"^ +(\w+) --> (\w+): (\w+)$", PAGE, re.MULTILINE)
    moves = [row for row in TRANSITIONS if row.target is not row.state]
    assert sorted(drawn) == sorted((row.state.value, row.target.value, row.event.value) for row in moves)
    boxes = re.findall(r"^ +state (\w+) \{$", PAGE, re.MULTILINE)
    assert set(boxes) == {"drive", "pursue", "lost"}


def test_the_docs_say_what_every_state_and_every_event_is():
    states = re.findall(r"^\| `(\w+)` \| `?[a-z]", PAGE, re.MULTILINE)
    assert {state.value for state in LEAVES} <= set(states)
    events = re.findall(r"^\| ([a-z ]+) \| [^`]", PAGE, re.MULTILINE)
    assert {event.value.replace("_", " ") for event in Event} <= set(events)
    assert all(f"`{word}`" in PAGE for word in (*Suspension, "teleop"))


def test_every_state_is_entered_and_left_and_every_event_and_action_is_used():
    assert {row.target for row in TRANSITIONS} == LEAVES | {State.LOST}
    for state in LEAVES:
        targets = {row.target for row in TRANSITIONS if row.state in lineage(state)}
        assert targets - set(lineage(state)), state
    assert {row.event for row in TRANSITIONS} == set(Event)
    assert {row.action for row in TRANSITIONS} == {None, *Action}
    assert len({(row.state, row.event) for row in TRANSITIONS}) == len(TRANSITIONS)


def test_a_state_inside_another_has_its_transitions_too():
    way = (Event.GOAL, Event.PATH, Event.STOP)
    assert after(*way)[0] is State.HELD
    assert after(*way, Event.STOP)[0] is State.HELD
    assert after(*way, Event.RELEASE)[0] is State.FOLLOW
    assert after(*way, Event.OBSTACLE)[0] is State.PLAN
    assert after(*way, Event.TROUBLE, Event.STOP)[0] is State.RECOVER_HELD
    assert after(*way, Event.TROUBLE, Event.STOP, Event.RECOVERY)[0] is State.PLAN
    assert after(*way, Event.DOUBT) == (State.LOOK, [Action.FORGET])
    assert after(*way, Event.POSE) == (State.WAIT, [Action.FORGET])
    machine = Machine(State.HELD)
    within = {State.HELD, State.FOLLOW, State.PURSUE, State.DRIVE, State.ANY}
    assert {state for state in State if machine.within(state)} == within


def test_a_lost_robot_stays_so_when_its_goals_change_or_end():
    for event, actions in ((Event.RESET, []), (Event.END, []), (Event.JUMP, [Action.FORGET])):
        assert after(event, state=State.ROAM) == (State.ROAM, actions)
    assert after(Event.END, Event.DOUBT, Event.CERTAINTY)[0] is State.WAIT
    spent = after(Event.TIMEOUT, Event.NEXT_TICK, Event.TIMEOUT, Event.OUT_OF_TRIES, state=State.ROAM)
    assert spent == (State.GIVE_UP, [Action.SPREAD, Action.REPORT_LOST])
    both = after(Event.ALIASES, Event.TIMEOUT, Event.DECISION)
    assert both == (State.WAIT, [Action.REPORT_ALIASES, Action.FORGET])


def test_an_event_that_a_state_does_not_know_is_an_error():
    with pytest.raises(KeyError):
        Machine().on(Event.CERTAINTY)
