"""The mapper's campaign: its order, its rows and its verdicts."""

import functools
import importlib
import json
import os
import time
from functools import partial
from itertools import groupby
from pathlib import Path

import pytest

from benchmarks import runner as frame
from benchmarks import slam_campaign, slam_logs
from benchmarks.disturb import KINDS
from benchmarks.known_logs import known
from benchmarks.runner import Case, Rows, every, in_processes
from benchmarks.slam_logs import BARE, LIDARS, MADE, MISHAPS, WORLDS, drive_cases, mishap_cases
from benchmarks.slam_parts import NUMBERS, multiply_constant
from benchmarks.slam_scores import accuracy
from tests.helpers.slam_rooms import LDS, ROOM, around_the_room, drifted, recording
from turtlebag.datasets.se2 import SE2
from turtlebag.pipeline.slam.mapper import SlamConfig
from turtlebag.pipeline.slam.scans import align, correspondences
from turtlebag.pipeline.slam.sensors import range_calibration
from turtlebag.sim.worlds import load_world


def test_any_first_part_of_the_drives_has_as_many_of_each_kind():
    cases = drive_cases()
    assert len(cases) == len({case.name for case in cases}) == 300
    for first in (10, 60, 120):
        for key in ("robot", "world"):
            values = [case.about[key].partition(":")[0] for case in cases[:first]]
            assert len({values.count(value) for value in values}) == 1
    kinds = [
        tuple(case.about[key].partition(":")[0] for key in ("world", "robot", "teleop")) for case in cases
    ]
    assert len(set(kinds[:60])) == 60


def test_mishaps_are_ones_there_are_and_each_log_s_lidars_are_measured_together():
    for place in BARE:
        assert "round" in load_world(str(WORLDS / f"{place}.yaml")).routes
    assert {kind for _, _, kinds in MISHAPS.values() for kind in kinds} <= set(KINDS)
    cases = mishap_cases(Path())
    assert len(cases) == len({case.name for case in cases}) == 116
    logs = [log for log, _ in groupby(case.about["log"] for case in cases)]
    assert logs == list(MADE)
    assert {MADE[log][2] for log in logs[:12]} == {1}  # a first part has each once


def test_a_log_with_mishaps_is_measured_with_every_lidar(tmp_path):
    poses = around_the_room(40)
    log = known(recording(ROOM, poses, LDS, odometry=drifted(poses)), SE2(poses))
    for lidar in LIDARS:
        row = slam_logs.lidar_row(log, "here", lidar, tmp_path)
        assert row["worst_m"] < 0.1, lidar
        assert row["driven_m"] == pytest.approx(log.truth.length())
    assert len(list((tmp_path / "maps").glob("*.png"))) == len(LIDARS)


def test_every_combination_of_levels_is_a_case_that_says_which():
    cases = every(dict, place=("arena", "house"), seed=range(2))
    assert [case.name for case in cases] == ["arena 0", "arena 1", "house 0", "house 1"]
    assert all(case.measure() == case.about for case in cases)


def test_every_number_of_the_sensitivity_study_is_one_there_is():
    for section in NUMBERS.values():
        path, _, fields = section.partition(": ")
        if fields:
            config = functools.reduce(getattr, path.split("."), SlamConfig())
            assert set(fields.split()) <= set(type(config).model_fields), section
        else:
            room, module, constant, *field = path.split(".")
            value = getattr(importlib.import_module(f"turtlebag.pipeline.slam.{room}.{module}"), constant)
            assert set(field) <= set(getattr(value, "_fields", ())), section


def test_a_constant_is_multiplied_wherever_it_is_read():
    changes = {}

    def change(module, name, value):
        changes[module, name] = value

    multiply_constant("scans.correspondences.FINE.sigma", 2.0, change)
    multiply_constant("scans.align.STEP_COVARIANCE_SCALE", 0.5, change)
    assert changes[correspondences, "FINE"] == (0.1, 0.06, 15, 10**6)
    for module in (align, range_calibration):
        assert changes[module, "STEP_COVARIANCE_SCALE"] == 2.5


