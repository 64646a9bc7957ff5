"""Base of simulated sessions and bag playback: inputs are executed, written to the journal and announced."""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Callable
from pathlib import Path
from typing import Any, Self

from turtlebag.datasets.errors import InputError
from turtlebag.pipeline.studio.inputs import DRIVING, Input, Plain
from turtlebag.pipeline.studio.journal import FILE, BagHeader, Header, Journal
from turtlebag.pipeline.studio.library import Library
from turtlebag.pipeline.studio.view import Scene, View
from turtlebag.pipeline.studio.visuals import EventLog
from turtlebag.sim.robots import CONTROL_HZ, stamp_of


class BaseSession(ABC):
    """A context manager that writes into a folder. No clock, no network, no thread."""

    scene: Scene
    period_ns = round(1e9 / CONTROL_HZ)
    """From a tick to the next [ns]."""

    def __init__(
        self, header: Header | BagHeader, folder: Path, say: Callable[[str], None], given: Path | None = None
    ) -> None:
        """`say` is told each line of the event log; `given` is a map to start with.

        InputError for a map that cannot be used.
        """
        self._folder, self._events = folder, EventLog(say)
        self._library = Library(folder, given)
        self._journal = Journal(folder / FILE, header)
        self._step = 0
        self.ended = False
        """Whether it was asked to end."""

    def __enter__(self) -> Self:
        return self

    def __exit__(self, kind: type[BaseException] | None, *_: object) -> None:
        if kind is None:
            self.close()

    def close(self) -> None:
        """Finish all files; closing twice is harmless."""
        if not self.ended:
            self.apply(Plain(do="end"))
        self._journal.close()

    def interrupt(self) -> None:  # noqa: B027 (few sessions have anything to break off)
        """Break off what takes long; called from another thread."""

    def apply(self, entry: Input) -> str:
        """Do what is asked for at this instant, before the tick; returns a line for the event log.

        It stands in the log already, and is empty where there is nothing to tell. InputError, with nothing
        changed, when that cannot be done.
        """
        if self.ended:
            raise InputError(f"{entry.do}: the session is over")
        try:
            line = self._done(entry)
        except OSError as error:
            if entry.do == "end":  # nobody can do better
                raise
            raise InputError(f"{entry.do}: {error.filename or self._folder}: {error.strerror}") from None
        self.ended = entry.do == "end"
        if entry.do not in DRIVING:
            self._journal.action(self.stamp_ns, entry)
        if line:
            self._events.add(self._told_ns, line)
        return line

    @property
    def stamp_ns(self) -> int:
        """Simulated time since the session began [ns]."""
        return stamp_of(self._step)

    @property
    def idle(self) -> bool:
        """Whether time stands still whatever is asked for."""
        return False

    @property
    def _told_ns(self) -> int:
        """The time that the event log gives [ns]."""
        return self.stamp_ns

    @abstractmethod
    def _done(self, entry: Input) -> str:
        """Do it; what there is to tell of it."""

    @abstractmethod
    def tick(self) -> None:
        """One control period; nothing once the session is over."""

    @abstractmethod
    def metrics(self) -> dict[str, Any]:
        """How long it lasted [s], and what was done meanwhile."""

    @abstractmethod
    def view(self) -> View:
        """What there is to draw now."""
