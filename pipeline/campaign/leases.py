"""Work that many processes want and one does: its result is an object of a store.

Who works holds a lease, an object that it writes anew every few seconds. A lease that has not changed for
long enough, by the clock of whoever waits, is that of a lost worker: the next one takes the work over with a
lease of the next number. Two that meet there try to put the same object, so only one of them goes on.
"""

from __future__ import annotations

import threading
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager, suppress
from secrets import token_hex

from turtlebag.pipeline.campaign.store import Store

LEASE_S = 60.0
"""After so long without a sign of life a worker counts as lost."""
BEAT_S = 5.0
POLL_S = 0.2


def made_once(store: Store, name: str, make: Callable[[], bytes]) -> bytes:
    """Content of an object; where there is none yet it is made, by one process of all that ask for it.

    What `make` raises ends this process's attempt, and the next one tries.
    """
    number, seen, since = 0, None, 0.0
    while (content := store.read(name)) is None:
        mark = store.read(_lease(name, number))
        if mark is None:
            with _held(store, name, number) as mine:
                if mine and not store.has(name):
                    store.put_new(name, make())
        elif mark != seen:
            seen, since = mark, time.monotonic()
            time.sleep(POLL_S)
        elif time.monotonic() - since > LEASE_S:
            number, seen = number + 1, None
        else:
            time.sleep(POLL_S)
    return content


def _lease(name: str, number: int) -> str:
    return f"leases/{name}/{number}"


@contextmanager
def _held(store: Store, name: str, number: int) -> Iterator[bool]:
    """Whether the lease is ours, which is then kept alive and given up at the end, with those before it."""
    lease, mark = _lease(name, number), token_hex(8)
    if not store.put_new(lease, mark.encode()):
        yield False
        return
    done = threading.Event()

    def beat() -> None:
        count = 0
        while not done.wait(BEAT_S):
            count += 1
            with suppress(OSError):  # the store does not answer: the next beat may
                store.put(lease, f"{mark} {count}".encode())

    beating = threading.Thread(target=beat, daemon=True)
    beating.start()
    try:
        yield True
    finally:
        done.set()
        beating.join()
        for earlier in range(number + 1):
            store.delete(_lease(name, earlier))
