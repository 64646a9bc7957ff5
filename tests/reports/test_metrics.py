"""Metrics against plain references and known answers."""

import math
from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from tests.helpers.report_fakes import ellipse, mapped_room, true_room
from turtlebag.datasets.grid import FREE, OCCUPIED, UNKNOWN, OccupancyGrid
from turtlebag.datasets.se2 import SE2
from turtlebag.datasets.types import Trajectory
from turtlebag.reports.metrics.map import map_error, map_metrics, visible_surface
from turtlebag.reports.metrics.navigation import collision_episodes, min_clearance, pose_error
from turtlebag.reports.metrics.references import References
from turtlebag.reports.metrics.trajectory import associate, ate, fit_rigid, rpe, trajectory_metrics
from turtlebag.sim.worlds import load_world


def circle(n: int = 200, period_ns: int = 200_000_000) -> Trajectory:
    angle = np.linspace(0.0, 3.0 * np.pi, n)
    poses = SE2.from_xyt(2.0 * np.cos(angle), 2.0 * np.sin(angle), angle + np.pi / 2)
    return Trajectory(np.arange(n, dtype=np.int64) * period_ns, poses)


def moved(trajectory: Trajectory, T: SE2) -> Trajectory:
    return Trajectory(trajectory.stamps_ns, T @ trajectory.poses)


def test_a_perfect_estimate_has_no_error():
    found = trajectory_metrics(circle(), circle())
    assert found["ate_m"]["max"] < 1e-12
    assert found["ate_aligned_m"]["max"] < 1e-12
    assert found["rpe"]["trans_m"] < 1e-12


def test_a_shifted_estimate_has_the_shift_as_error_and_none_after_alignment():
    shifted = moved(circle(), SE2.from_xyt(0.3, 0.4, 0.0))
    assert ate(shifted, circle(), align=False) == pytest.approx({"rmse": 0.5, "max": 0.5})
    assert ate(shifted, circle(), align=True)["max"] < 1e-12
    found = trajectory_metrics(shifted, circle())
    assert found["ate_m"]["rmse"] == pytest.approx(0.5)
    assert found["ate_aligned_m"]["rmse"] < 1e-12


@given(st.floats(-5, 5), st.floats(-5, 5), st.floats(-3.14, 3.14))
@settings(max_examples=30, deadline=None)
def test_alignment_undoes_any_rigid_motion(x, y, yaw):
    assert ate(moved(circle(), SE2.from_xyt(x, y, yaw)), circle(), align=True)["max"] < 1e-9


def test_fit_rigid_agrees_with_the_svd_of_umeyama():
    rng = np.random.default_rng(3)
    a = rng.normal(size=(40, 2))
    b = SE2.from_xyt(1.0, -2.0, 2.5) @ a + rng.normal(scale=0.1, size=a.shape)
    a0, b0 = a - a.mean(axis=0), b - b.mean(axis=0)
    u, _, vt = np.linalg.svd(b0.T @ a0)
    rotation = u @ np.diag([1.0, np.linalg.det(u @ vt)]) @ vt
    fit = fit_rigid(a, b).matrix()
    np.testing.assert_allclose(fit[:2, :2], rotation, atol=1e-12)
    np.testing.assert_allclose(fit[:2, 2], b.mean(axis=0) - rotation @ a.mean(axis=0), atol=1e-12)


def test_ate_is_the_plain_formula_on_noisy_poses():
    rng = np.random.default_rng(1)
    truth = circle(50)
    noise = rng.normal(scale=0.05, size=(50, 2))
    noisy = SE2.from_xyt(truth.poses.x + noise[:, 0], truth.poses.y + noise[:, 1], truth.poses.yaw)
    squares = [dx * dx + dy * dy for dx, dy in noise]
    found = ate(Trajectory(truth.stamps_ns, noisy), truth, align=False)
    assert found["rmse"] == pytest.approx(math.sqrt(sum(squares) / 50))
    assert found["max"] == pytest.approx(math.sqrt(max(squares)))


