"""plan, mapless goals, wiggling and exploring, each by numbers."""

import csv
import json
from pathlib import Path
from typing import get_args

import numpy as np
import pytest

from turtlebag.datasets.grid import FREE, OCCUPIED, OccupancyGrid
from turtlebag.datasets.maps import load_map, save_map
from turtlebag.datasets.outputs import Output, sha256_text, sha256_tree
from turtlebag.datasets.se2 import SE2
from turtlebag.pipeline.cli.main import main
from turtlebag.pipeline.navigation.mission import Request
from turtlebag.pipeline.stages.navigate import navigate
from turtlebag.planners.costmap import CostmapConfig, costmap_from_grid
from turtlebag.planners.ompl_planner import PlannerName
from turtlebag.sim.robots import FOLDER as ROBOTS
from turtlebag.sim.robots import load_robot
from turtlebag.sim.worlds import FOLDER, load_world

WORLD = "turtlebot3_world"
ARENA, BURGER = load_world(WORLD), load_robot("burger")


def plan_words(true_map: Path, out: Path, goal: str, *more: str) -> list[str]:
    return ["plan", "--map", str(true_map), "--start=-2,-0.5,0", f"--goal={goal}", "--out", str(out), *more]


def test_plan_writes_a_free_path_and_repeats_to_the_byte(true_map, tmp_path):
    for name in ("a", "b"):
        assert main(plan_words(true_map, tmp_path / name, "0.5,0.5,1.0", "--seed", "4")) == 0
    assert sha256_tree(tmp_path / "a") == sha256_tree(tmp_path / "b")
    with (tmp_path / "a" / "path.csv").open() as file:
        poses = np.array([[float(row[k]) for k in ("x", "y", "yaw")] for row in csv.DictReader(file)])
    np.testing.assert_allclose(poses[[0, -1]], [[-2.0, -0.5, 0.0], [0.5, 0.5, 1.0]], atol=1e-6)
    costmap = costmap_from_grid(load_map(true_map), CostmapConfig())
    assert costmap.clearance_at(poses[:, :2]).min() > 0.1485
    metrics = json.loads((tmp_path / "a" / "metrics.json").read_text())
    assert metrics["success"]
    assert metrics["length_m"] == pytest.approx(np.linalg.norm(np.diff(poses[:, :2], axis=0), axis=1).sum())


@pytest.mark.slow
def test_plan_without_a_way_fails_with_complete_outputs(true_map, tmp_path):
    # Walled in by keeping the robot too wide for every gap between the pillars.
    words = plan_words(true_map, tmp_path / "out", "0.5,0.5,0", "--set", "plan.margins=[0.4]")
    assert main(words) == 1
    assert (tmp_path / "out" / "path.csv").read_text() == "x,y,yaw\n"
    assert json.loads((tmp_path / "out" / "metrics.json").read_text())["reason"]


@pytest.mark.parametrize("goal", ["1.1,1.1,0", "50,0,0", "1,1,nan", "1,1"])
def test_plan_refuses_bad_goals(true_map, tmp_path, capsys, goal):
    assert main(plan_words(true_map, tmp_path / "out", goal)) == 2
    assert capsys.readouterr().err.count("\n") == 1
    assert not (tmp_path / "out").exists()


@pytest.mark.slow
def test_a_goal_without_a_map_is_reached_by_what_the_scans_show(tmp_path):
    request = Request(task="goal", seed=2, goal=SE2.from_xyt(0.55, -0.55, 0.0), timeout_s=90.0)
    assert navigate(ARENA, BURGER, request, Output(tmp_path / "run")) == 0
    metrics = json.loads((tmp_path / "run" / "metrics.json").read_text())
    assert metrics["localisation_error_m"] is None
    assert metrics["goals"][0]["error_m"] < 0.1
    assert metrics["collisions"] == {"visible": 0, "low": 0}


@pytest.mark.slow
def test_a_wrong_initial_pose_is_wiggled_right(true_map, tmp_path):
    request = Request(
        task="goal",
        seed=2,
        map_path=true_map,
        initial_pose=SE2.from_xyt(-1.8, -0.3, 0.25),
        goal=SE2.from_xyt(-1.5, -0.5, 0.0),
        wiggle=True,
    )
    assert navigate(ARENA, BURGER, request, Output(tmp_path / "run")) == 0
    metrics = json.loads((tmp_path / "run" / "metrics.json").read_text())
    assert metrics["goals"][0]["error_m"] < 0.05


