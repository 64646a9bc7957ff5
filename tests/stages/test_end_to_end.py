"""From end to end, by numbers: record, map, navigate and report, as in the tutorial."""

import io
import json
import re
from contextlib import redirect_stdout
from pathlib import Path

import numpy as np
import pytest

from tests.helpers.page_commands import run_page
from tests.helpers.report_fakes import unrendered
from tests.helpers.viewer import unresolved
from turtlebag.datasets.maps import load_map
from turtlebag.datasets.trajectories import load_tum
from turtlebag.pipeline.cli.main import main
from turtlebag.pipeline.stages.verify import verify

pytestmark = [pytest.mark.slow, pytest.mark.longest]

ROOT = Path(__file__).parents[2]
STAGES = ("rec", "map", "goal", "patrol", "avoid", "report")


def turtlebag(*words: object) -> int:
    return main(["--quiet" if word == "-q" else str(word) for word in words])


@pytest.fixture(scope="module")
def stages(tmp_path_factory):
    """Folder in which the commands of the tutorial have run as written; what they said is in `said.txt`.

    But verify makes the report alone once more: on a smaller one test_verify has every stage made again.
    Nothing moves in it: test_report has animations. The twin and the lines for each thing take short ones.
    """
    instead = {
        "verify report": "verify report --quick",
        "report rec": "report --no-animation rec",
        "map rec --edits": "map tomorrow --edits",
        "identify rec": "identify tomorrow",
        "twin rec": "twin goal",
    }
    folder = tmp_path_factory.mktemp("tutorial")
    with pytest.MonkeyPatch.context() as patch, redirect_stdout(io.StringIO()) as said:
        run_page(ROOT / "docs/tutorial.md", folder, patch, instead)
    (folder / "said.txt").write_text(said.getvalue())
    return folder


def metrics(folder):
    return json.loads((folder / "metrics.json").read_text())


def test_a_viewer_finds_everything_of_its_layout_in_the_bags(stages):
    layouts = {path.name: json.loads(path.read_text()) for path in stages.glob("report/foxglove-layout*")}
    on_map, on_odometry = layouts["foxglove-layout.json"], layouts["foxglove-layout-odom.json"]
    assert unresolved(on_map, stages / "patrol/bag", without={"/points"}) == []
    assert unresolved(on_odometry, stages / "rec/bag", without={"/points", "/amcl_pose"}) == []


def test_the_pages_on_files_name_every_file_of_every_stage(stages):
    page = (ROOT / "docs/files.md").read_text()
    rows = dict(re.findall(r"^\| `(\w+)` \| (.+) \|$", page, re.M))
    for folder in STAGES:
        manifest = json.loads((stages / folder / "manifest.json").read_text())
        parts = {path.partition("/")[0] + "/" * ("/" in path) for path in manifest["outputs"]}
        assert {part for part in parts if f"`{part}`" not in rows[manifest["stage"]]} == set()


def test_the_map_trajectory_is_within_three_centimetres_of_the_truth(stages):
    found = metrics(stages / "map")
    assert found["ate_m"]["rmse"] < 0.03
    scans = load_tum(stages / "rec" / "truth" / "trajectory.tum")
    estimate = load_tum(stages / "map" / "trajectory.tum")
    np.testing.assert_array_equal(estimate.stamps_ns, scans.stamps_ns)


def test_the_map_shows_the_pillars_and_no_second_wall(stages):
    grid = load_map(stages / "map" / "map.yaml")
    assert metrics(stages / "map")["map"]["occupied_error_m"]["p95"] <= 0.05 + 1e-9
    rim = 0.15 * np.stack([np.cos(np.arange(0, 6.28, 0.2)), np.sin(np.arange(0, 6.28, 0.2))], axis=-1)
    for pillar in [(x, y) for x in (-1.1, 0.0, 1.1) for y in (-1.1, 0.0, 1.1) if (x, y) != (0.0, 0.0)]:
        around = grid.value_at(np.array(pillar) + rim)
        assert (around == 100).sum() >= 8, f"pillar {pillar} is not on the map"
    assert grid.value_at(np.array([[-2.0, -0.5], [0.0, 2.0], [2.0, 0.0]])).tolist() == [0, 0, 0]


