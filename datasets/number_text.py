"""Numbers in text: what files and options spell, as every program reads them."""

from __future__ import annotations

from collections.abc import Sequence


def decimal(text: str) -> float:
    """The number that a text spells; ValueError for anything else, and for what Python alone takes for one:
    underscores between digits, digits of other scripts."""
    return float(_plain(text))


def whole(text: str) -> int:
    """The same of a whole number."""
    return int(_plain(text))


def decimals(words: Sequence[str]) -> list[float]:
    """The same of several words."""
    _plain("".join(words))
    return [float(word) for word in words]


def _plain(text: str) -> str:
    if "_" in text or not text.isascii():
        raise ValueError(f"{text}: not a number")
    return text
