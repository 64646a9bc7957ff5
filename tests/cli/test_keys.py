"""Arrow keys drive as one expects; other sequences of a terminal do nothing, in however many pieces."""

import os
from itertools import pairwise

import pytest

from turtlebag.pipeline.terminal.keyboard_teleop import KeyState, keys_of
from turtlebag.pipeline.terminal.keys import DOWN, LEFT, RIGHT, UP, Keys
from turtlebag.sim.robots import load_robot

ARROWS = {"A": UP, "B": DOWN, "C": RIGHT, "D": LEFT}
UNKNOWN = (
    "\x1b[1;5D", "\x1b[1~", "\x1b[3~", "\x1b[200~", "\x1b[Z", "\x1b[a", "\x1bOa", "\x1bOP", "\x1bO5D",
    "\x1b[[A", "\x1b[[D", "\x1b[M ad", "\x1b[<0;12;7M", "\x1b[?1;2c", "\x1b[12;40R",
)  # fmt: skip


def keys_of_pieces(text, cuts):
    keys = Keys()
    return "".join(keys.of(text[a:b]) for a, b in pairwise([0, *cuts, len(text)]))


def cuts_of(text):
    yield from ([], [*range(1, len(text))], *([cut] for cut in range(1, len(text))))


@pytest.mark.parametrize("mode", "[O")
@pytest.mark.parametrize("final", ARROWS)
def test_an_arrow_is_one_key_in_both_modes_and_in_pieces(mode, final):
    text = f"w\x1b{mode}{final}x"
    for cuts in cuts_of(text):
        assert keys_of_pieces(text, cuts) == f"w{ARROWS[final]}x"


@pytest.mark.parametrize("sequence", UNKNOWN)
def test_an_unknown_sequence_gives_no_key(sequence):
    for cuts in cuts_of(sequence):
        if cuts[:1] != [1] or sequence[1] in "[O":  # Escape, and later a key, are two keys
            assert keys_of_pieces(sequence, cuts) == ""
    assert Keys().of(sequence + "d") == "d"


def test_escape_alone_takes_no_later_key_away():
    for typed in (["\x1b", "x"], ["\x1b", "", "x"], ["\x1b", "\x1b", "x"], ["\x1b\x1b", "x"]):
        keys = Keys()
        assert "".join(map(keys.of, typed)) == "x"
    assert Keys().of("\x1bd") == ""  # Alt with D


@pytest.mark.parametrize("begun", ["\x1b", "\x1b[", "\x1b[1;", "\x1bO", "\x1b]0;"])
def test_no_sequence_keeps_the_robot_from_being_stopped(begun):
    for stop in "\x03\x04":
        keys = Keys()
        assert (keys.of(begun) + keys.of(stop))[-1:] == stop
        assert Keys().of(begun + stop)[-1:] == stop


@pytest.mark.parametrize("style", ["keys", "turtlebot3"])
def test_arrows_drive_as_one_expects(style):
    for final, (v, w) in {"A": (1, 0), "B": (-1, 0), "C": (0, -1), "D": (0, 1)}.items():
        state = KeyState(load_robot("burger").limits, style)
        reader, writer = os.pipe()
        os.write(writer, f"\x1b[{final}".encode())
        os.close(writer)
        with keys_of(reader) as read_keys:
            for _ in range(4):
                for key in read_keys():
                    state.press(key)
        os.close(reader)
        state.tick()
        state.tick()
        assert state.ended
        assert (state.command.v / 0.01, state.command.w / 0.1) == pytest.approx((v, w))
