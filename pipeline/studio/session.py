"""A session: the simulated robot and what a person asks of it. No clock, no network, no thread."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field
from pathlib import Path

from turtlebag.pipeline.studio.inputs import Input
from turtlebag.pipeline.studio.view import Scene, View
from turtlebag.sim.simulator import SimConfig


@dataclass(frozen=True, eq=False)
class StudioSetup:
    """What a session starts with: names or files of world and robot, a seed, and a map if there is one."""

    world: str
    robot: str | None = None
    seed: int = 0
    map_path: Path | None = None
    sim: SimConfig = field(default_factory=SimConfig)


class Session:
    """A context manager: it owns a simulator and, while one is recorded, a bag."""

    def __init__(self, setup: StudioSetup, folder: Path, say: Callable[[str], None]) -> None:
        """`folder` is where everything is written; `say` is told each line of the event log."""
        raise NotImplementedError

    scene: Scene

    @property
    def stamp_ns(self) -> int:
        """Simulated time [ns]."""
        raise NotImplementedError

    @property
    def period_ns(self) -> int:
        """From a tick to the next [ns]."""
        raise NotImplementedError

    @property
    def ended(self) -> bool:
        """Whether it was asked to end."""
        raise NotImplementedError

    def apply(self, entry: Input) -> str:
        """Do what is asked for at this instant, before the tick; returns a line for the event log.

        InputError, with nothing changed, when that cannot be done.
        """
        raise NotImplementedError

    def tick(self) -> None:
        """One control period."""
        raise NotImplementedError

    def view(self) -> View:
        """What there is to draw now."""
        raise NotImplementedError

    def close(self) -> None:
        """Finish all files."""
        raise NotImplementedError