def test_rows_of_the_same_code_are_kept_and_a_cut_line_is_none(tmp_path):
    file, cases = tmp_path / "s.jsonl", [Case(name, dict) for name in "abc"]
    rows = Rows(file, "code 1")
    rows.add("a", {"m": 1.0})
    rows.add("b", {"m": 2.0})
    with file.open("a") as cut:
        cut.write('{"case": "c", "m"')
    again = Rows(file, "code 1")
    assert again.of(cases) == [
        {"case": "a", "m": 1.0, "code": "code 1"},
        {"case": "b", "m": 2.0, "code": "code 1"},
    ]
    assert again.get("c") is None
    again.add("c", {"m": 3.0})
    assert len(Rows(file, "code 1").of(cases)) == 3
    other = Rows(file, "code 2")
    assert not other.of(cases)
    other.add("a", {"m": 4.0})
    assert [row["m"] for row in Rows(file, "code 1", keep=True).of(cases)] == [1.0, 2.0, 3.0]
    assert [row["m"] for row in Rows(file, "code 2", keep=True).of(cases)] == [4.0, 2.0, 3.0]


@pytest.mark.slow
def test_a_case_that_raises_dies_or_hangs_has_a_row_and_the_others_go_on():
    cases = [
        Case("raises", partial(int, "x"), {"kind": 1}),
        Case("dies", partial(os._exit, 3)),
        Case("works", partial(dict, m=1.0), {"kind": 2}),
        Case("works too", partial(dict, m=2.0)),
    ]
    rows = {case.name: row for case, row in in_processes(cases, 2, 60.0)}
    ((_, hung),) = in_processes([Case("hangs", partial(time.sleep, 60.0))], 1, 0.5)
    assert "ValueError" in rows["raises"]["error"]
    assert rows["raises"]["kind"] == 1
    assert "died" in rows["dies"]["error"]
    assert "more than" in hung["error"]
    assert rows["works"] == {"kind": 2, "m": 1.0}
    assert rows["works too"] == {"m": 2.0}


@pytest.mark.slow
def test_the_same_command_goes_on_where_it_was_stopped(tmp_path, monkeypatch, capsys):
    def suites(args):
        cases = [Case(str(k), partial(dict, m=k / 10)) for k in range(3)]
        return {"few": frame.Suite(cases, ("case", "m"), code=("benchmarks/runner.py",))}

    monkeypatch.delenv("TURTLEBAG_DATA", raising=False)
    monkeypatch.setenv("TMPDIR", str(tmp_path))
    slam_campaign.main(["few", "--limit", "1", "--out", str(tmp_path / "out"), "--workers", "1"], suites)
    assert "1 cases, 1 to measure" in capsys.readouterr().out
    slam_campaign.main(["few", "--out", str(tmp_path / "out"), "--workers", "1"], suites)
    told = capsys.readouterr().out
    assert "3 cases, 2 to measure" in told
    assert "public logs are left out" in told
    assert "| 2 | 0.2000 |" in told
    lines = (tmp_path / "out/rows/few.jsonl").read_text().splitlines()
    assert [json.loads(line)["case"] for line in lines] == ["0", "1", "2"]
    assert (tmp_path / "out/few.csv").read_text().splitlines()[0] == "case,m,code"


def test_code_is_the_same_code_when_only_its_comments_change(tmp_path):
    file, found = tmp_path / "a.py", []
    for text in ("x = 1\n", "# why\nx = 1\n", "x = 2\n"):
        file.write_text(text)
        found.append(frame.code_of(("a.py",), tmp_path))
    assert found[0] == found[1] != found[2]


def test_figures_of_many_maps_count_those_far_off_and_what_was_said_of_them():
    drive = {"m": 0.01, "worst_m": 0.04, "anchored_worst_m": 0.04, "cpu_s": 1.0, "verdict": "good"}
    bad = {**drive, "worst_m": 0.3, "anchored_worst_m": 0.3}
    found = accuracy([drive, bad, {"error": "x"}])
    assert (found["maps"], found["errors"], found["under 10 cm"], found["of these good"]) == (2, 1, 1, 1)
    assert accuracy([{"error": "x"}]) == {"maps": 0, "errors": 1}
