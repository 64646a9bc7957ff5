"""Cases on Dask: processes or threads of this machine, or a scheduler somewhere else."""

from __future__ import annotations

import logging
import os
from collections.abc import Iterator, Sequence
from contextlib import contextmanager, suppress
from importlib.util import find_spec
from itertools import islice
from pathlib import Path
from typing import Any

from turtlebag.datasets.errors import InputError
from turtlebag.pipeline.campaign.campaign_file import Campaign
from turtlebag.pipeline.campaign.case import Done, Run, Where, row_of, run_case
from turtlebag.pipeline.campaign.cases import Case
from turtlebag.pipeline.terminal.messages import log

THREADS = "threads"
"""In the place of a scheduler's address: threads of this process."""
LOOPBACK = "127.0.0.1"
AHEAD = 8
"""Cases at the scheduler, for each thread of a worker: what it holds does not grow with a campaign."""


@contextmanager
def _client(scheduler: str | None, workers: int | None, scratch: Path) -> Iterator[Any]:
    """A Dask client; the local cluster has one single-threaded worker a core, and Dask's dashboard where
    Bokeh is installed."""
    import dask
    from distributed import Client, LocalCluster

    logging.getLogger("distributed").setLevel(logging.ERROR)
    dask.config.set({"distributed.scheduler.allowed-failures": 1})
    if scheduler not in (None, THREADS):
        try:
            client = Client(scheduler, timeout="10s")
        except (OSError, ValueError):
            raise InputError(f"--scheduler {scheduler}: no scheduler answers there") from None
        with client:
            yield client
        return
    threads = {name: "1" for name in ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS")}
    processes: dict[str, Any] = {"processes": False} if scheduler == THREADS else {"env": threads}
    with (
        LocalCluster(
            n_workers=workers or os.cpu_count() or 1,
            threads_per_worker=1,
            dashboard_address=f"{LOOPBACK}:0",
            silence_logs=logging.CRITICAL,
            local_directory=str(scratch),
            **processes,
        ) as cluster,
        Client(cluster) as client,
    ):
        yield client


def require_scheduler(scheduler: str | None) -> None:
    """InputError when there is no scheduler at the address."""
    if scheduler not in (None, THREADS):
        with _client(scheduler, None, Path()):
            pass


def run_cases(
    campaign: Campaign,
    todo: Sequence[Case],
    where: Where,
    run: Run,
    scratch: Path,
    *,
    scheduler: str | None = None,
    workers: int | None = None,
) -> Iterator[Done]:
    """The cases as they finish, in any order.

    A case whose worker died is run once more by another; when that dies too, it is a `failed` row. Workers
    need to see nothing but the store; those of this machine work below `scratch`.
    """
    from distributed import as_completed

    with _client(scheduler, workers, scratch) as client:
        if link := _dashboard(client, local=scheduler in (None, THREADS)):
            log.info(f"Dask's dashboard: {link}")
        going: dict[str, Case] = {}
        waiting, finished = iter(todo), as_completed()

        def start(count: int) -> None:
            for case in islice(waiting, count):
                key = f"{campaign.name}-{case.name}"
                going[key] = case
                finished.add(client.submit(run_case, case, campaign, where, run, key=key, pure=False))

        start(AHEAD * max(sum(client.nthreads().values()), 8))
        for future in finished:
            case = going.pop(future.key)
            if future.status == "finished":
                yield future.result()
            else:
                # Not written: a resumed campaign tries the case again.
                yield row_of(case, campaign, _why(future.exception())), None
            future.release()
            start(1)


def _dashboard(client: Any, *, local: bool) -> str:
    """The address of the page on which Dask shows its work; empty when there is none."""
    if not local:
        with suppress(KeyError):
            return str(client.dashboard_link)
    # Without Bokeh there is a server all the same, but no page.
    elif find_spec("bokeh"):
        return f"http://{LOOPBACK}:{client.scheduler_info()['services']['dashboard']}/status"
    return ""


def _why(error: BaseException) -> str:
    """Why there is no row of a case: its workers died, or could not reach the store."""
    from distributed.scheduler import KilledWorker

    if isinstance(error, KilledWorker):
        return "worker died (KilledWorker)"
    return f"worker failed ({type(error).__name__}: {' '.join(str(error).split())[:200]})"
