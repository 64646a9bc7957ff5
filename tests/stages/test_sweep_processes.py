"""Campaigns in processes of their own: killed and started again, on a scheduler with two workers."""

import os
import signal
import subprocess
import sys
import time
from pathlib import Path

import distributed
import pytest

from turtlebag.datasets.outputs import sha256_tree

pytestmark = pytest.mark.slow

ROOT = Path(__file__).parents[2]
CAMPAIGN = """
name: small
factors: {size: [1, 2, 3, 4, 5, 6], seed: {first: 1, last: 3}}
stages: {make: "fake --size {size} --seed {seed}"}
results: {error_m: "make:error"}
"""
# Loaded by the command and by every worker: stages that take a moment and say which process ran them.
STAND_IN = """
import os, sys, time
from pathlib import Path
from turtlebag.datasets.outputs import write_json, write_manifest

def main(argv):
    out = Path(argv[argv.index("--out") + 1])
    time.sleep(0.15)
    Path(os.environ["RAN"], f"{os.getpid()}-{time.monotonic_ns()}").touch()
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
    options = {"scheduler": sys.argv[3]} if len(sys.argv) > 3 else {"workers": 1}
    sys.exit(sweep(sys.argv[1], Path(sys.argv[2]), main, **options))
"""


@pytest.fixture
def place(tmp_path):
    """A folder with the campaign, the stand-in and the notes of what ran."""
    (tmp_path / "small.yaml").write_text(CAMPAIGN)
    (tmp_path / "stand_in.py").write_text(STAND_IN)
    (tmp_path / "ran").mkdir()
    return tmp_path


def start(place, *words):
    environment = {**os.environ, "PYTHONPATH": str(ROOT), "RAN": str(place / "ran")}
    with (place / "log").open("ab") as log:
        return subprocess.Popen(
            [sys.executable, *map(str, words)],
            env=environment,
            cwd=place,
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
                place / "whole",
                stand_in["main"],
                scheduler=cluster.scheduler_address,
            )
            == 1
        )
    return place / "whole"


def test_a_killed_campaign_goes_on_where_it_was_and_ends_in_the_same_bytes(place, monkeypatch):
    run = ["stand_in.py", "small.yaml"]
    killed = start(place, *run, "parts")
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


def test_a_scheduler_with_two_workers_survives_the_loss_of_one(place):
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
        for _ in range(2):
            options = ["--nthreads", "1", "--no-nanny", "--no-dashboard", "--preload", "stand_in.py"]
            workers.append(
                start(place, "-m", "distributed.cli.dask_worker", "--scheduler-file", "where", *options)
            )
        wait_until(lambda: (place / "log").read_text().count("Registered to:") == 2, scheduler)
        address = next(
            line.split()[-1] for line in (place / "log").read_text().splitlines() if "Scheduler at:" in line
        )
        run = start(place, "stand_in.py", "small.yaml", "out", address)
        wait_until(lambda: rows(place / "out.partial") >= 6, run)
        os.killpg(workers[0].pid, signal.SIGKILL)
        assert run.wait(120) == 1
    finally:
        for process in (*workers, scheduler):
            if process.poll() is None:
                os.killpg(process.pid, signal.SIGKILL)
            process.wait()
    ran = {path.name.split("-")[0] for path in (place / "ran").iterdir()}
    assert ran == {str(worker.pid) for worker in workers}
    assert len(list(place.glob("out/cases/*"))) == 17
    assert "out: 18 cases, 1 failed" in (place / "log").read_text()
