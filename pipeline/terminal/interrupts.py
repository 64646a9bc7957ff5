"""Ctrl-C and SIGTERM, handled otherwise for a while."""

from __future__ import annotations

import signal
import threading
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from typing import Any


@contextmanager
def handled(handler: Callable[..., Any], *, unless_handled: bool = False) -> Iterator[None]:
    """Within, both go to the handler; in another thread than the main one signals are not ours to catch.

    `unless_handled`: not the one that someone else has a handler for already.
    """
    usual, mine = (signal.default_int_handler, signal.SIG_DFL), {}
    if threading.current_thread() is threading.main_thread():
        before = {number: signal.getsignal(number) for number in (signal.SIGINT, signal.SIGTERM)}
        mine = {number: old for number, old in before.items() if not unless_handled or old in usual}
    for number in mine:
        signal.signal(number, handler)
    try:
        yield
    finally:
        for number, old in mine.items():
            signal.signal(number, old)


@contextmanager
def deferred_interrupt() -> Iterator[list[int]]:
    """Ctrl-C or SIGTERM within is put in the list instead of raising: no message is cut in the middle."""
    received: list[int] = []
    with handled(lambda number, frame: received.append(number)):
        yield received
