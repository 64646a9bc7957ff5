"""Cases shared between processes: one that hangs, raises or dies ends none but itself."""

from __future__ import annotations

import multiprocessing
import time
from collections.abc import Iterator, Sequence
from multiprocessing.connection import Connection, wait
from typing import Any

from benchmarks.rows import Case, Row

SPAWN = multiprocessing.get_context("spawn")


class Worker:
    """A process that measures one case after the other."""

    def __init__(self) -> None:
        self.pipe, theirs = SPAWN.Pipe()
        self._process: Any = SPAWN.Process(target=serve, args=(theirs,))
        self._process.start()
        theirs.close()
        self.case: Case | None = None
        self.until = 0.0

    def give(self, case: Case, limit_s: float) -> None:
        """Start measuring a case, for so long at most [s]."""
        self.case, self.until = case, time.monotonic() + limit_s
        self.pipe.send(case)

    def end(self) -> None:
        """Kill the process, whatever it is doing."""
        self._process.kill()
        self._process.join()
        self.pipe.close()

    def answer(self) -> Row | None:
        """The row of its case; None when the process has died."""
        try:
            return dict(self.pipe.recv())
        except (EOFError, ConnectionResetError):
            return None


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
    waiting = list(reversed(cases))
    workers: list[Worker] = []
    try:
        while waiting or any(worker.case for worker in workers):
            while waiting and len(workers) < count:
                workers.append(Worker())
            for worker in workers:
                if worker.case is None and waiting:
                    worker.give(waiting.pop(), limit_s)
            busy = [worker for worker in workers if worker.case is not None]
            soonest = min(worker.until for worker in busy)
            ready = wait([worker.pipe for worker in busy], max(0.0, soonest - time.monotonic()))
            for worker in busy:
                case, late = worker.case, time.monotonic() >= worker.until
                assert case is not None
                if worker.pipe in ready:
                    row = worker.answer()
                elif late:
                    row = failed(case, f"took more than {limit_s:.0f} s")
                else:
                    continue
                worker.case = None
                if row is None or worker.pipe not in ready:
                    worker.end()
                    workers.remove(worker)
                yield case, row or failed(case, "its process died")
    finally:
        for worker in workers:
            worker.end()
