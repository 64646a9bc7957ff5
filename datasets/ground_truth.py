"""Ground truth for the truth parts of `turtlebag.testing` and nobody else; a test reads every import of this.

A part is made with what its contract says, and that is never the truth. A command that knows the truth
says so here while it makes its parts; only those that a person named for it ask.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from contextlib import contextmanager
from contextvars import ContextVar

from turtlebag.datasets.errors import InputError
from turtlebag.datasets.se2 import SE2

TruePose = Callable[[int], SE2]
"""`T_world_base` at the stamp of a scan, by the scan's number; -1 is the newest."""
_known: ContextVar[TruePose | None] = ContextVar("truth", default=None)


@contextmanager
def known_truth(pose: TruePose | None) -> Iterator[None]:
    """The parts made within may ask for the true poses; None: they are not known."""
    before = _known.set(pose)
    try:
        yield
    finally:
        _known.reset(before)


def true_pose(part: object) -> TruePose:
    """The true poses of the command that makes this part; InputError where they are not known."""
    pose = _known.get()
    if pose is None:
        name = type(part).__name__
        raise InputError(f"{name}: the truth is not known here; use it in map with --truth, or in navigate")
    return pose
