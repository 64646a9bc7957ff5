"""What the terminal shows: progress and one-line messages on stderr, results on stdout."""

from __future__ import annotations

import logging
import sys
from collections.abc import Iterable, Iterator
from typing import TypeVar

from rich.console import Console
from rich.progress import BarColumn, MofNCompleteColumn, Progress, TextColumn, TimeRemainingColumn

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
