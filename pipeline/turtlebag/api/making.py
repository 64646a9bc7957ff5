"""What all steps share: output folders, the equivalent command line, warnings and errors."""

from __future__ import annotations

import logging
import os
import re
import shutil
import tempfile
import threading
import weakref
from argparse import Namespace
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from turtlebag.api import given
from turtlebag.api.given import PathLike
from turtlebag.datasets.errors import InputError
from turtlebag.datasets.output_lock import lock_output
from turtlebag.datasets.se2 import SE2
from turtlebag.pipeline.terminal.messages import log, show_bars

# Without a handler of its own, a library's warnings are printed.
log.addHandler(logging.NullHandler())
_printed = logging.StreamHandler()
IN_PYTHON = {"set": "settings", "force": "force=True", "wiggle": "wiggle=True"}
IN_PYTHON |= {"system": "systems", **{f"system-{what}": what for what in ("base", "times", "shift")}}


def verbose(on: bool = True) -> None:
    """Show messages on stderr as the commands do, with progress bars in a terminal; False turns this off
    again."""
    show_bars(on)
    log.removeHandler(_printed)
    if on:
        log.addHandler(_printed)
    log.setLevel(logging.INFO if on else logging.NOTSET)


class TemporaryFolder:
    """A folder that exists as long as something refers to it."""

    def __init__(self) -> None:
        self.path = Path(tempfile.mkdtemp(prefix="turtlebag-"))
        weakref.finalize(self, shutil.rmtree, self.path, ignore_errors=True)


@dataclass
class Step:
    """A running step: its command, the objects that must live as long as its result, and its warnings so
    far."""

    verb: str
    out: Path
    force: bool
    kept: list[object] = field(default_factory=list)
    notes: list[str] = field(default_factory=list)

    def run(self, *inputs: PathLike, **options: Any) -> None:
        """Run the command, as its module does; KeyboardInterrupt when one that keeps what it has was
        interrupted."""
        args = self.arguments(*inputs, **options)
        if args.run(args) >= 128:
            raise KeyboardInterrupt

    def arguments(self, *inputs: PathLike, **options: Any) -> Namespace:
        """What the command line would make of them."""
        from turtlebag.pipeline.cli.main import build_parser

        words = command_line(self.verb, *inputs, **options, out=self.out)
        args = build_parser(self.verb).parse_args(words[1:])
        args.force, args.command_line, args.verbosity = self.force, words, -1
        return args


@contextmanager
def step(
    verb: str, out: PathLike | None, *, force: bool = False, inputs: Mapping[str, PathLike | None]
) -> Iterator[Step]:
    """Make an output within this context: at `out`, or if that is None, in a folder that lives as long as the
    result.

    An InputError names Python's arguments, not options of the command line. Inputs, by the names of their
    arguments, must not change; those that are objects live as long as the result.
    """
    read = [given.path(one, what) for what, one in inputs.items() if one is not None]
    folder = None if out is not None else TemporaryFolder()
    place = given.path_if(out, "out") or folder.path / verb  # type: ignore[union-attr]
    now = Step(verb, place, force, [folder, *inputs.values()])
    with in_python(), _heard(now.notes), lock_output(now.out, force=force, inputs=read):
        yield now


@contextmanager
def in_python() -> Iterator[None]:
    """InputErrors raised within name the arguments of Python instead of the command line's options."""
    try:
        yield
    except InputError as error:
        said = re.sub(r"^\w+: argument (.*) \(see turtlebag \w+ --help\)$", r"\1", str(error))
        option = r"(?<![\w./-])--([a-z]+(?:-[a-z]+)*)"
        said = re.sub(option, lambda at: IN_PYTHON.get(at[1], at[1].replace("-", "_")), said)
        raise InputError(said) from error.__cause__


@contextmanager
def _heard(notes: list[str]) -> Iterator[None]:
    """Collect this thread's warnings in the list meanwhile."""
    me = threading.get_ident()

    class Listener(logging.Handler):
        def emit(self, record: logging.LogRecord) -> None:
            if record.thread == me:
                notes.append(record.getMessage().removeprefix("note: "))

    listener = Listener(logging.WARNING)
    log.addHandler(listener)
    try:
        yield
    finally:
        log.removeHandler(listener)


def command_line(verb: str, *inputs: PathLike, **options: Any) -> list[str]:
    """The equivalent command, for the manifest; options that are None or False are left out."""
    named = [os.fspath(one) for one in inputs]
    words = ["turtlebag", verb, *(f"./{path}" if path.startswith("-") else path for path in named)]
    for name, value in options.items():
        option = f"--{name.replace('_', '-')}"
        for one in value if isinstance(value, (list, tuple)) else [value]:
            if one is True:
                words.append(option)
            elif one is not None and one is not False:
                text = _option_text(one)
                words += [f"{option}={text}"] if text.startswith("-") else [option, text]
    return words


def _option_text(value: Any) -> str:
    if isinstance(value, SE2):
        return given.pose_text(value)
    return os.fspath(value) if isinstance(value, os.PathLike) else str(value)
