"""Another handler of the signals that end a command, for a while."""

from __future__ import annotations

import signal
import threading
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from typing import Any

from turtlebag.datasets.errors import Unfinished

STOPS = (signal.SIGINT, signal.SIGTERM, signal.SIGHUP)


@contextmanager
def handled(
    handler: Callable[..., Any], signals: Sequence[signal.Signals] = STOPS, *, unless_handled: bool = False
) -> Iterator[None]:
    """Within, the signals go to the handler; outside the main thread, which gets them all, nothing changes.

    A hang-up that `nohup` has switched off stays so. `unless_handled`: a signal that has a handler already,
    other than Python's own, keeps it.
    """
    before: dict[signal.Signals, Any] = {}
    if threading.current_thread() is threading.main_thread():
        before = {number: signal.getsignal(number) for number in signals}
    if before.get(signal.SIGHUP) is signal.SIG_IGN:
        del before[signal.SIGHUP]
    if unless_handled:
        usual = (signal.default_int_handler, signal.SIG_DFL)
        before = {number: old for number, old in before.items() if old in usual}
    for number in before:
        signal.signal(number, handler)
    try:
        yield
    finally:
        for number, old in before.items():
            signal.signal(number, old)


@contextmanager
def deferred_interrupt(signals: Sequence[signal.Signals] = STOPS) -> Iterator[list[int]]:
    """Within, the signals are added to the list and raise nothing: no message is cut in the middle."""
    received: list[int] = []
    with handled(lambda number, frame: received.append(number), signals):
        yield received


def require_no_hangup(received: Sequence[int]) -> None:
    """Unfinished when the terminal was closed meanwhile: nobody may wait until all is written."""
    if signal.SIGHUP in received:
        raise Unfinished("hung up: the terminal was closed", 128 + signal.SIGHUP)