def test_laps_and_durations_without_end_are_refused(true_map, tmp_path, capsys):
    base = ["navigate", "--world", WORLD, "--out", str(tmp_path / "run")]
    assert main([*base, "--task", "avoid", "--duration", "20000"]) == 2
    assert main([*base, "--task", "patrol", "--map", str(true_map), "--laps", "100000"]) == 2
    assert "at most" in capsys.readouterr().err
    assert list(tmp_path.iterdir()) == []


def test_a_goal_in_a_kept_out_place_is_refused(true_map, tmp_path, capsys):
    keepout = tmp_path / "keepout.yaml"
    keepout.write_text("keepout:\n  - [[-1.2, -1.0], [-0.8, -1.0], [-0.8, 1.0], [-1.2, 1.0]]\n")
    words = ["navigate", "--world", WORLD, "--task", "goal", "--map", str(true_map), "--goal=-1,0.55,0"]
    words += ["--initial-pose", "start", "--out", str(tmp_path / "run"), "--keepout", str(keepout)]
    assert main(words) == 2
    assert "obstacle" in capsys.readouterr().err


def test_an_outline_off_the_map_is_refused_by_its_number(true_map, tmp_path, capsys):
    keepout = tmp_path / "keepout.yaml"
    keepout.write_text("keepout:\n  - [[0, 0], [0.5, 0], [0.5, 0.5]]\n  - [[90, 90], [91, 90], [91, 91]]\n")
    words = ["navigate", "--world", WORLD, "--task", "goal", "--map", str(true_map), "--goal=-1,0.55,0"]
    assert main([*words, "--out", str(tmp_path / "run"), "--keepout", str(keepout)]) == 2
    assert "keepout.yaml: keepout 2: lies outside the map" in capsys.readouterr().err


def mask_of(folder, grid):
    """The yaml of a mask of Nav2's keepout filter."""
    folder.mkdir()
    return save_map(grid, folder, "mask")


def test_a_mask_of_nav2_keeps_out_of_its_occupied_cells(true_map, tmp_path, capsys):
    words = ["navigate", "--world", WORLD, "--task", "goal", "--map", str(true_map), "--goal=-1,0.55,0"]
    words += ["--initial-pose", "start", "--out", str(tmp_path / "run"), "--keepout"]
    black, white = (np.full((20, 8), value, dtype=np.int8) for value in (OCCUPIED, FREE))
    over = mask_of(tmp_path / "over", OccupancyGrid(black, 0.1, SE2.from_xyt(-1.2, -1.0, 0.0)))
    assert main([*words, str(over)]) == 2
    assert "obstacle" in capsys.readouterr().err
    off = mask_of(tmp_path / "off", OccupancyGrid(black, 0.1, SE2.from_xyt(90.0, 90.0, 0.0)))
    assert main([*words, str(off)]) == 2
    assert "mask.yaml: keepout 1: lies outside the map" in capsys.readouterr().err
    empty = mask_of(tmp_path / "empty", OccupancyGrid(white, 0.1))
    assert main([*words, str(empty)]) == 2
    assert "mask.yaml: its image has no occupied cell" in capsys.readouterr().err
    assert not (tmp_path / "run").exists()


def test_the_image_of_a_mask_is_an_input_too(true_map, tmp_path):
    grid = OccupancyGrid(np.full((4, 4), OCCUPIED, dtype=np.int8), 0.05, SE2.from_xyt(0.4, 0.4, 0.0))
    mask = mask_of(tmp_path / "mask", grid)
    words = ["navigate", "--world", WORLD, "--task", "goal", "--map", str(true_map), "--goal=-1,0.55,0"]
    assert main([*words, "--keepout", str(mask), "--out", str(tmp_path / "run")]) == 1  # no initial pose
    inputs = json.loads((tmp_path / "run" / "manifest.json").read_text())["inputs"]
    assert set(inputs) == {"map", "map_image", "keepout", "keepout_image"}


