"""Cases shared between processes: one that hangs, raises or dies ends none but itself."""

from __future__ import annotations

import multiprocessing
from collections.abc import Iterator, Sequence
from concurrent.futures import ThreadPoolExecutor, as_completed
from multiprocessing.connection import Connection
from queue import SimpleQueue
from typing import Any

from benchmarks.rows import Case, Row

SPAWN = multiprocessing.get_context("spawn")


class Worker:
    """A process that measures one case after the other; where a case has ended it, the next has a new one."""

    def __init__(self) -> None:
        self._process: Any = None

    def measure(self, case: Case, limit_s: float) -> Row:
        """The row of a case, or one that says why there is none: it may take so long [s]."""
        if self._process is None:
            self._pipe, theirs = SPAWN.Pipe()
            self._process = SPAWN.Process(target=serve, args=(theirs,))
            self._process.start()
            theirs.close()
        try:
            self._pipe.send(case)
            if self._pipe.poll(limit_s):
                return dict(self._pipe.recv())
            why = f"took more than {limit_s:.0f} s"
        except (EOFError, ConnectionError):
            why = "its process died"
        self.kill()
        self._process.join()
        self._process = None
        return failed(case, why)

    def kill(self) -> None:
        """End the process, whatever it is doing."""
        if self._process is not None:
            self._process.kill()


def serve(pipe: Connection) -> None:
    """Measure what comes until the other end is gone."""
    try:
        while True:
            pipe.send(measured(pipe.recv()))
    except (EOFError, BrokenPipeError, KeyboardInterrupt):
        return


def measured(case: Case) -> Row:
    """The row of a case; one that raises has a row that says so."""
    try:
        return {**case.about, **case.measure()}
    except Exception as error:
        return failed(case, f"{type(error).__name__}: {error}")


def failed(case: Case, why: str) -> Row:
    """The row of a case without a result."""
    return {**case.about, "error": why}


def in_processes(cases: Sequence[Case], count: int, limit_s: float) -> Iterator[tuple[Case, Row]]:
    """Cases and their rows as they come, from `count` processes; none takes longer than `limit_s` [s]."""
    workers = [Worker() for _ in range(count)]
    idle: SimpleQueue[Worker] = SimpleQueue()
    for worker in workers:
        idle.put(worker)

    def measure(case: Case) -> tuple[Case, Row]:
        worker = idle.get()
        try:
            return case, worker.measure(case, limit_s)
        finally:
            idle.put(worker)

    with ThreadPoolExecutor(count) as pool:
        try:
            for done in as_completed([pool.submit(measure, case) for case in cases]):
                yield done.result()
        finally:  # also when nobody wants the rest any more
            pool.shutdown(wait=False, cancel_futures=True)
            for worker in workers:
                worker.kill()
