import json
from itertools import pairwise
from pathlib import Path

import numpy as np
import pytest

from turtlebag.datasets.errors import InputError
from turtlebag.datasets.grid import FREE, OCCUPIED, UNKNOWN, OccupancyGrid
from turtlebag.datasets.maps import save_map
from turtlebag.datasets.outputs import Output, sha256_tree
from turtlebag.datasets.runlog import RunLog
from turtlebag.datasets.se2 import SE2
from turtlebag.datasets.trajectories import load_tum
from turtlebag.pipeline.cli.main import main
from turtlebag.pipeline.navigation.config import NavigateConfig
from turtlebag.pipeline.navigation.driver_setup import MAX_SIMULATED_S, Request, prepare
from turtlebag.pipeline.stages.navigate import navigate
from turtlebag.planners.tasks.patrol import GoalSequence
from turtlebag.sim.robots import load_robot
from turtlebag.sim.worlds import load_world

WORLD = "turtlebot3_world"
ARENA, BURGER = load_world(WORLD), load_robot("burger")
MIDDLE = SE2.from_xyt(-2.5, -2.5, 0.0)


def run(out: Path, **wishes) -> dict:
    request = Request(**{"seed": 1, "task": "goal", "initial_pose": "start", **wishes})
    code = navigate(ARENA, BURGER, request, Output(out), say=lambda line: None)
    metrics = json.loads((out / "metrics.json").read_text())
    assert code == (0 if metrics["true_success"] else 1)
    return metrics


@pytest.fixture(scope="module")
def goal_run(true_map, tmp_path_factory):
    out = tmp_path_factory.mktemp("goal") / "run"
    metrics = run(out, map_path=true_map, goal=SE2.from_xyt(-0.6, -1.6, 1.2))
    return out, metrics


@pytest.mark.slow
def test_a_goal_is_reached_in_position_and_heading(goal_run):
    _, metrics = goal_run
    (goal,) = metrics["goals"]
    assert goal["status"] == "reached"
    assert goal["error_m"] < 0.05
    assert goal["error_rad"] < 0.08
    assert metrics["collisions"] == {"visible": 0, "low": 0}
    assert metrics["min_clearance_m"] > 0.05
    assert metrics["localisation_error_m"]["rmse"] < 0.03


@pytest.mark.slow
def test_a_run_leaves_the_contracts_files(goal_run):
    out, metrics = goal_run
    files = set(sha256_tree(out))
    assert {"trajectory.tum", "metrics.json", "config.yaml", "runlog.csv", "truth/map.yaml"} <= files
    log = RunLog.load(out / "runlog.csv")
    assert np.all(np.diff(log.t_ns) > 0)
    assert metrics["time_s"] == pytest.approx((log.t_ns[-1] - log.t_ns[0]) * 1e-9, abs=1e-6)
    estimate, truth = load_tum(out / "trajectory.tum"), load_tum(out / "truth" / "trajectory.tum")
    assert estimate.stamps_ns.tolist() == truth.stamps_ns.tolist()
    assert (out / "manifest.json").is_file()


@pytest.mark.slow
def test_commands_obey_the_limits(goal_run):
    log = RunLog.load(goal_run[0] / "runlog.csv")
    model = load_robot("burger").model
    assert np.abs(log.v).max() <= model.max_v + 1e-6
    assert np.abs(np.diff(log.v)).max() <= model.max_dv / 30.0 + 1e-5
    assert log.v[-1] == 0.0


@pytest.mark.slow
def test_the_same_seed_gives_the_same_bytes(goal_run, true_map, tmp_path):
    out, _ = goal_run
    run(tmp_path / "again", map_path=true_map, goal=SE2.from_xyt(-0.6, -1.6, 1.2))
    assert sha256_tree(tmp_path / "again") == sha256_tree(out)


def test_without_an_initial_pose_the_goal_is_rejected(true_map, tmp_path):
    metrics = run(tmp_path / "run", map_path=true_map, goal=SE2.from_xyt(-1.5, -0.5, 0.0), initial_pose=None)
    assert metrics["goals"][0]["status"] == "rejected"
    assert metrics["goals"][0]["reason"] == "no initial pose"
    assert metrics["distance_m"] < 0.01


