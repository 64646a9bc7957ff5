"""What the terminal shows: progress and one-line messages on stderr, results on stdout."""

from __future__ import annotations

import logging
import os
import sys
from collections.abc import Callable, Iterable, Iterator
from contextlib import contextmanager, suppress
from typing import Any, TextIO, TypeVar, cast

from rich.console import Console
from rich.progress import BarColumn, MofNCompleteColumn, Progress, TextColumn, TimeRemainingColumn

from datasets.errors import InputError

Item = TypeVar("Item")
log = logging.getLogger("turtlebag")


def set_verbosity(level: int) -> None:
    """-1 quiet, 0 normal, 1 verbose."""
    logging.basicConfig(stream=sys.stderr, format="%(message)s", force=True)
    # Where there is no home it warns, twice, of the temporary folder that it finds by itself.
    logging.getLogger("matplotlib").setLevel(logging.ERROR)
    log.setLevel({-1: logging.ERROR, 0: logging.INFO}.get(level, logging.DEBUG))


def quiet() -> bool:
    """Whether -q was given."""
    return log.level >= logging.ERROR


def track(items: Iterable[Item], description: str, total: int | None = None) -> Iterator[Item]:
    """Yield the items behind a progress bar; silent when stderr is not a terminal or -q was given."""
    if quiet() or not sys.stderr.isatty():
        yield from items
        return
    columns = (TextColumn("{task.description}"), BarColumn(), MofNCompleteColumn(), TimeRemainingColumn())
    with Progress(*columns, console=Console(stderr=True), transient=True) as progress:
        yield from progress.track(items, total=total, description=description)


class Words:
    """A text stream whose trouble is noted: from then on nothing more is written to it.

    With `optional` that is all; else the first trouble is raised, as BrokenPipeError when the reader has gone
    away, as InputError otherwise.
    """

    def __init__(self, stream: TextIO, name: str, *, optional: bool) -> None:
        self._stream, self._name, self.optional = stream, name, optional
        self.problem: str | None = None

    def write(self, text: str) -> int:
        """Write, if that still goes."""
        self._attempt(lambda: self._stream.write(text))
        return len(text)

    def flush(self) -> None:
        """Hand what was written to the system, if that still goes."""
        self._attempt(self._stream.flush)

    def _attempt(self, action: Callable[[], object]) -> None:
        if self.problem is not None:
            return
        try:
            action()
        except OSError as error:
            gone = isinstance(error, BrokenPipeError)
            self.problem = "" if gone else f"{self._name}: {error.strerror}"
            with suppress(OSError):  # what is left in the stream would fail again when Python ends
                os.dup2(os.open(os.devnull, os.O_WRONLY), self._stream.fileno())
            if not self.optional:
                raise error if gone else InputError(self.problem) from None

    def __getattr__(self, name: str) -> Any:
        return getattr(self._stream, name)


@contextmanager
def guarded_streams() -> Iterator[Words]:
    """Put `Words` in the place of stdout, which is yielded, and of stderr."""
    before = sys.stdout, sys.stderr
    out, err = Words(sys.stdout, "stdout", optional=False), Words(sys.stderr, "stderr", optional=True)
    sys.stdout, sys.stderr = cast(TextIO, out), cast(TextIO, err)
    try:
        yield out
    finally:
        out.optional = True
        out.flush()
        err.flush()
        sys.stdout, sys.stderr = before