def test_every_waypoint_is_reached_without_a_touch(stages):
    found = metrics(stages / "patrol")
    assert found["success"]
    assert [goal["status"] for goal in found["goals"]] == ["reached"] * 8
    assert all(goal["error_m"] < 0.05 and goal["error_rad"] < 0.09 for goal in found["goals"])
    assert found["collisions"] == {"visible": 0, "low": 0}
    assert found["localisation_error_m"]["rmse"] < 0.03


def test_the_report_stands_alone_and_says_where_numbers_come_from(stages):
    page = (stages / "report" / "index.html").read_text()
    assert "http://" not in page.replace("http://www.w3.org", "")
    assert "<svg" in page or 'src="data:image/' in page
    for stage in STAGES[:-1]:
        manifest = json.loads((stages / stage / "manifest.json").read_text())
        assert manifest["outputs"]["config.yaml"][:12] in page
    assert "turtlebag map" in page


def test_the_report_made_again_is_the_same(stages):
    said = (stages / "said.txt").read_text()
    assert " recomputed numbers agree, " in said
    assert "DIFFERS" not in said
    assert "NOT RUN" not in said


def test_quiet_stages_print_their_results_and_nothing_else(stages, tmp_path, capfd):
    (tmp_path / "dash.yaml").write_text("name: dash\nv: 0.2\nw: 0.8\nsteps:\n  - {through: [[-1.8, -0.5]]}\n")
    world, grid = ("--world", "turtlebot3_world", "--seed", 5), ("--map", stages / "map" / "map.yaml")
    record, page = tmp_path / "record", tmp_path / "report"
    commands = {
        "record": ("record", *world, "--teleop", tmp_path / "dash.yaml"),
        "map": ("map", record, "--explain", "--name", "map_dash"),
        "localise": ("localise", record, *grid, "--initial-pose=-2,-0.5,0"),
        "plan": ("plan", "--map", stages / "map", "--start=-2,-0.5,0", "--goal=-1.5,-1.5,0"),
        "avoid": ("navigate", *world, "--task", "avoid", "--duration", 1),
        "explore": ("navigate", *world, "--task", "explore", "--duration", 1),
        "report": ("report", "--no-animation", record, tmp_path / "map"),
        "convert": ("bag", "convert", record),
        "recover": ("bag", "recover", record),
    }
    for name, (verb, *words) in commands.items():
        with unrendered():
            assert turtlebag(verb, "-q", *words, "--out", tmp_path / name) in (0, 1), name
        assert capfd.readouterr() == (f"{page / 'index.html'}\n" if name == "report" else "", ""), name
    for ending in ("pgm", "yaml"):
        kept, called = (tmp_path / f"map/{name}.{ending}" for name in ("map", "map_dash"))
        assert called.read_bytes() == kept.read_bytes().replace(b"image: map.pgm", b"image: map_dash.pgm")


def test_a_robot_that_was_not_told_its_pose_refuses_and_says_so(stages, tmp_path):
    task = ("--world", "turtlebot3_world", "--task", "goal", "--goal=0,2,0", "--map", stages / "map")
    assert turtlebag("navigate", *task, "--out", tmp_path / "untold") == 1
    found = metrics(tmp_path / "untold")
    assert found["goals"][0]["status"] == "rejected"
    assert "no initial pose" in found["goals"][0]["reason"]
    assert found["distance_m"] < 0.01
    # It ended before the first scan; that can be shown, and checked, too.
    assert turtlebag("report", tmp_path / "untold", "--no-animation", "--out", tmp_path / "report") == 0
    seen = verify(tmp_path / "report")
    assert (seen.problems, seen.not_run) == ([], [])
    assert "0 of 1 task succeeded" in (tmp_path / "report" / "index.html").read_text()