def test_the_manifest_of_a_run_names_every_file_that_went_in_and_a_yaw_in_degrees_is_asked_about(
    true_map, tmp_path, capfd
):
    contents = {
        "keepout.yaml": "keepout: [[[0, 0], [0.5, 0], [0.5, 0.02]]]",
        "points.yaml": "waypoints: [[-1.5, 0.5, 90]]",
        "teleop_override.yaml": "[]",
        "config.yaml": "{}",
        "world.yaml": (FOLDER / "turtlebot3_world.yaml").read_text(),
        "robot.yaml": (ROBOTS / "burger.yaml").read_text(),
    }
    for name, text in contents.items():
        (tmp_path / name).write_text(text)
    words = f"navigate --world {tmp_path}/world.yaml+clutter:3 --robot {tmp_path}/robot.yaml --task patrol"
    words += f" --map {true_map} --waypoints {tmp_path}/points.yaml --keepout {tmp_path}/keepout.yaml"
    words += f" --teleop-override {tmp_path}/teleop_override.yaml"
    words += f" --config {tmp_path}/config.yaml --out {tmp_path}/run"
    assert main(words.split()) == 1  # nobody told it where it is: refused as soon as it looks
    assert capfd.readouterr().err.startswith("note: waypoint 1: yaw 90 rad: is it in degrees?\n")
    inputs = json.loads((tmp_path / "run" / "manifest.json").read_text())["inputs"]
    assert set(inputs) == {
        "map",
        "map_image",
        "world",
        "robot",
        "waypoints",
        "keepout",
        "teleop_override",
        "config",
    }
    for name, text in contents.items():
        kind = "waypoints" if name == "points.yaml" else name.removesuffix(".yaml")
        assert inputs[kind]["sha256"] == {name: sha256_text(text)}


def test_a_comparison_holds_every_planner_and_the_chosen_one_first_hand(true_map, tmp_path):
    words = [
        "--compare",
        "--planner",
        "PRM",
        "--set",
        "plan.ompl.iterations=300",
    ]
    assert main(plan_words(true_map, tmp_path / "out", "-1.5,0.5,0", *words)) == 0
    metrics = json.loads((tmp_path / "out" / "metrics.json").read_text())
    by_name = {entry["planner"]: entry for entry in metrics["planners"]}
    assert set(by_name) == {*get_args(PlannerName), "lattice"}
    assert by_name["PRM"]["length_m"] == metrics["length_m"]
    folder = tmp_path / "out"
    assert (folder / "path-PRM.csv").read_text() == (folder / "path.csv").read_text()
    for name, entry in by_name.items():
        rows = (folder / f"path-{name}.csv").read_text().splitlines()
        assert len(rows) == 1 + (entry["poses"] if entry["success"] else 0)
        assert entry["success"] == (entry.get("min_clearance_m", -1.0) > 0.0)


@pytest.mark.parametrize(
    "setting",
    [
        "plan.margins=[]",
        "plan.margins=[-0.2]",
        "plan.stretch=0.5",
        "plan.stretch=nan",
        "plan.ompl.iterations=0",
        "plan.ompl.planner=Dijkstra",
        "plan.nothing=1",
        "costmap.inflation=1",
    ],
)
def test_plan_refuses_bad_settings(true_map, tmp_path, capsys, setting):
    assert main(plan_words(true_map, tmp_path / "out", "0.5,0.5,0", "--set", setting)) == 2
    assert capsys.readouterr().err.count("\n") == 1
    assert list(tmp_path.iterdir()) == []


@pytest.mark.parametrize(
    ("image", "header"),
    [
        (b"P5 4 4 255 " + b"\x00" * 16, "resolution: 0.05\norigin: [0, 0, 0]"),  # nothing free
        (b"P5 4 4 255 " + b"\xfe" * 16, "resolution: 0.05\norigin: [0, 0, 0]"),  # too small to stand in
        (b"P5 4 4 255 " + b"\xfe" * 16, "resolution: 1.0e+300\norigin: [0, 0, 0]"),
        (b"P5 4 4 255 " + b"\xfe" * 3, "resolution: 0.05\norigin: [0, 0, 0]"),  # cut
        (b"", "resolution: 0.05\norigin: [0, 0, 0]"),
    ],
)
def test_plan_refuses_hostile_maps_in_a_line(tmp_path, capsys, image, header):
    (tmp_path / "map.pgm").write_bytes(image)
    rest = "negate: 0\noccupied_thresh: 0.65\nfree_thresh: 0.196\n"
    (tmp_path / "map.yaml").write_text(f"image: map.pgm\n{header}\n{rest}")
    words = ["plan", "--map", str(tmp_path / "map.yaml"), "--start", "0.1,0.1,0", "--goal", "0.1,0.1,0"]
    assert main([*words, "--out", str(tmp_path / "out")]) == 2
    assert capsys.readouterr().err.count("\n") == 1
    assert not (tmp_path / "out").exists()
