"""Campaigns in processes of their own: killed and started again, on a scheduler with two workers."""

import os
import signal
import subprocess
import sys
import time
from pathlib import Path

import pytest

from turtlebag.datasets.outputs import Output, sha256_tree
from turtlebag.pipeline.campaign.store import Store
from turtlebag.pipeline.campaign.table import query

pytestmark = pytest.mark.slow

ROOT = Path(__file__).parents[2]
CAMPAIGN = """
name: small
factors: {size: [1, 2, 3, 4, 5, 6], seed: {first: 1, last: 3}}
stages: {make: "fake --size {size} --seed {seed}"}
results: {error_m: "make:error"}
"""
SHARED = CAMPAIGN.replace("{make:", '{base: "base --size {size} --seed 0", make:') + "shared: [base]\n"
# Loaded by the command and by every worker: stages that take TAKES seconds and say which process ran them.
STAND_IN = """
import os, sys, time
from pathlib import Path
from turtlebag.datasets.outputs import Output, write_json, write_manifest

class Words(tuple):
    def moved(self, place):
        return Words(map(place, self))

def run(argv, output):
    out = output.folder
    note = Path(os.environ["RAN"], f"{os.getpid()}-{argv[0]}-{argv[2]}-{argv[4]}-{time.monotonic_ns()}")
    if argv[0] == "base":
        note.with_suffix(".begun").touch()
        time.sleep(0.5)
    time.sleep(float(os.environ.get("TAKES", "0")))
    note.touch()
    if argv[2] == "6" and argv[4] == "3":
        raise RuntimeError("a defect")
    out.mkdir(parents=True, exist_ok=True)
    write_json(out / "metrics.json", {"error": 0.1 * int(argv[2]) + 0.01 * int(argv[4])})
    write_manifest(out, stage="fake", command=[], inputs={}, seed=None, wall_s=0.0)
    return 0

if __name__ == "__main__":
    from turtlebag.pipeline.campaign.sweep import sweep
    from turtlebag.pipeline.terminal.messages import set_verbosity
    set_verbosity(0)
    options = {"scheduler": sys.argv[3], "store": sys.argv[4]} if len(sys.argv) > 3 else {"workers": 1}
    sys.exit(sweep(sys.argv[1], Output(Path(sys.argv[2])), run=run, read=Words, **options))
"""
# The lock of a lost worker is given up sooner than usual.
LOCKS = {
    "DASK_DISTRIBUTED__SCHEDULER__LOCKS__LEASE_TIMEOUT": "4s",
    "DASK_DISTRIBUTED__SCHEDULER__LOCKS__LEASE_VALIDATION_INTERVAL": "0.5s",
}


@pytest.fixture
def place(tmp_path):
    """A folder with the campaign, the stand-in and the notes of what ran."""
    (tmp_path / "small.yaml").write_text(CAMPAIGN)
    (tmp_path / "stand_in.py").write_text(STAND_IN)
    (tmp_path / "ran").mkdir()
    return tmp_path


def start(place, *words, at=None, **more):
    environment = {**os.environ, "PYTHONPATH": str(ROOT), "RAN": str(place / "ran"), **LOCKS, **more}
    with (place / "log").open("ab") as log:
        return subprocess.Popen(
            [sys.executable, *map(str, words)],
            env=environment,
            cwd=at or place,
            stdout=log,
            stderr=log,
            start_new_session=True,
        )


def wait_until(true, process, seconds=120.0):
    end = time.monotonic() + seconds
    while not true():
        assert process.poll() is None, "it ended before"
        assert time.monotonic() < end, "it does not come"
        time.sleep(0.02)


def rows(folder):
    return len(list(folder.glob("rows/*.json")))


def undisturbed(place, monkeypatch):
    """The campaign's folder made in this process, by threads."""
    import distributed  # only here: every worker collects this file

    from turtlebag.pipeline.campaign.sweep import sweep

    monkeypatch.setenv("RAN", str(place))
    stand_in = {"__name__": "stand_in"}
    exec(STAND_IN, stand_in)
    with distributed.LocalCluster(
        1, threads_per_worker=1, processes=False, dashboard_address=None
    ) as cluster:
        assert (
            sweep(
                str(place / "small.yaml"),
                Output(place / "whole"),
                run=stand_in["run"],
                read=stand_in["Words"],
                scheduler=cluster.scheduler_address,
            )
            == 1
        )
    return place / "whole"


