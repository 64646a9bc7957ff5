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


def run(words, stdout, stderr=subprocess.PIPE):
    return subprocess.run(
        [sys.executable, "-c", SAY, *map(str, words)], stdout=stdout, stderr=stderr, text=True, timeout=60
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
