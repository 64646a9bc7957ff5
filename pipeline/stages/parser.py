"""Parsers of the command line whose errors are one line."""

from __future__ import annotations

import argparse
import math
import re
from collections.abc import Callable, Sequence
from difflib import get_close_matches
from itertools import takewhile
from pathlib import Path
from typing import Any, NoReturn

from turtlebag.datasets.errors import InputError
from turtlebag.datasets.number_text import decimal, whole

RENAMED = {
    "--takeover": "--teleop-override",
    **{f"--rival{part}": f"--system{part}" for part in ("", "-base", "-times", "-shift")},
}
"""Present names of verbs and options by their former ones, for the error that a former one is."""
REMOVED: dict[str, str] = {
    **dict.fromkeys(
        ("ablate", "blame"),
        "give map or navigate a part that knows the truth, "
        "e.g. --set front_end=turtlebag.testing:TrueFrontEnd",
    ),
    "teleop --view": "turtlebag studio shows the scan and the map while you drive",
}
"""What to use in place of verbs and options that are gone; an option as `verb --option`."""


def refuse_former(verb: str | None) -> None:
    """InputError for a verb of former versions: what to use in its place."""
    if verb in RENAMED:
        raise InputError(f"{verb} is now called {RENAMED[verb]}")
    if verb in REMOVED:
        raise InputError(f"{verb} is gone; {REMOVED[verb]}")


class Parser(argparse.ArgumentParser):
    """An argument parser whose errors are one line and exit code 2; it takes no abbreviated options, whose
    meaning would change with the next option that begins alike."""

    later: Callable[[Parser], None] | None = None
    """Adds options when they are needed, because that imports what they are generated from."""

    def __init__(self, **more: Any) -> None:
        super().__init__(allow_abbrev=False, **more)

    def ready(self) -> Parser:
        """Itself, with all its options."""
        later, self.later = self.later, None
        if later is not None:
            later(self)
        return self

    def parse_known_args(self, args: Any = None, namespace: Any = None) -> tuple[Any, list[str]]:
        """As argparse's, except that the parser that a word is meant for reports what is unknown: first
        options, which may be a required one misspelt, and it can suggest some."""
        self.ready()
        last = self._subparsers is None
        for word in takewhile(lambda word: word != "--" and (last or word.startswith("-")), args):
            if word.startswith("--") and word.partition("=")[0] not in self._option_string_actions:
                self._report([word])
        found, unknown = super().parse_known_args(args, namespace)
        if unknown:
            self._report(unknown)
        return found, unknown

    def _report(self, unknown: list[str]) -> NoReturn:
        for old in [word.partition("=")[0] for word in unknown]:
            if instead := REMOVED.get(f"{self.prog} {old}".removeprefix("turtlebag ")):
                self.error(f"{old} is gone; {instead}")
            if RENAMED.get(old) in self._option_string_actions:
                self.error(f"{old} is now called {RENAMED[old]}")
        near = get_close_matches(unknown[0].partition("=")[0], self._option_string_actions, 1)
        meant = f"; did you mean {near[0]}?" if near else ""
        self.error(f"unrecognized arguments: {' '.join(unknown)}{meant}")

    def error(self, message: str) -> NoReturn:
        """InputError in the place of argparse's usage and exit."""
        where = self.prog.removeprefix("turtlebag").strip()
        said = " ".join(message.split())
        raise InputError(f"{where}{': ' if where else ''}{said} (see {self.prog} --help)")

    def option(
        self, name: str, metavar: str, text: str, kind: Callable[[str], Any] = str, **more: Any
    ) -> None:
        """An option with a value, or an argument if the name has no dashes."""
        self.add_argument(name, metavar=metavar, help=text, type=kind, **more)

    def repeated(self, name: str, metavar: str, text: str, kind: Callable[[str], Any] = str) -> None:
        """An option that may be repeated: its values make a list."""
        self.option(name, metavar, text, kind, action="append", default=[])

    def flag(self, name: str, text: str) -> None:
        """An option without a value."""
        self.add_argument(name, action="store_true", help=text)

    def add_output(
        self, text: str = "folder to write the results to", *, what: str = "DIR", required: bool = True
    ) -> None:
        """--out and --force."""
        self.option("--out", what, text, Path, required=required)
        self.flag("--force", "replace --out if it is an output of ours that nobody has changed")


def add_action(actions: Any, name: str, text: str, example: str) -> Parser:
    """A verb, or an action of one; its help ends with an example of one line, for copying."""
    parser: Parser = actions.add_parser(
        name,
        help=text,
        description=f"{text[0].upper()}{text[1:]}.",
        epilog=f"example:\n  {example}",
        formatter_class=argparse.RawDescriptionHelpFormatter,
    )
    return parser


def joined(argv: Sequence[str]) -> list[str]:
    """`--goal -2,0,0` as `--goal=-2,0,0`, because argparse would take the value for an option."""
    words: list[str] = []
    for word in argv:
        if words and words[-1].startswith("--") and re.match(r"-(\d|\.|inf|nan)[^,]*,", word):
            words[-1] += "=" + word
        else:
            words.append(word)
    return words


def seed(text: str) -> int:
    """A seed: a non-negative integer."""
    return _whole(text, 0)


def count(text: str) -> int:
    """A number of things, 1 or more."""
    return _whole(text, 1)


def port_number(text: str) -> int:
    """The number of a port."""
    if not text.isdecimal() or not 0 < int(text) < 65536:
        raise argparse.ArgumentTypeError(f"must be a port from 1 to 65535, not {text}")
    return int(text)


def positive(text: str) -> float:
    """A number of more than 0, and neither endless nor so small that what is divided by it is."""
    value = _number(text)
    if not 0.0 < value < math.inf:
        raise argparse.ArgumentTypeError(f"must be a positive number, not {text}")
    if not 0.001 <= value <= 1e6:
        raise argparse.ArgumentTypeError(f"must be 0.001 to 1000000, not {text}")
    return value


def seconds(text: str) -> float:
    """A finite number, 0 or more."""
    value = _number(text)
    if not 0.0 <= value < math.inf:
        raise argparse.ArgumentTypeError(f"must be a number of seconds, 0 or more, not {text}")
    return value


def _number(text: str) -> float:
    try:
        return decimal(text)
    except ValueError:
        return math.nan


def _whole(text: str, least: int) -> int:
    try:
        value = whole(text)
    except ValueError:
        value = -1
    if value < least:
        raise argparse.ArgumentTypeError(f"must be a whole number, {least} or more, not {text}")
    return value
