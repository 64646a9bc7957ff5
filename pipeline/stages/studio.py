"""The stage `studio`: a session that a person drives, and the same again from its `session.yaml`."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from pathlib import Path

from turtlebag.pipeline.studio.session import Session, StudioSetup
from turtlebag.pipeline.terminal.messages import say


@contextmanager
def studio_output(
    setup: StudioSetup,
    out: Path,
    *,
    force: bool = False,
    command_line: Sequence[str] = (),
    say: Callable[[str], None] = say,
) -> Iterator[Session]:
    """A session whose files grow in OUT.partial and are put in place when the block is left.

    InputError, with nothing written, for unknown names, unreadable maps and an `out` that is taken.
    """
    raise NotImplementedError


def replay(
    session_file: Path,
    out: Path,
    *,
    force: bool = False,
    command_line: Sequence[str] = (),
    say: Callable[[str], None] = say,
) -> int:
    """Drive a session again, to the same bytes; returns the exit code."""
    raise NotImplementedError
