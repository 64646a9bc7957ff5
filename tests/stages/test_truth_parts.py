"""Parts that know the truth: only where a person names them, and with the stated effect."""

import json

import numpy as np
import pytest

from tests.helpers.slam_rooms import ROOM, around_the_room, drifted, recording
from tests.test_layers import SOURCES, imported
from turtlebag.datasets.ground_truth import known_truth
from turtlebag.datasets.maps import save_map
from turtlebag.datasets.runlog import Row, RunLog
from turtlebag.datasets.se2 import SE2
from turtlebag.datasets.types import Trajectory, Twist
from turtlebag.pipeline.cli.main import main
from turtlebag.pipeline.navigation.config import NavigateConfig
from turtlebag.pipeline.navigation.driver_setup import prepare
from turtlebag.pipeline.navigation.episode import drive
from turtlebag.pipeline.navigation.metrics import goal_of
from turtlebag.pipeline.navigation.mission import Request
from turtlebag.pipeline.slam.mapper import SlamConfig, run_slam
from turtlebag.planners.tasks.patrol import GoalOutcome
from turtlebag.planners.tasks.waypoints import Waypoint
from turtlebag.reports.metrics.navigation import run_metrics
from turtlebag.reports.metrics.trajectory import ate
from turtlebag.sim.robots import load_robot
from turtlebag.sim.simulator import SimConfig, Simulator
from turtlebag.sim.worlds import load_world

OFF = {"loops": {"enabled": False}, "refine": {"rounds": 0}}
TRUE = "turtlebag.testing:True"


@pytest.mark.slow
def test_only_the_truth_parts_may_ask_for_the_truth():
    users = {
        path.as_posix().partition("/pipeline/")[2]
        for path in SOURCES
        if "datasets/ground_truth" in imported(path)
    }
    tell = {"stages/map.py", "navigation/episode.py", ""}  # the last is a record's truth, in reports
    assert users == tell | {"conformance/truth_parts.py"}


@pytest.fixture(scope="module")
def room():
    """A log of two laps with noisy scans, and the true poses."""
    poses = around_the_room(70, laps=1.4)
    return recording(ROOM, poses, odometry=drifted(poses), noise=0.03), SE2.from_array(poses)


def left_over(room, **settings):
    log, truth = room
    with known_truth(lambda scan: truth[scan]):
        result = run_slam(log, SlamConfig.model_validate(settings))
    found = ate(result.trajectory, Trajectory(log.stamps_ns, truth), align=False)["rmse"]
    return found, result


@pytest.mark.slow
def test_the_true_front_end_is_exact_until_others_move_it(room):
    assert left_over(room, **OFF)[0] > 0.004
    assert left_over(room, **OFF, front_end=f"{TRUE}FrontEnd")[0] < 1e-9


@pytest.mark.slow
def test_true_loops_are_closed_where_they_truly_are(room):
    truth, off = room[1], {**OFF, "loops": {}}
    error, usual = left_over(room, **off)
    less, result = left_over(room, **{**off, "loops": {"match": f"{TRUE}Loops"}})
    closed = [edge for edge in result.constraints if edge.kind == "loop"]
    assert len(closed) >= len([edge for edge in usual.constraints if edge.kind == "loop"]) > 0
    for edge in closed:
        i, j = result.keys[edge.i], result.keys[edge.j]
        np.testing.assert_allclose(edge.T_i_j, (truth[i].inverse() @ truth[j]).xyt, atol=1e-12)
    assert less < error


@pytest.mark.slow
def test_a_map_with_a_true_part_names_it_and_needs_the_truth(tmp_path, capsys):
    record, out = tmp_path / "record", tmp_path / "map"
    teleop = tmp_path / "ahead.yaml"
    teleop.write_text("name: ahead\nv: 0.2\nw: 0.8\nsteps: [{through: [[-1.5, -0.5]]}]\n")
    world = ["--world", "turtlebot3_world", "--teleop", str(teleop)]
    assert main(["record", *world, "--out", str(record), "-q"]) == 0
    words = ["map", str(record), "--set", f"front_end={TRUE}FrontEnd", "--out", str(out), "-q"]
    words += ["--set", "refine.rounds=0"]
    capsys.readouterr()
    assert main(words) == 2
    assert "TrueFrontEnd: the truth is not known here; use it in map with" in capsys.readouterr().err
    assert main([*words, "--truth", str(record)]) == 0
    assert json.loads((out / "manifest.json").read_text())["parts"]["front_end"] == f"{TRUE}FrontEnd"
    assert json.loads((out / "metrics.json").read_text())["ate_m"]["max"] < 1e-4
    truth = record / "truth/trajectory.tum"
    truth.write_text("".join(truth.read_text().splitlines(keepends=True)[:5]))
    assert main([*words, "--truth", str(record), "--force"]) == 2
    assert "does not have one pose for each scan" in capsys.readouterr().err


@pytest.mark.slow
def test_the_true_localiser_knows_where_the_robot_is(tmp_path):
    """A way to one goal in the arena on the true map, with wheels that lie."""
    world, robot = load_world("turtlebot3_world"), load_robot("burger")
    true_map = save_map(world.rasterize(robot.lidar_height), tmp_path, "true")
    sim = SimConfig(odometry={"radius_error": 0.1, "track_error": 0.2})
    way = tmp_path / "way.yaml"
    way.write_text("waypoints:\n  - {x: -1.6, y: -0.55, yaw: 0.5}\n")
    request = Request("patrol", 2, map_path=true_map, initial_pose="start", waypoints_path=way)
    errors = []
    for localiser in ("amcl", f"{TRUE}Localiser"):
        mission = prepare(request, robot, NavigateConfig(sim=sim, localiser=localiser), world.keepout)
        with Simulator(world, mission.robot, mission.config.sim, 2) as simulator:
            run = drive(simulator, mission)
        errors.append(run.metrics["localisation_error_m"]["rmse"])
        lie = np.abs(run.log.T_odom_base.xyt - run.log.T_world_base.xyt).max()
        assert lie > 0.005
    assert errors[0] > 0.001
    assert errors[1] < 1e-9
    assert run.metrics["success"]


@pytest.mark.parametrize(("x", "there"), [(1.1, True), (1.4, False)])
def test_a_robot_that_is_not_where_it_takes_itself_to_be_has_no_true_success(x, there):
    rows = [
        Row(
            k * 10**9,
            T_world_base=SE2.from_xyt(1.0, 0.0, 0.0),
            T_map_base=SE2.from_xyt(x, 0.0, 0.0),
            T_odom_base=SE2.identity(),
            command=Twist(),
            clearance_m=0.5,
            contact_visible=False,
            contact_low=False,
            goal_index=0,
            state="follow",
        )
        for k in range(3)
    ]
    log = RunLog.of(rows)
    goal = GoalOutcome(0, Waypoint(SE2.from_xyt(x, 0.0, 0.0), "", (x, 0.0, 0.0)), "reached", "", 0, 2 * 10**9)
    truth = Trajectory(log.t_ns, log.T_world_base)
    found = run_metrics("patrol", log, [goal_of(goal)], truth, truth)
    assert found["success"]
    assert found["true_success"] is there
    assert found["goal_error_m"]["max"] == pytest.approx(x - 1.0)
