"""Numbers of things in messages."""


def counted(count: int, noun: str) -> str:
    """`1 map`, `2 maps`."""
    return f"{count} {noun}{'s' * (count != 1)}"
