"""The board: its lines, its inputs, and somebody's result measured."""

import csv
import json

import pytest
import yaml

from turtlebag.datasets.se2 import SE2
from turtlebag.datasets.trajectories import load_tum, save_tum
from turtlebag.datasets.types import Trajectory
from turtlebag.pipeline.board.board import Chapter, Run, lines_of
from turtlebag.pipeline.board.inputs import CHAPTERS, HASHES, drives, find_drive
from turtlebag.pipeline.campaign.campaign_file import load_campaign
from turtlebag.pipeline.campaign.cases import cases
from turtlebag.pipeline.campaign.figures import draw_figures
from turtlebag.pipeline.cli.main import main
from turtlebag.reports.figures.album import Album
from turtlebag.reports.page import fill

ROW = {"case": "a", "world": "arena", "sensors": "realistic", "system": "ours", "failed": False, "error": ""}
SPACE = "\N{NARROW NO-BREAK SPACE}"


def test_every_drive_has_a_stated_hash_and_no_hash_is_left_over():
    found = {}
    for chapter, name in CHAPTERS.items():
        campaign = load_campaign(name)
        found |= drives(chapter, campaign, cases(campaign))
    assert {name: drive.sha256 for name, drive in found.items()} == yaml.safe_load(HASHES.read_text())
    assert find_drive("house-realistic-1").command == (
        "turtlebag record --world turtlebot3_house --teleop tour --seed 1"
    )
    assert "--world office:1" in find_drive("office-faulty-1").command


def test_a_line_has_the_median_and_the_range_and_counts_failures():
    campaign = load_campaign("board")
    nothing = dict.fromkeys(campaign.results)
    rows = [
        {**ROW, **nothing, "seed": seed, "ate_aligned_m": ate} for seed, ate in enumerate((0.03, 0.01, 0.02))
    ]
    rows.append({**ROW, **nothing, "seed": 3, "failed": True, "error": "map: broke"})
    rows.append({**ROW, **nothing, "seed": 0, "system": "wheels", "ate_aligned_m": 0.5})
    ours, wheels = lines_of(campaign, rows)
    assert (ours.kind, ours.system, ours.runs, ours.failed) == ("arena, realistic", "ours", 4, 1)
    assert ours.numbers["ate_aligned_m"] == (
        0.02,
        f"20.0{SPACE}mm (10.0{SPACE}mm to 30.0{SPACE}mm)",
    )
    assert ours.numbers["wall_m"] == (None, "\N{EN DASH}")
    assert wheels.numbers["ate_aligned_m"] == (0.5, f"500.0{SPACE}mm")


def test_a_line_counts_those_that_say_yes():
    campaign = load_campaign("board_barn")
    nothing = dict.fromkeys(campaign.results)
    row = {"case": "a", "world": 25, "sensors": "clean", "system": "ours", "failed": False, "error": ""}
    (line,) = lines_of(
        campaign, [{**row, **nothing, "seed": seed, "arrived": seed > 1} for seed in (1, 2, 3)]
    )
    assert (line.kind, line.numbers["arrived"]) == ("25, clean", (pytest.approx(2 / 3), "2 of 3"))
    (line,) = lines_of(campaign, [{**row, **nothing, "seed": 1, "arrived": False}])
    assert line.numbers["arrived"] == (0.0, "no")


def test_a_chapter_of_which_every_row_failed_has_its_figures_without_marks(tmp_path):
    campaign = load_campaign("board")
    row = {**ROW, **dict.fromkeys(campaign.results), "seed": 1, "failed": True, "error": "map: broke"}
    album = Album(tmp_path)
    draw_figures(campaign, [row], album)
    assert len(album.pictures) == len(campaign.figures)


def test_the_page_says_why_a_row_failed_what_is_left_out_and_how_to_make_it_again():
    campaign = load_campaign("board")
    row = {**ROW, **dict.fromkeys(campaign.results), "seed": 1, "failed": True, "error": "map: ran <long>"}
    chapter = Chapter(
        "mapping",
        campaign,
        lines_of(campaign, [row]),
        [Run("arena-realistic-1", "ours", ("turtlebag map x",), "", row, "failed")],
        [("arena-realistic-1", "yag_slam", "peer-yag-slam is not installed")],
        [find_drive("arena-realistic-1")],
        {"arena-realistic-1": "0" * 64},
        [],
    )
    page = fill("board.html.j2", sizes="1 input, 1 row", failed=1, chapters=[chapter], words=str)
    assert "1 input, 1 row, 1 failed" in page
    assert "map: ran &lt;long&gt;" in page
    assert "arena-realistic-1, ours: failed" in page
    assert "other bytes than stated" in page
    assert "turtlebag map x" in page
    assert "peer-yag-slam is not installed" in page


