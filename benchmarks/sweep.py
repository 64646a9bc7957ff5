"""How campaigns scale: what a case costs that does nothing, a second core, a question to a million rows.

python -m benchmarks.sweep [--only PART ...] [--cases N] [--rows N] [--out DIR]

Parts:
  overhead  empty cases on a scheduler with two workers, each a process: milliseconds of a worker and of
            processors (workers, scheduler and command) for each, and the memory of scheduler and command
  speedup   maps of one drive, by one worker and by two, each of one thread
  query     the table of a million rows: how long it takes to write, and to ask
"""

from __future__ import annotations

import os
import tempfile
import time
from argparse import Namespace
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from functools import partial
from pathlib import Path
from typing import Annotated, Any

import turtlebag as tb
from benchmarks.runner import Row, held_mb, options, write
from turtlebag.datasets.outputs import Output
from turtlebag.pipeline.campaign.campaign_file import Campaign
from turtlebag.pipeline.campaign.case import Run, Where
from turtlebag.pipeline.campaign.cases import cases
from turtlebag.pipeline.campaign.engine import run_cases
from turtlebag.pipeline.campaign.store import Store
from turtlebag.pipeline.campaign.table import query, write_table
from turtlebag.pipeline.stages.command_line import read
from turtlebag.pipeline.stages.requests.options import Option
from turtlebag.pipeline.stages.requests.request import Request
from turtlebag.pipeline.stages.requests.table import REQUESTS
from turtlebag.pipeline.stages.run import run as run_stage

WORKERS = 2
MAPS = 40
SQL = "SELECT front_end, median(error_m), count(*) FILTER (failed) FROM runs GROUP BY front_end"


class Nothing(Request):
    """What is asked of a stage that does nothing."""

    VERB = "nothing"
    EXAMPLE = "turtlebag nothing 1 --out out"

    n: Annotated[int, Option("N", "its number", "1", read=int, positional=True)]


READ = partial(read, kinds={**REQUESTS, "nothing": Nothing})


def nothing(asked: Request, output: Output) -> int:
    """A stage that does nothing but leave the least that an output holds."""
    out = output.folder
    out.mkdir(parents=True)
    (out / "metrics.json").write_text('{"n": 1}')
    (out / "manifest.json").write_text("{}")
    return 0


def spent(pids: Sequence[int]) -> float:
    """Processor time of processes so far [s]."""
    fields = [Path(f"/proc/{pid}/stat").read_text().rpartition(")")[2].split() for pid in pids]
    return sum(int(field[11]) + int(field[12]) for field in fields) / os.sysconf("SC_CLK_TCK")


@contextmanager
def cluster(workers: int, folder: Path) -> Iterator[tuple[str, list[int]]]:
    """A scheduler and its workers as processes of their own: its address, and all of them, itself first."""
    from distributed.deploy.subprocess import SubprocessCluster

    os.environ |= {f"{name}_NUM_THREADS": "1" for name in ("OMP", "OPENBLAS", "MKL")}
    with SubprocessCluster(
        n_workers=workers, threads_per_worker=1, worker_class="distributed.Worker",
        dashboard_address=None,  # type: ignore[arg-type]  # its documentation has it, its annotation has not
        worker_kwargs={"local_directory": str(folder)},
    ) as made:  # fmt: skip
        yield made.scheduler_address, [p.process.pid for p in (made.scheduler, *made.workers.values())]


def timed(campaign: dict[str, Any], run: Run, workers: int, folder: Path, parts: int) -> Iterator[Row]:
    """At each of so many parts of the campaign: time since the first case was done, and memory."""
    made = Campaign.model_validate(campaign)
    runs, todo = (
        Store(str(folder / "store" / str(workers))),
        cases(made, READ),
    )
    with cluster(workers, folder) as (address, pids):
        where = Where(runs, runs.below("outputs"), "")
        found = run_cases(made, todo, where, run, folder, scheduler=address)
        kept = [next(found)]  # the workers have started and loaded what they need
        start, cpu_s = time.perf_counter(), spent([os.getpid(), *pids])
        for done, item in enumerate(found, start=1):
            kept.append(item)
            assert not item[0]["failed"], item[0]["error"]
            if done % max((len(todo) - 1) // parts, 1) == 0:
                times = {"wall_s": time.perf_counter() - start, "cpu_s": spent([os.getpid(), *pids]) - cpu_s}
                memory = {"scheduler_mb": held_mb(pids[0]), "command_mb": held_mb()}
                yield {"workers": workers, "cases": done, **times, **memory}


def overhead(args: Namespace, folder: Path) -> list[Row]:
    """Empty cases: milliseconds of a worker, and of all processors, for each."""
    campaign = {
        "name": "empty",
        "factors": {"n": {"first": 1, "last": args.cases}},
        "stages": {"nothing": "nothing {n}"},
        "results": {"n1": "nothing:n"},
    }
    rows = list(timed(campaign, nothing, WORKERS, folder, 10))
    for row in rows:
        row["worker_ms_a_case"] = 1000.0 * WORKERS * row["wall_s"] / row["cases"]
        row["cpu_ms_a_case"] = 1000.0 * row["cpu_s"] / row["cases"]
    return rows


def speedup(args: Namespace, folder: Path) -> list[Row]:
    """Maps of one drive by one worker and by two."""
    campaign = {
        "name": "maps",
        "bags": [str(tb.record("turtlebot3_world", out=folder / "drive").path)],
        "factors": {"n": {"first": 1, "last": MAPS}},
        "stages": {"map": "map {bag} --set grid.resolution_m={n:0.05+0*x}"},
        "results": {"scans": "map:scans"},
    }
    rows = [row for workers in (1, WORKERS) for row in timed(campaign, run_stage, workers, folder, 1)]
    return [{**row, "speed_up": rows[0]["wall_s"] / row["wall_s"]} for row in rows]


def queried(args: Namespace, folder: Path) -> list[Row]:
    """A table of so many rows, written and asked."""
    count, ends = args.rows, ("lines", "kiss_icp", "wheels")
    rows = [
        {
            "case": f"{k:016x}",
            "bag": f"s3://lab/2026-{k % 365:03d}/{k}.mcap",
            "front_end": ends[k % 3],
            "failed": k % 97 == 0,
            "error": "map: no /scan" if k % 97 == 0 else "",
            "error_m": None if k % 97 == 0 else (k * 7919 % 10007) / 1e5,
        }
        for k in range(count)
    ]
    store = Store(str(folder / "table"))
    start = time.perf_counter()
    write_table(rows, "front_end", store)
    written_s = time.perf_counter() - start
    start = time.perf_counter()
    query(store, SQL)
    asked_s = time.perf_counter() - start
    size = sum(path.stat().st_size for path in (folder / "table").rglob("*.parquet"))
    return [{"rows": count, "write_s": written_s, "query_s": asked_s, "mb": size / 1e6}]


PARTS = {"overhead": overhead, "speedup": speedup, "query": queried}


def main() -> None:
    parser = options(__doc__, "data/benchmarks/sweep", cases=10_000, rows=1_000_000)
    parser.add_argument("--only", nargs="+", choices=PARTS, default=list(PARTS), metavar="PART")
    args = parser.parse_args()
    with tempfile.TemporaryDirectory(prefix="turtlebag-") as scratch:
        for name in args.only:
            write(args.out, name, PARTS[name](args, Path(scratch)))


if __name__ == "__main__":
    main()
