"""Cases shared between processes: one that hangs, raises or dies ends none but itself."""

from __future__ import annotations

import multiprocessing
import signal
import time
from collections.abc import Iterator, Sequence
from concurrent.futures import FIRST_COMPLETED, Future, ProcessPoolExecutor, wait
from concurrent.futures.process import BrokenProcessPool

from benchmarks.rows import Case, Row

SPAWN = multiprocessing.get_context("spawn")


def worker() -> ProcessPoolExecutor:
    """A process that measures one case after the other. Ctrl-C is for the process that has started it."""
    return ProcessPoolExecutor(1, SPAWN, signal.signal, (signal.SIGINT, signal.SIG_IGN))


def measured(case: Case, limit_s: float) -> Row:
    """The row of a case; one that raises has a row that says so, one that takes longer ends its process."""
    signal.setitimer(signal.ITIMER_REAL, limit_s)
    try:
        return {**case.about, **case.measure()}
    except Exception as error:
        return {**case.about, "error": f"{type(error).__name__}: {error}"}
    finally:
        signal.setitimer(signal.ITIMER_REAL, 0.0)


def in_processes(cases: Sequence[Case], count: int, limit_s: float) -> Iterator[tuple[Case, Row]]:
    """Cases and their rows as they come, from `count` processes; none takes longer than `limit_s` [s]."""
    waiting, idle = list(reversed(cases)), [worker() for _ in range(count)]
    going: dict[Future[Row], tuple[Case, ProcessPoolExecutor, float]] = {}
    try:
        while waiting or going:
            while waiting and idle:
                case, process = waiting.pop(), idle.pop()
                going[process.submit(measured, case, limit_s)] = case, process, time.monotonic()
            for future in wait(going, return_when=FIRST_COMPLETED).done:
                case, process, begun = going.pop(future)
                try:
                    row = future.result()
                except BrokenProcessPool:
                    late, process = time.monotonic() - begun >= limit_s, worker()
                    why = f"took more than {limit_s:.0f} s" if late else "its process died"
                    row = {**case.about, "error": why}
                idle.append(process)
                yield case, row
    finally:  # also when nobody wants the rest any more
        for child in multiprocessing.active_children():
            child.kill()
