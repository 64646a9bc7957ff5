import json
from itertools import pairwise
from pathlib import Path

import numpy as np
import pytest

from turtlebag.datasets.errors import InputError
from turtlebag.datasets.outputs import Output, sha256_tree
from turtlebag.datasets.runlog import RunLog
from turtlebag.datasets.se2 import SE2
from turtlebag.datasets.trajectories import load_tum
from turtlebag.pipeline.navigation.config import NavigateConfig
from turtlebag.pipeline.navigation.driver_setup import prepare
from turtlebag.pipeline.navigation.mission import Request
from turtlebag.pipeline.stages.navigate import navigate
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


def test_a_told_pose_must_be_on_the_map_but_may_be_in_a_wall(true_map):
    def told(x: float) -> Request:
        at = SE2.from_xyt(x, 1.1, 0.0)
        return Request(task="patrol", seed=1, map_path=true_map, initial_pose=at)

    with pytest.raises(InputError, match=r"--initial-pose 90,1\.1,0: is off the map"):
        prepare(told(90.0), load_robot("burger"), NavigateConfig())
    assert prepare(told(1.1), load_robot("burger"), NavigateConfig()).request.initial_pose is not None


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
