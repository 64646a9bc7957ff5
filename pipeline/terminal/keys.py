"""Keys from the bytes that a terminal sends: an arrow is several of them, and they may come in pieces."""

from __future__ import annotations

import re

ESCAPE = "\x1b"
UP, DOWN, RIGHT, LEFT = ARROWS = "↑↓→←"
_ARROWS = {f"{ESCAPE}{mode}{final}": key for mode in "[O" for final, key in zip("ABCD", ARROWS, strict=True)}
"""In normal and in application mode."""
# A mouse, CSI and what Linux's console makes of it for F1, SS3; Alt with a key.
_SEQUENCE = re.compile(r"\x1b(?:\[M[ -\xff]{3}|\[\[?[0-?]*[ -/]*[@-~]|O[0-?]*[@-~]|[ -~])")
_BEGUN = re.compile(r"\x1b(?:\[M[ -\xff]{0,2}|\[\[?[0-?]*[ -/]*|O[0-?]*)?$")


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
        text = self._begun + typed
        begun = _BEGUN.search(text)
        self._begun = "" if begun is None else begun[0]
        whole = text.removesuffix(self._begun)
        return _SEQUENCE.sub(lambda found: _ARROWS.get(found[0], ""), whole).replace(ESCAPE, "")
