"""InputError, the exception for bad input: one line for the user."""

from collections.abc import Callable
from typing import ParamSpec, TypeVar

Given = ParamSpec("Given")
Found = TypeVar("Found")


class InputError(Exception):
    """Bad input or usage: one line that says what is wrong, where, and what to do.

    The command line prints the message to stderr and exits with code 2; library
    callers may catch it. Its text must not contain a newline.
    """


class Unfinished(InputError):
    """A recording that ended before its time; what there is of it is kept. `code` is the exit code."""

    def __init__(self, text: str, code: int = 1) -> None:
        super().__init__(text)
        self.code = code


def if_there(read: Callable[Given, Found], *given: Given.args, **named: Given.kwargs) -> Found | None:
    """The result of `read`, or None if it raises InputError: for what may be missing."""
    try:
        return read(*given, **named)
    except InputError:
        return None
