"""The page of results: what its tables say of the rows, and that the page in docs/ is made of them."""

import re
from argparse import Namespace
from pathlib import Path

import numpy as np
import pytest

from benchmarks.known_logs import known
from benchmarks.results import LINES, RUNS, logs, noisier, simulated, suites, table
from tests.helpers.slam_rooms import LDS, ROOM, around_the_room, drifted, recording
from turtlebag.datasets.se2 import SE2

PAGE = (Path(__file__).parents[2] / "docs/results.md").read_text()


def test_a_line_holds_the_median_and_the_worst_of_its_runs():
    maps = [{"anchored_m": 0.001 * k, "within": 0.9 + 0.01 * k} for k in range(RUNS)]
    runs = [{"worst_error_m": 0.01 * k, "success": 1} for k in range(1, RUNS)]
    runs.append({"worst_error_m": None, "success": 0})
    head, *lines = simulated({"arena": maps, "patrol": runs})
    assert head == ["measured", "runs", "median", "worst", "command"]
    assert [line[1:4] for line in lines] == [
        ["10", "4.5 mm", "9.0 mm"],
        ["10", "94.5 %", "90.0 %"],
        ["9 of 10 arrived", "5.0 cm", "9.0 cm"],
    ]
    assert table([head, lines[0]]).splitlines()[2].endswith("| `python -m benchmarks.results arena` |")


def test_a_row_with_too_few_runs_is_left_out_and_a_run_that_failed_is_counted():
    whole = [{"anchored_m": 0.001, "within": 1.0}] * RUNS
    assert len(list(simulated({"arena": whole[1:]}))) == 1
    lines = list(simulated({"arena": [*whole, {"error": "it fell over"}]}))[1:]
    assert [line[1] for line in lines] == ["10, 1 failed"] * 2


def test_a_log_is_told_as_recorded_beside_its_noisier_runs():
    verdicts = ["good", "doubtful", *["good"] * (RUNS - 1)]
    rows = [{"seed": k, "m": 0.01 * k, "deg": 0.1 * k, "verdict": v} for k, v in enumerate(verdicts)]
    (line,) = list(logs({"intel": rows}))[1:]
    assert line[:5] == ["intel", "0.0000 / 0.000", "0.0550 / 0.550", "0.1000 / 1.000", "10 of 11"]
    assert list(logs({"intel": rows[:-1]}))[1:] == []


def test_noise_is_drawn_from_the_seed_and_none_is_added_to_seed_0():
    truth = around_the_room(40)
    log = known(recording(ROOM, truth, LDS, odometry=drifted(truth)), SE2.from_array(truth))
    assert noisier(log, 0) is log
    one, again, two = (noisier(log, seed).recording for seed in (1, 1, 2))
    np.testing.assert_array_equal(one.ranges, again.ranges)
    ranges = log.recording.ranges
    there = np.isfinite(ranges)
    assert float(np.std((one.ranges - ranges)[there])) == pytest.approx(0.01, rel=0.1)
    assert not np.array_equal(one.ranges, two.ranges)
    assert not np.array_equal(one.T_odom_base.xyt, log.odometry.xyt)
    assert isinstance(one.T_odom_base, SE2)


def test_every_row_of_the_page_is_measured_by_the_command_beside_it(tmp_path):
    known_rows = suites(Namespace(out=tmp_path, runs=30))
    named = set(re.findall(r"`python -m benchmarks\.results ([\w-]+)`", PAGE))
    assert named
    assert named <= set(known_rows)
    assert {line.row for line in LINES} <= set(known_rows)
    for line in LINES:
        if line.row in named:
            assert f"| {line.what} |" in PAGE
    assert re.search(r"commit [0-9a-f]{7,}", PAGE)
