"""Numbers of things in messages, their articles, and lists of names."""

from collections.abc import Iterable


def counted(count: int, noun: str) -> str:
    """`1 map`, `2 maps`."""
    return f"{count} {noun}{'s' * (count != 1)}"


def listed(names: Iterable[str]) -> str:
    """The first dozen names in order, and how many more there are; `none` without any."""
    ordered = sorted(names)
    more = [f"{len(ordered) - 12} more"] if len(ordered) > 12 else []
    return ", ".join(ordered[:12] + more) or "none"


def one(noun: str) -> str:
    """`a Scan`, `an int`."""
    return f"{'an' if noun[0] in 'aeiouAEIOU' else 'a'} {noun}"


def verb(count: int, one: str, several: str) -> str:
    """The form of a verb for so many things."""
    return one if count == 1 else several
