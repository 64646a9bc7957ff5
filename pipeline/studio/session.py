"""A session: inputs in, views out. It is recorded, so that it can be replayed to the same bytes."""

from __future__ import annotations

from collections.abc import Callable
from functools import partial
from pathlib import Path
from typing import Any, Self

from turtlebag.datasets.durations import seconds
from turtlebag.datasets.errors import InputError
from turtlebag.pipeline.studio.actions import act
from turtlebag.pipeline.studio.inputs import DRIVING, Input, Plain
from turtlebag.pipeline.studio.journal import FILE, Journal
from turtlebag.pipeline.studio.playback import Playback
from turtlebag.pipeline.studio.robot import Robot
from turtlebag.pipeline.studio.setup import BagSetup, StudioSetup
from turtlebag.pipeline.studio.view import View
from turtlebag.pipeline.studio.visuals import EventLog


class Session:
    """Inputs to a robot, or to a bag that is played: executed, written to the journal and announced.

    A context manager that writes into a folder. No clock, no network, no thread.
    """

    def __init__(self, setup: StudioSetup | BagSetup, folder: Path, say: Callable[[str], None]) -> None:
        """`say` is told each line of the event log.

        InputError for unknown names, and for a map or a bag that cannot be used.
        """
        self.scene = setup.scene()
        self._folder = folder
        self._subject: Robot | Playback
        self._act: Callable[[Input], str]
        if isinstance(setup, BagSetup):
            self._subject = playback = Playback(setup, folder, EventLog(say))
            self._act = playback.act
        else:
            self._subject = robot = Robot(setup, folder, EventLog(say))
            self._act = partial(act, robot)
        self._journal = Journal(folder / FILE, setup.header())
        self.ended = False
        """Whether it was asked to end."""

    def __enter__(self) -> Self:
        return self

    def __exit__(self, kind: type[BaseException] | None, *_: object) -> None:
        if kind is None:
            self.close()
        else:
            self._subject.close(kind)

    def close(self) -> None:
        """Finish all files; closing twice is harmless."""
        if not self.ended:
            self.apply(Plain(do="end"))
        self._journal.close()
        self._subject.close()

    def interrupt(self) -> None:
        """Break off what takes long; called from another thread."""
        self._subject.interrupt()

    def apply(self, entry: Input) -> str:
        """Do what is asked for at this instant, before the tick; returns a line for the event log.

        It stands in the log already, and is empty where there is nothing to tell. InputError, with nothing
        changed, when that cannot be done.
        """
        if self.ended:
            raise InputError(f"{entry.do}: the session is over")
        try:
            line = self._act(entry)
        except OSError as error:
            if entry.do == "end":  # nobody can do better
                raise
            raise InputError(f"{entry.do}: {error.filename or self._folder}: {error.strerror}") from None
        self.ended = entry.do == "end"
        if entry.do not in DRIVING:
            self._journal.action(self.stamp_ns, entry)
        if line:
            self._subject.say(line)
        return line

    def tick(self) -> None:
        """One control period; nothing once the session is over, or while it is idle."""
        if self.ended or self.idle:
            return
        self._journal.tick(self.stamp_ns, self._subject.by_hand)
        self._subject.tick()
        if seconds(self.stamp_ns) >= self._subject.longest_s:
            self.apply(Plain(do="end"))

    @property
    def stamp_ns(self) -> int:
        """Simulated time since the session began [ns]."""
        return self._subject.stamp_ns

    @property
    def idle(self) -> bool:
        """Whether time stands still whatever is asked for: a bag is at its end."""
        return self._subject.idle

    def metrics(self) -> dict[str, Any]:
        """How long it lasted [s], and what was done meanwhile."""
        return {"task": "studio", "time_s": round(seconds(self.stamp_ns), 6), **self._subject.metrics()}

    def view(self) -> View:
        """What there is to draw now."""
        return self._subject.view()