def test_the_truth_is_interpolated_at_the_estimates_stamps():
    truth = Trajectory(np.array([0, 1_000_000_000]), SE2.from_array([[0.0, 0.0, 0.0], [1.0, 0.0, np.pi / 2]]))
    estimate = Trajectory(np.array([250_000_000]), SE2.from_array([[0.25, 0.0, np.pi / 8]]))
    pairs = associate(estimate, truth)
    assert pairs.position_errors() == pytest.approx([0.0])
    assert pairs.yaw_errors() == pytest.approx([0.0])


def test_stamps_without_truth_are_left_out_and_no_overlap_is_an_error():
    truth = circle(20)
    late = Trajectory(truth.stamps_ns + 2_000_000_000, truth.poses)
    assert len(associate(late, truth)) == 10
    with pytest.raises(ValueError, match="share no time"):
        associate(Trajectory(truth.stamps_ns + 10**12, truth.poses), truth)


def test_file_order_with_backward_stamps_does_not_change_the_errors():
    truth = circle(60)
    estimate = moved(truth, SE2.from_xyt(0.1, 0.0, 0.02))
    order = np.random.default_rng(0).permutation(60)
    shuffled = Trajectory(estimate.stamps_ns[order], estimate.poses[order])
    assert ate(shuffled, truth, align=False) == pytest.approx(ate(estimate, truth, align=False))
    assert rpe(shuffled, truth) == pytest.approx(rpe(estimate, truth))


def test_rpe_of_a_scaled_straight_run_is_the_scale_error():
    x = np.linspace(0.0, 10.0, 101)
    stamps = np.arange(101, dtype=np.int64) * 10**8
    truth = Trajectory(stamps, SE2.from_xyt(x, 0.0 * x, 0.0 * x))
    estimate = Trajectory(stamps, SE2.from_xyt(1.02 * x, 0.0 * x, 0.0 * x))
    assert rpe(estimate, truth) == pytest.approx({"trans_m": 0.02, "rot_rad": 0.0}, abs=1e-12)


def test_rpe_ignores_a_rigid_offset_and_sees_a_yaw_drift():
    x = np.linspace(0.0, 10.0, 101)
    stamps = np.arange(101, dtype=np.int64) * 10**8
    truth = Trajectory(stamps, SE2.from_xyt(x, 0.0 * x, 0.0 * x))
    turned = Trajectory(stamps, SE2.from_xyt(x, 0.0 * x, 0.03 * x))
    found = rpe(moved(turned, SE2.from_xyt(5.0, 5.0, 1.0)), truth)
    assert found["rot_rad"] == pytest.approx(0.03)


def test_a_run_shorter_than_a_metre_has_no_rpe():
    still = Trajectory(np.arange(5, dtype=np.int64), SE2.identity(5))
    assert rpe(still, still) == {"trans_m": None, "rot_rad": None}


def room(shift_cells: int = 0, origin: tuple[float, float] = (0.0, 0.0)) -> OccupancyGrid:
    """A 40 x 60 cell room: free inside, walls three cells thick, free outside."""
    cells = np.full((60, 80), FREE, dtype=np.int8)
    cells[10:50, 10:70] = OCCUPIED
    cells[13:47, 13:67] = FREE
    return OccupancyGrid(np.roll(cells, shift_cells, axis=1), 0.05, SE2.from_xyt(*origin, 0.0))


def skin(shift_cells: int = 0) -> OccupancyGrid:
    """What a perfect lidar in the room maps: its inner skin; nothing known beyond."""
    cells = np.full((60, 80), UNKNOWN, dtype=np.int8)
    cells[12:48, 12:68] = OCCUPIED
    cells[13:47, 13:67] = FREE
    return OccupancyGrid(np.roll(cells, shift_cells, axis=1), 0.05)


def test_only_the_inner_skin_of_solid_walls_counts_as_visible():
    surface = visible_surface(room(), skin())
    np.testing.assert_array_equal(surface, skin().cells == OCCUPIED)


def test_the_perfect_map_of_a_room_scores_one():
    found = map_metrics(skin(), room())
    assert found["iou"] == found["iou_one_cell"] == found["coverage"] == 1.0
    assert found["occupied_error_m"] == pytest.approx({"mean": 0.0, "p95": 0.0, "within_one_cell": 1.0})


def test_a_map_one_cell_off_loses_plain_iou_but_not_the_tolerant_one():
    found = map_metrics(skin(1), room())
    mapped = skin(1).cells == OCCUPIED
    true = skin().cells == OCCUPIED
    assert found["iou"] == pytest.approx((mapped & true).sum() / (mapped | true).sum())
    assert found["iou_one_cell"] == 1.0
    assert found["occupied_error_m"]["p95"] == pytest.approx(0.05)


