"""The parser of a command: its options, those that several commands share, and errors of one line."""

from __future__ import annotations

import argparse
from collections.abc import Callable
from difflib import get_close_matches
from itertools import takewhile
from pathlib import Path
from typing import Any, NoReturn

from turtlebag.datasets.errors import InputError
from turtlebag.pipeline.cli.arguments import map_file, seed

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


class OrOwn(tuple[str, ...]):
    """Choices of an option that also accepts a user's class, module:Class."""

    def __contains__(self, name: object) -> bool:
        """Whether it is one of the choices, or could be such a class."""
        from turtlebag.datasets.parts import is_own  # NumPy, which --help does without

        return super().__contains__(name) or (isinstance(name, str) and is_own(name))


class Parser(argparse.ArgumentParser):
    """An argument parser whose errors are one line and exit code 2; it takes no abbreviated options, whose
    meaning would change with the next option that begins alike."""

    def __init__(self, **more: Any) -> None:
        super().__init__(allow_abbrev=False, **more)

    def parse_known_args(self, args: Any = None, namespace: Any = None) -> tuple[Any, list[str]]:
        """As argparse's, except that the parser that a word is meant for reports what is unknown: first
        options, which may be a required one misspelt, and it can suggest some."""
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

    def add_config(self) -> None:
        """--config and --set."""
        self.option("--config", "FILE", "YAML file with settings", Path)
        text = "override one setting; may be repeated"
        self.option("--set", "KEY=VALUE", text, dest="settings", action="append", default=[])

    def add_world(self, seed_value: int) -> None:
        """What is simulated: --world, --robot, --seed and --start."""
        text = "world: a name, a YAML or SDF file, or your own class (module:Class)"
        self.option("--world", "W", text, required=True)
        self.option("--robot", "R", "robot: a name or a YAML file (default: the world's own)")
        self.add_seed(seed_value)
        self.option("--start", "X,Y,YAW", "true start pose (default: the world's spawn)")

    def add_seed(self, value: int) -> None:
        """--seed."""
        self.option("--seed", "N", f"random seed (default: {value})", seed, default=value)

    def add_map(self, purpose: str, *, required: bool = True) -> None:
        """--map."""
        text = f"map to {purpose} on: its YAML file, or a folder that map wrote"
        self.option("--map", "MAP", text, map_file, required=required)

    def add_laser(self, source: str) -> None:
        """--laser, which overrides the laser's pose in the argument `source`."""
        text = f"pose of the laser on the robot, YAW being the direction of beam angle 0; overrides {source}"
        self.option("--laser", "X,Y,YAW[,upside-down]", text)


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
