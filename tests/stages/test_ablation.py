"""Parts replaced by ground truth: only where allowed, and with the stated effect."""

import ast
from pathlib import Path

import numpy as np
import pytest

from tests.helpers.report_fakes import fake_record
from tests.helpers.slam_rooms import ROOM, around_the_room, drifted, recording
from turtlebag.datasets.bags.reader import read_poses
from turtlebag.datasets.errors import InputError
from turtlebag.datasets.maps import save_map
from turtlebag.datasets.runlog import Row, RunLog
from turtlebag.datasets.se2 import SE2
from turtlebag.datasets.types import Trajectory, Twist
from turtlebag.pipeline.campaign.truth_for_parts import true_drive, true_steps, with_sensors, with_truth
from turtlebag.pipeline.cli.main import main
from turtlebag.pipeline.navigation.config import NavigateConfig
from turtlebag.pipeline.navigation.driver_setup import Request, prepare
from turtlebag.pipeline.navigation.metrics import goal_of
from turtlebag.pipeline.slam.slam import SlamConfig, run_slam
from turtlebag.planners.tasks.patrol import GoalOutcome
from turtlebag.planners.tasks.waypoints import Waypoint
from turtlebag.reports.metrics.navigation import run_metrics
from turtlebag.reports.metrics.trajectory import ate
from turtlebag.reports.stages import load_stage
from turtlebag.sim.robots import load_robot
from turtlebag.sim.simulator import SimConfig
from turtlebag.sim.worlds import load_world

ROOT = Path(__file__).parents[2]


@pytest.mark.slow
def test_only_the_study_may_import_the_truth():
    users = set()
    for folder in ("datasets", "sim", "planners", "reports", "pipeline"):
        for path in (ROOT / folder).rglob("*.py"):
            text = path.read_text()
            for node in ast.walk(ast.parse(text)) if "truth_for_parts" in text else ():
                names = [alias.name for alias in node.names] if isinstance(node, ast.Import) else []
                if isinstance(node, ast.ImportFrom):
                    names = [node.module or "", *(f"{node.module}.{alias.name}" for alias in node.names)]
                if "turtlebag.pipeline.campaign.truth_for_parts" in names:
                    users.add(path.relative_to(ROOT).as_posix())
    assert users == {"pipeline/campaign/ablation.py"}


@pytest.fixture(scope="module")
def record(tmp_path_factory):
    return fake_record(tmp_path_factory.mktemp("ablation") / "record")


def test_each_part_is_replaced_alone(record):
    stage = load_stage(record)
    truth = read_poses(record / "bag", "/ground_truth/odom")
    plain, odometry, deskew = (with_truth(stage, parts) for parts in ([], ["odometry"], ["deskew"]))
    error = np.abs(plain.T_odom_base.xy - stage.truth.poses.xy).max()
    assert error > 0.05
    np.testing.assert_allclose(odometry.T_odom_base.xyt, stage.truth.poses.xyt)
    np.testing.assert_array_equal(deskew.T_odom_base.xyt, plain.T_odom_base.xyt)
    np.testing.assert_array_equal(deskew.odometry.poses.xyt, truth.poses.xyt)
    np.testing.assert_array_equal(odometry.odometry.poses.xyt, plain.odometry.poses.xyt)


def test_true_poses_are_taken_as_they_are():
    assert with_sensors(SlamConfig(), ["poses"]).sensors == "odometry"
    assert with_sensors(SlamConfig(), ["deskew"]).sensors == "both"


def test_what_cannot_be_replaced_is_refused(record, tmp_path, capsys):
    out = ["--out", str(tmp_path / "out")]
    assert main(["ablate", str(record), "--replace", "luck", *out]) == 2
    assert "known: none, odometry, deskew, front_end" in capsys.readouterr().err
    assert main(["ablate", str(tmp_path), *out]) == 2
    stage = load_stage(record)
    (record / "truth/trajectory.tum").write_text("0 0 0 0 0 0 0 1\n")
    with pytest.raises(InputError, match="one pose for each scan"):
        with_truth(load_stage(stage.folder), ["odometry"])