@pytest.mark.slow
@pytest.mark.parametrize("world", ["turtlebot3_world", "turtlebot3_house"])
def test_the_true_map_itself_half_a_cell_beside_loses_most_of_plain_iou(world):
    """What the report says of plain IoU, where it asks not to trust it."""
    true = load_world(world).rasterize(0.18)
    beside = OccupancyGrid(true.cells, true.resolution, SE2.from_xyt(0.025, 0.025, 0.0) @ true.T_map_grid)
    found = map_metrics(beside, true)
    assert found["iou"] < 0.2
    assert found["iou_one_cell"] == 1.0
    assert found["occupied_error_m"]["within_one_cell"] == 1.0


def test_grids_with_other_origins_are_compared_in_metres():
    cells = skin().cells[5:55, 5:75]
    cropped = OccupancyGrid(cells, 0.05, SE2.from_xyt(0.25, 0.25, 0.0))
    assert map_metrics(cropped, room())["iou"] == 1.0


def test_map_error_agrees_with_a_brute_force_search():
    error = map_error(skin(2), room())
    brute = np.linalg.norm(error.xy_mapped[:, None] - error.xy_true[None], axis=2)
    np.testing.assert_allclose(error.error_m, brute.min(axis=1))
    np.testing.assert_allclose(error.missed_m, brute.min(axis=0))


def test_a_half_built_map_has_half_the_coverage_and_exact_cells():
    cells = skin().cells.copy()
    cells[30:] = UNKNOWN
    found = map_metrics(OccupancyGrid(cells, 0.05), room())
    assert found["occupied_error_m"]["mean"] == 0.0
    assert found["coverage"] == pytest.approx(0.5, abs=0.03)


def test_an_empty_map_scores_zero_without_an_error():
    found = map_metrics(OccupancyGrid(np.full((60, 80), UNKNOWN, dtype=np.int8), 0.05), room())
    assert found["iou"] == 0.0
    assert found["occupied_error_m"] == {"mean": None, "p95": None, "within_one_cell": None}


def test_contacts_close_in_time_are_one_episode():
    stamps = np.arange(10, dtype=np.int64) * 200_000_000
    contact = np.array([0, 1, 1, 0, 1, 0, 0, 0, 0, 1], dtype=bool)
    assert collision_episodes(stamps, contact) == [(200_000_000, 800_000_000), (1_800_000_000, 1_800_000_000)]
    assert collision_episodes(stamps, np.zeros(10, dtype=bool)) == []


def test_pose_error_wraps_the_yaw():
    distance, yaw = pose_error(SE2.from_xyt(1.0, 1.0, 3.1), SE2.from_xyt(1.0, 0.0, -3.1))
    assert distance == pytest.approx(1.0)
    assert yaw == pytest.approx(2 * np.pi - 6.2)


def test_clearance_without_surfaces_is_none():
    assert min_clearance(np.array([np.inf, np.inf])) is None
    assert min_clearance(np.array([np.inf, 0.2, 0.1])) == 0.1


def test_a_map_in_a_frame_of_its_own_is_measured_after_the_fit_and_the_reason_is_said():
    """As one without odometry is: it begins at its own origin, wherever the truth begins."""
    truth, T = Trajectory(np.arange(150, dtype=np.int64), ellipse()[::6]), SE2.from_xyt(3.0, -2.0, 0.7)
    known, grid = References(truth, true_room()), mapped_room()
    there = known.errors(truth, grid)
    own = known.errors(moved(truth, T), replace(grid, T_map_grid=T @ grid.T_map_grid), odometry=False)
    assert "fitted" not in there
    assert own["fitted"].startswith("the recording has no odometry")
    assert own["ate_m"]["max"] > 1.0
    assert own["ate_aligned_m"]["max"] < 1e-9
    assert own["map"]["occupied_error_m"]["within_one_cell"] == pytest.approx(
        there["map"]["occupied_error_m"]["within_one_cell"], abs=0.01
    )
    assert known.errors(moved(truth, T), grid)["fitted"].startswith("the map does not begin where")
