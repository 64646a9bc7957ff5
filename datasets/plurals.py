"""Numbers of things in messages, and their articles."""


def counted(count: int, noun: str) -> str:
    """`1 map`, `2 maps`."""
    return f"{count} {noun}{'s' * (count != 1)}"


def one(noun: str) -> str:
    """`a Scan`, `an int`."""
    return f"{'an' if noun[0] in 'aeiouAEIOU' else 'a'} {noun}"


def verb(count: int, one: str, several: str) -> str:
    """The form of a verb for so many things."""
    return one if count == 1 else several