@pytest.mark.parametrize(
    ("goal", "said"),
    [
        ("1.1,1.1,0", "obstacle"),
        ("100,0,0", "off the map"),
        ("1,nan,0", "y is not a finite"),
        ("1,2", "X,Y,YAW"),
    ],
)
def test_bad_goals_are_one_line_and_write_nothing(true_map, tmp_path, capsys, goal, said):
    out = tmp_path / "run"
    words = ["navigate", "--world", WORLD, "--task", "goal", "--map", str(true_map), "--out", str(out)]
    assert main([*words, "--initial-pose", "start", f"--goal={goal}"]) == 2
    error = capsys.readouterr().err
    assert said in error
    assert error.count("\n") == 1
    assert list(tmp_path.iterdir()) == []


@pytest.mark.slow
@pytest.mark.parametrize("cell", [FREE, UNKNOWN])
@pytest.mark.parametrize("initial", ["start", "global", None])
@pytest.mark.parametrize("task", ["goal", "patrol"])
def test_a_map_without_walls_is_refused_before_anything_is_written(tmp_path, capsys, cell, initial, task):
    save_map(OccupancyGrid(np.full((100, 100), cell, dtype=np.int8), 0.05, MIDDLE), tmp_path, "bare")
    words = ["navigate", "--world", WORLD, "--task", task, "--map", f"{tmp_path}/bare.yaml"]
    words += ["--out", f"{tmp_path}/run", *(["--goal=-2,0,0"] if task == "goal" else [])]
    assert main([*words, *(["--initial-pose", initial] if initial else [])]) == 2
    error = capsys.readouterr().err
    assert "bare.yaml: has no occupied cell" in error
    assert error.count("\n") == 1
    assert sorted(path.name for path in tmp_path.iterdir()) == ["bare.pgm", "bare.yaml"]


def test_a_map_without_floor_cannot_be_searched(tmp_path, capsys):
    cells = np.full((100, 100), OCCUPIED, dtype=np.int8)
    save_map(OccupancyGrid(cells, 0.05, MIDDLE), tmp_path, "full")
    words = ["navigate", "--world", WORLD, "--task", "patrol", "--map", f"{tmp_path}/full.yaml"]
    assert main([*words, "--out", f"{tmp_path}/run", "--initial-pose", "global"]) == 2
    assert "full.yaml: has no free cell" in capsys.readouterr().err


def test_a_told_pose_must_be_on_the_map_but_may_be_in_a_wall(true_map):
    def told(x: float) -> Request:
        at = SE2.from_xyt(x, 1.1, 0.0)
        return Request(task="patrol", seed=1, map_path=true_map, initial_pose=at)

    with pytest.raises(InputError, match=r"--initial-pose 90,1\.1,0: is off the map"):
        prepare(told(90.0), load_robot("burger"), NavigateConfig())
    assert prepare(told(1.1), load_robot("burger"), NavigateConfig()).request.initial_pose is not None


def test_unknown_world_and_missing_map_are_input_errors(tmp_path):
    with pytest.raises(InputError, match="turtlebot3_world"):
        load_world("moon")
    with pytest.raises(InputError, match="needs --map"):
        navigate(ARENA, BURGER, Request(task="patrol", seed=1), Output(tmp_path / "run"))
    with pytest.raises(InputError, match="no such map"):
        navigate(
            ARENA,
            BURGER,
            Request(task="patrol", seed=1, map_path=tmp_path / "m.yaml"),
            Output(tmp_path / "run"),
        )
    assert list(tmp_path.iterdir()) == []


@pytest.mark.slow
def test_avoid_prints_its_decisions_and_touches_nothing_in_ten_seconds(tmp_path):
    lines: list[str] = []
    request = Request(task="avoid", seed=2, duration_s=10.0)
    assert navigate(ARENA, BURGER, request, Output(tmp_path / "run"), say=lines.append) == 0
    decisions = [line.rpartition("  ")[2] for line in lines]
    assert len(decisions) > 2
    assert all(one != other for one, other in pairwise(decisions))
    metrics = json.loads((tmp_path / "run" / "metrics.json").read_text())
    assert metrics["localisation_error_m"] is None
    assert metrics["goals"] == []
    assert metrics["time_s"] == pytest.approx(10.0)
    assert len(load_tum(tmp_path / "run" / "trajectory.tum")) == 50


@pytest.mark.parametrize("timeout_s", [1e300, float("inf")])
def test_a_timeout_beyond_any_run_is_none(timeout_s):
    request = Request(task="goal", seed=1, goal=SE2.from_xyt(1.0, 0.0, 0.0), timeout_s=timeout_s)
    mission = prepare(request, BURGER, NavigateConfig())
    goals = GoalSequence(mission.waypoints, mission.config.sequence)
    assert all(goals.update(now) is not None for now in (0, round(MAX_SIMULATED_S * 1e9)))
