"""Nobody reads what a command says, or there is no room for it: the work is done all the same."""

import os
import subprocess
import sys

import pytest

SAY = """
import sys
from pathlib import Path
from turtlebag.datasets.outputs import staged_output
from turtlebag.pipeline.cli import doctor, stage
def run(args):
    for number in range(3):
        print("line", number, "x" * 5000)
        print("aside", file=sys.stderr)
    if args.out is not None:
        with staged_output(args.out) as folder:
            print("more", flush=True)
            (folder / "a").write_text("whole")
            print("more", "x" * 9000, flush=True)
    return 1
stage.run = run
from turtlebag.pipeline.cli.main import main
sys.exit(main())
"""


def run(words, stdout, stderr=subprocess.PIPE, closed=()):
    return subprocess.run(
        [sys.executable, "-c", SAY, *map(str, words)],
        stdout=stdout,
        stderr=stderr,
        text=True,
        timeout=60,
        preexec_fn=lambda: [os.close(number) for number in closed],
    )


@pytest.fixture(params=["reader gone", "no room"])
def unwilling(request):
    """A stdout that takes nothing, and what is said of it."""
    if request.param == "no room":
        with open("/dev/full", "w") as full:
            yield full, "stdout: No space left on device"
        return
    reading, writing = os.pipe()
    os.close(reading)
    with os.fdopen(writing, "w") as pipe:
        yield pipe, ""


@pytest.mark.slow
def test_a_result_is_kept_when_its_words_are_lost(tmp_path, unwilling):
    stdout, said = unwilling
    done = run(["compare", "x", "y", "--out", tmp_path / "out"], stdout)
    assert done.returncode == 1  # what the command itself gives
    assert (tmp_path / "out" / "a").read_text() == "whole"
    lines = [line for line in done.stderr.splitlines() if line != "aside"]
    assert len(lines) == bool(said)
    assert all(said in line for line in lines)


@pytest.mark.slow
def test_without_an_output_the_words_are_the_result(unwilling):
    stdout, said = unwilling
    done = run(["compare", "x", "y"], stdout)
    assert done.returncode == (2 if said else 0)
    assert "Traceback" not in done.stderr
    assert "Exception ignored" not in done.stderr
    assert said in done.stderr


def test_a_lost_stderr_costs_nothing_either(tmp_path):
    with open("/dev/full", "w") as full:
        done = run(["compare", "x", "y", "--out", tmp_path / "out"], full, full)
    assert done.returncode == 1
    assert (tmp_path / "out" / "a").exists()


CLOSED = {"stdout": [1], "stderr": [2], "both": [1, 2], "all three": [0, 1, 2]}


@pytest.mark.slow
@pytest.mark.parametrize("closed", CLOSED)
def test_the_work_is_done_though_streams_are_closed(tmp_path, closed):
    done = run(["compare", "x", "y", "--out", tmp_path / "out"], subprocess.PIPE, closed=CLOSED[closed])
    assert done.returncode == 1  # what the command itself gives
    assert [path.read_text() for path in (tmp_path / "out").iterdir()] == ["whole"]
    assert ("line 2" in done.stdout) == (1 not in CLOSED[closed])
    lines = [line for line in done.stderr.splitlines() if line != "aside"]
    lost = "turtlebag: stdout: is closed; the rest of the output is lost"
    assert lines == ([lost] if closed == "stdout" else [])


@pytest.mark.slow
@pytest.mark.parametrize(
    ("words", "code"), [("--help", 0), ("--version", 0), ("world list", 0), ("world nothing", 2)]
)
def test_results_that_cannot_be_told_are_an_error_and_messages_that_cannot_are_none(words, code):
    for closed in CLOSED.values():
        done = subprocess.run(
            [sys.executable, "-m", "turtlebag", *words.split()],
            stdin=subprocess.DEVNULL,
            capture_output=True,
            text=True,
            timeout=60,
            preexec_fn=lambda closed=closed: [os.close(number) for number in closed],
        )
        assert done.returncode == (2 if 1 in closed else code)
        assert bool(done.stdout) == (1 not in closed and code == 0)
        lost = code == 0 and 1 in closed
        assert (done.stderr == "turtlebag: stdout: is closed\n") == (lost and 2 not in closed)
        assert done.stderr.count("\n") == (2 not in closed and (lost or code == 2))
