"""Keys from the bytes that a terminal sends: an arrow is several of them, and they may come in pieces."""

from __future__ import annotations

import re

ESCAPE = "\x1b"
UP, DOWN, RIGHT, LEFT = ARROWS = "↑↓→←"
_ARROW = re.compile(r"\x1b[\[O]([A-D])")
"""In normal and in application mode."""
# F1 of Linux's console, a mouse, CSI with and without numbers, SS3; strings; Alt with a key.
_SEQUENCE = re.compile(
    r"\x1b(?:\[\[[ -~]|\[M[ -\xff]{3}|\[[0-?]+[ -/]*[@-~]|\[[ -/]*[@-LN-Z\\-~]"
    r"|O[0-?]*[@-~]"
    r"|[\]PX^_][^\x03\x04\x07\x1b]*(?:\x07|\x1b\\)|[ -N`-~Q-WYZ\\])"
)
_BEGUN = re.compile(
    r"\x1b(?:\[\[?|\[M[ -\xff]{0,2}|\[[0-?]*[ -/]*|O[0-?]*|[\]PX^_][^\x03\x04\x07\x1b]*\x1b?)?"
)
_LONGEST = 256
"""Characters of a sequence; what has not ended by then is none."""


class Keys:
    """Turns what was typed into keys, a character each; arrows are UP, DOWN, RIGHT and LEFT.

    A sequence that is not an arrow gives no key. Escape alone gives none either.
    """

    def __init__(self) -> None:
        self._begun = ""

    def of(self, typed: str) -> str:
        """The keys of what was typed since the last call; a sequence that has only begun waits."""
        if self._begun == ESCAPE and typed and typed[0] not in "[O":
            self._begun = ""  # it was the key itself: what follows later is another
        text, keys, self._begun = self._begun + typed, "", ""
        while text:
            if text[0] != ESCAPE:
                keys, text = keys + text[0], text[1:]
            elif whole := _SEQUENCE.match(text):
                arrow = _ARROW.fullmatch(whole[0])
                keys += ARROWS["ABCD".index(arrow[1])] if arrow else ""
                text = text[whole.end() :]
            elif len(text) < _LONGEST and _BEGUN.fullmatch(text):
                self._begun, text = text, ""
            else:  # a control character within: what came before it is no sequence
                begun = _BEGUN.match(text)
                text = text[begun.end() if begun else 1 :]
        return keys
