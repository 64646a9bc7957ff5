"""Cases on Dask: a local cluster as large as the machine, or a scheduler somewhere else."""

from __future__ import annotations

import logging
import os
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from pathlib import Path
from typing import Any

from turtlebag.datasets.errors import InputError
from turtlebag.pipeline.campaign.campaign_file import Campaign, Case
from turtlebag.pipeline.campaign.case import Row, Run, row_of, run_case


@contextmanager
def _client(scheduler: str | None, workers: int | None) -> Iterator[Any]:
    """A Dask client; the local cluster has one single-threaded process a core and no dashboard."""
    try:
        import dask
        from distributed import Client, LocalCluster
    except ImportError:
        raise InputError("campaigns need Dask: run `make setup` again, or pip install distributed") from None
    logging.getLogger("distributed").setLevel(logging.ERROR)
    dask.config.set({"distributed.scheduler.allowed-failures": 1})
    if scheduler is not None:
        try:
            client = Client(scheduler, timeout="10s")
        except (OSError, ValueError):
            raise InputError(f"--scheduler {scheduler}: no scheduler answers there") from None
        with client:
            yield client
        return
    threads = {name: "1" for name in ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS")}
    with (
        LocalCluster(
            n_workers=workers or os.cpu_count() or 1,
            threads_per_worker=1,
            dashboard_address=":0",
            silence_logs=logging.CRITICAL,
            env=threads,
        ) as cluster,
        Client(cluster) as client,
    ):
        yield client


def run_cases(
    campaign: Campaign,
    todo: Sequence[Case],
    folder: Path,
    run: Run,
    *,
    scheduler: str | None = None,
    workers: int | None = None,
) -> Iterator[Row]:
    """Rows of the cases as they finish, in any order; a case whose worker died is a `failed` row.

    Workers write below `folder`: with a remote scheduler it must be on a file system they share.
    """
    from distributed import as_completed

    place = folder.resolve()
    with _client(scheduler, workers) as client:
        futures = {
            client.submit(
                run_case,
                case,
                campaign,
                place / case.name,
                run,
                key=f"{campaign.name}-{case.name}",
                pure=False,
            ): case
            for case in todo
        }
        for future in as_completed(list(futures)):
            case = futures[future]
            if future.status == "finished":
                yield future.result()
            else:
                # Not written: a resumed campaign tries the case again.
                yield row_of(case, campaign, f"worker died ({type(future.exception()).__name__})")