@pytest.fixture(scope="module")
def room():
    """A log of two laps with noisy scans, and the true poses."""
    poses = around_the_room(70, laps=1.4)
    return recording(ROOM, poses, odometry=drifted(poses), noise=0.03), SE2.from_array(poses)


def left_over(room, parts, **settings):
    log, truth = room
    result = run_slam(log, SlamConfig.model_validate(settings), steps=true_steps(truth, parts))
    found = ate(result.trajectory, Trajectory(log.stamps_ns, truth), align=False)["rmse"]
    return found, result


@pytest.mark.slow
def test_the_true_front_end_is_exact_until_others_move_it(room):
    off = {"loops": {"enabled": False}, "refine": {"rounds": 0}, "reregistration": {"enabled": False}}
    assert left_over(room, [], **off)[0] > 0.004
    assert left_over(room, ["front_end"], **off)[0] < 1e-9


@pytest.mark.slow
def test_true_loops_are_all_closed_where_they_truly_are(room):
    truth = room[1]
    off = {"refine": {"rounds": 0}, "reregistration": {"enabled": False}}
    error, usual = left_over(room, [], **off)
    less, result = left_over(room, ["loops"], **off)
    closed = [edge for edge in result.constraints if edge.kind == "loop"]
    assert len(closed) == len(result.loops) == len(usual.loops) > 0
    for edge in closed:
        i, j = result.keys[edge.i], result.keys[edge.j]
        np.testing.assert_allclose(edge.T_i_j, (truth[i].inverse() @ truth[j]).xyt)
    assert less < error


@pytest.fixture(scope="module")
def short_drive(tmp_path_factory):
    """A way to one goal in the arena on the true map, with wheels that lie."""
    folder = tmp_path_factory.mktemp("drive")
    world, robot = load_world("turtlebot3_world"), load_robot("burger")
    grid = world.rasterize(robot.lidar_height)
    true_map = save_map(grid, folder, "true")
    sim = SimConfig(odometry={"radius_error": 0.1, "track_error": 0.2})
    way = folder / "way.yaml"
    way.write_text("waypoints:\n  - {x: -1.6, y: -0.55, yaw: 0.5}\n")
    request = Request("patrol", 2, map_path=true_map, initial_pose="start", waypoints_path=way)
    return world, prepare(request, robot, NavigateConfig(sim=sim), world.keepout), true_map


@pytest.mark.slow
def test_parts_of_the_drive_are_replaced_alone(short_drive):
    world, mission, true_map = short_drive
    usual, located, wheels = (
        true_drive(world, mission, true_map, p) for p in ([], ["localisation"], ["odometry"])
    )
    assert usual.metrics["localisation_error_m"]["rmse"] > 0.001
    assert located.metrics["localisation_error_m"]["rmse"] < 1e-12
    assert located.metrics["success"]
    lie = np.abs(located.log.T_odom_base.xyt - located.log.T_world_base.xyt).max()
    assert lie > 0.005
    np.testing.assert_array_equal(wheels.log.T_odom_base.xyt, wheels.log.T_world_base.xyt)
    assert wheels.metrics["localisation_error_m"]["rmse"] > 0.0


@pytest.mark.slow
def test_the_true_plan_goes_by_the_true_map(short_drive, tmp_path):
    world, mission, _ = short_drive
    grid = world.rasterize(0.182)
    grid.cells[:, 30:] = 100
    walled = save_map(grid, tmp_path, "walled")
    usual = true_drive(world, mission, walled, ["localisation"])
    informed = true_drive(world, mission, walled, ["localisation", "plan"])
    assert usual.metrics["goals"][0]["status"] == "reached"
    assert informed.metrics["goals"][0]["status"] in ("unreachable", "rejected")


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