def test_an_unknown_input_is_told_in_one_line(tmp_path, capsys):
    poses = tmp_path / "poses.tum"
    save_tum(Trajectory.untimed(SE2.from_xyt([0.0, 1.0], [0.0, 0.0], [0.0, 0.0])), poses)
    out = tmp_path / "out"
    assert main(["board", "submit", str(poses), "--input", "house-realistic-9", "--out", str(out)]) == 2
    said = capsys.readouterr().err.splitlines()
    assert said == [
        "turtlebag: --input house-realistic-9: not an input of the board; did you mean house-realistic-1?"
    ]
    assert not out.exists()
    assert main(["board"]) == 2
    assert capsys.readouterr().err.splitlines() == ["turtlebag: board: --out DIR is needed"]
    assert main(["board", "--inputs", "attic-*", "--out", str(out)]) == 2
    assert capsys.readouterr().err.splitlines() == [
        "turtlebag: --inputs attic-*: fits no input; for example house-clean-1, barn-25-realistic-1"
    ]
    assert not out.exists()


@pytest.mark.parametrize(
    ("lines", "why"),
    [
        ("", "no poses"),
        ("1 0 0 0 0 0 0 1\n", "one pose; a trajectory has two or more"),
        (
            "1 0 0 0 0 0 0 1\n1 1 0 0 0 0 0 1\n",
            "stamps must rise, but pose 2 is not later than the one before",
        ),
        ("1 0 0 0 0 0 0 1\n2 1 0 0 0 0 0 0\n", "line 2: its quaternion is zero"),
        ("1 nan 0 0 0 0 0 1\n", "line 1: expected 't x y z qx qy qz qw', all finite"),
        ("1 0 0 0 0 0 0 1\n" * 7_000_000, "112 MB; a trajectory has at most 100 MB"),
    ],
    ids=["empty", "one", "stamp twice", "no quaternion", "nan", "huge"],
)
def test_poses_that_no_error_can_be_told_of_are_refused_in_one_line(tmp_path, capsys, lines, why):
    poses, out = tmp_path / "poses.tum", tmp_path / "out"
    poses.write_text(lines)
    assert main(["board", "submit", str(poses), "--input", "arena-realistic-1", "--out", str(out)]) == 2
    (said,) = capsys.readouterr().err.splitlines()
    assert said.startswith(f"turtlebag: {poses}")
    assert said.endswith(why)
    assert not out.exists()


@pytest.mark.slow
def test_a_query_is_planned_by_every_planner_and_its_page_says_how(tmp_path, capsys):
    out = tmp_path / "out"
    command = ["board", "--inputs", "planning-arena-1-1", "--workers", "1", "--out", str(out)]
    assert main(command) == 0
    assert capsys.readouterr().out.strip() == str(out / "board.html")
    with (out / "planning/rows.csv").open() as file:
        rows = list(csv.DictReader(file))
    assert [row["system"] for row in rows] == list(load_campaign("board_plan").factors["system"])
    assert all(row["found"] == "True" and float(row["planning_s"]) > 0.0 for row in rows)
    page = (out / "board.html").read_text()
    assert (
        "turtlebag record --world turtlebot3_world --teleop tour --seed 1 --out planning-arena-1-1-drive"
        in page
    )
    kept = next((out / "planning/cases").glob(f"{rows[0]['case']}/plan/manifest.json"))
    assert json.loads(kept.read_text())["outputs"]["path.csv"] in page
    assert main(command) == 2


@pytest.mark.slow
def test_poses_beside_the_truth_are_measured_and_right_once_aligned(tmp_path, capsys):
    record = tmp_path / "record"
    words = find_drive("arena-realistic-1").command.split()[1:]
    assert main([*words, "--out", str(record), "-q"]) == 0
    true = load_tum(record / "truth/trajectory.tum")
    poses, out = tmp_path / "aside.tum", tmp_path / "aside"
    save_tum(
        Trajectory(true.stamps_ns, SE2.from_xyt(true.poses.x + 0.05, true.poses.y, true.poses.yaw)), poses
    )
    assert main(["board", "submit", str(poses), "--input", "arena-realistic-1", "--out", str(out)]) == 0
    metrics = json.loads((out / "metrics.json").read_text())
    assert metrics["ate_m"]["rmse"] == pytest.approx(0.05, abs=1e-6)
    assert metrics["ate_aligned_m"]["rmse"] == pytest.approx(0.0, abs=1e-6)
    assert metrics["covered"] == 1.0
    assert "trajectory error 50.0" in capsys.readouterr().out
    late = tmp_path / "late.tum"
    save_tum(Trajectory(true.stamps_ns * 3, true.poses), late)
    out = tmp_path / "late"
    assert main(["board", "submit", str(late), "--input", "arena-realistic-1", "--out", str(out)]) == 2
    assert capsys.readouterr().err.splitlines()[-1].endswith("another recording?")
    assert not out.exists()
