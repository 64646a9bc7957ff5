"""Another handler of Ctrl-C and SIGTERM, for a while."""

from __future__ import annotations

import signal
import threading
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from typing import Any


@contextmanager
def handled(handler: Callable[..., Any], *, unless_handled: bool = False) -> Iterator[None]:
    """Within, both signals go to the handler; outside the main thread, which gets them all, nothing changes.

    `unless_handled`: a signal that has a handler already, other than Python's own, keeps it.
    """
    before: dict[signal.Signals, Any] = {}
    if threading.current_thread() is threading.main_thread():
        before = {number: signal.getsignal(number) for number in (signal.SIGINT, signal.SIGTERM)}
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
def deferred_interrupt() -> Iterator[list[int]]:
    """Within, Ctrl-C and SIGTERM are added to the list and raise nothing: no message is cut in the middle."""
    received: list[int] = []
    with handled(lambda number, frame: received.append(number)):
        yield received