def test_a_killed_campaign_goes_on_where_it_was_and_ends_in_the_same_bytes(place, monkeypatch):
    run = ["stand_in.py", "small.yaml"]
    killed = start(place, *run, "parts", TAKES="0.15")
    wait_until(lambda: rows(place / "parts.partial") >= 4, killed)
    os.killpg(killed.pid, signal.SIGKILL)
    killed.wait()
    done = rows(place / "parts.partial")
    assert 4 <= done < 18
    assert not (place / "parts").exists()
    again = start(place, *run, "parts")
    assert again.wait(120) == 1
    # No case that had left its row was run again; of the others at most the one that was under way.
    assert 18 <= len(list((place / "ran").iterdir())) <= 18 + 1
    assert sha256_tree(place / "parts") == sha256_tree(undisturbed(place, monkeypatch))
    said = (place / "log").read_text()
    assert f"resuming: {done} of 18 cases are done" in said
    assert "parts: 18 cases, 1 failed" in said


def begun(place):
    """Shared outputs that are under way: process and which, of those that have begun and not ended."""
    names = [path.name for path in (place / "ran").iterdir()]
    ended = {name for name in names if not name.endswith(".begun")}
    return [
        tuple(name.split("-")[:3:2]) for name in names if name.endswith(".begun") and name[:-6] not in ended
    ]


def test_workers_with_nothing_but_a_store_in_common_survive_the_loss_of_one(place):
    (place / "small.yaml").write_text(SHARED)
    scheduler = start(
        place,
        "-m",
        "distributed.cli.dask_scheduler",
        "--port",
        "0",
        "--no-dashboard",
        "--scheduler-file",
        "where",
    )
    workers = []
    try:
        wait_until((place / "where").exists, scheduler)
        options = ["--nthreads", "1", "--no-nanny", "--no-dashboard", "--local-directory", "."]
        options += ["--scheduler-file", place / "where", "--preload", place / "stand_in.py"]
        for number in range(2):
            own = place / f"worker-{number}"
            own.mkdir()
            workers.append(start(place, "-m", "distributed.cli.dask_worker", *options, at=own, TAKES="0.15"))
        wait_until(lambda: (place / "log").read_text().count("Registered to:") == 2, scheduler)
        address = next(
            line.split()[-1] for line in (place / "log").read_text().splitlines() if "Scheduler at:" in line
        )
        run = start(place, "stand_in.py", "small.yaml", "out", address, (place / "store").as_uri())
        wait_until(lambda: begun(place), run)
        pid, half_made = begun(place)[0]
        lost = next(worker for worker in workers if worker.pid == int(pid))
        os.killpg(lost.pid, signal.SIGKILL)
        assert run.wait(120) == 1
    finally:
        for process in (*workers, scheduler):
            if process.poll() is None:
                os.killpg(process.pid, signal.SIGKILL)
            process.wait()
    made = [path.name.split("-")[1:4] for path in (place / "ran").iterdir() if path.suffix != ".begun"]
    # Each shared output once, that of the lost worker by another; every case, and the broken one as it is.
    assert sorted(size for stage, size, _ in made if stage == "base") == list("123456")
    assert (pid, half_made) in begun(place)
    assert len([stage for stage, *_ in made if stage == "fake"]) == 18
    _, table = query(Store(str(place / "store/small")), "SELECT size, seed, error_m, failed FROM runs")
    expected = {
        (i, k): None if (i, k) == (6, 3) else round(0.1 * i + 0.01 * k, 9)
        for i in range(1, 7)
        for k in (1, 2, 3)
    }
    assert {(i, k): error and round(error, 9) for i, k, error, _ in table} == expected
    assert [(i, k) for i, k, _, failed in table if failed] == [(6, 3)]
    assert "out: 18 cases, 1 failed" in (place / "log").read_text()
    assert {path.name for path in (place / "store").iterdir()} == {"outputs", "small"}
    assert not list(place.glob("worker-*/**/*.json"))
