"""The filter's parts against plain references."""

import math

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from tests.helpers.localisation_room import LIDAR, T_BASE_LIDAR, l_shaped_room, sampled
from turtlebag.datasets.deskew import deskewed
from turtlebag.datasets.grid import OCCUPIED, OccupancyGrid
from turtlebag.datasets.se2 import SE2
from turtlebag.datasets.types import Scan
from turtlebag.pipeline.localisation import motion_model, resampling
from turtlebag.pipeline.localisation.deskewed_beams import evenly_spaced, prepare
from turtlebag.pipeline.localisation.estimate import main_cluster
from turtlebag.pipeline.localisation.global_search import path_probabilities, tempered
from turtlebag.pipeline.localisation.likelihood_field import distance_field, hit_probability, sum_over_beams
from turtlebag.pipeline.localisation.nav2_yaml import is_nav2, read_nav2
from turtlebag.pipeline.localisation.parameters import AmclConfig


def grid_with(occupied, shape=(20, 30), resolution=0.1, T_map_grid=None):
    cells = np.zeros(shape, dtype=np.int8)
    for row, col in occupied:
        cells[row, col] = OCCUPIED
    return OccupancyGrid(cells, resolution, T_map_grid or SE2.from_xyt(-1.0, 2.0, 0.0))


# the likelihood field


def test_distance_is_zero_at_the_cells_centre_and_euclidean_around_it():
    grid = grid_with([(4, 7)])
    field = distance_field(grid, 2.0)
    centre = grid.center_of(np.array([4, 7]))
    assert sampled(field, centre) == pytest.approx(0.0, abs=1e-7)
    for offset in ([0.3, 0.0], [0.0, -0.4], [0.3, 0.4], [-0.5, 1.2]):
        assert sampled(field, centre + offset) == pytest.approx(math.hypot(*offset), abs=1e-6)
    assert sampled(field, centre + np.array([0.0, 50.0])) == 2.0


def test_distances_equal_brute_force_on_a_turned_map():
    rng = np.random.default_rng(3)
    grid = grid_with(rng.integers(0, 20, size=(12, 2)), T_map_grid=SE2.from_xyt(3.0, -2.0, 0.7))
    walls = grid.center_of(np.argwhere(grid.cells == OCCUPIED))
    cells = rng.integers(0, 20, size=(40, 2))
    points = grid.center_of(cells)
    brute = np.linalg.norm(points[:, None] - walls[None], axis=-1).min(axis=1)
    assert np.allclose(sampled(distance_field(grid, 2.0), points), np.minimum(brute, 2.0), atol=1e-6)


def test_sum_over_beams_equals_a_plain_lookup():
    rng = np.random.default_rng(4)
    grid = grid_with(rng.integers(0, 20, size=(30, 2)), T_map_grid=SE2.from_xyt(0.5, 1.0, -2.0))
    field = distance_field(grid, 1.0)
    fine, factor = field.finer()
    table = np.log(hit_probability(fine, 0.1, 0.9, 0.1, 3.5)).astype(np.float32)
    T_map_base = SE2.from_xyt(*rng.uniform(-2.0, 4.0, size=(2, 50)), rng.uniform(-3.0, 3.0, size=50))
    points = rng.uniform(-2.0, 2.0, size=(9, 2))
    cells_per_m = factor / field.resolution
    corner = field.T_map_corner
    found = sum_over_beams(
        table,
        (float(corner.x), float(corner.y), float(corner.yaw), cells_per_m),
        T_map_base.xyt,
        (points * cells_per_m).astype(np.float32),
    )
    ends = (corner.inverse() @ (T_map_base[:, None] @ points)) * cells_per_m
    col, row = np.trunc(ends).astype(int)[..., 0], np.trunc(ends).astype(int)[..., 1]
    # The map is padded all round by the greatest distance that counts, which is that of all beyond.
    inside = (col >= 0) & (row >= 0) & (col < table.shape[1]) & (row < table.shape[0])
    values = np.where(
        inside, table[row.clip(0, table.shape[0] - 1), col.clip(0, table.shape[1] - 1)], table.min()
    ).sum(axis=1)
    # A point within a rounding error of a cell's border may fall to either side.
    assert np.mean(np.abs(found - values) < 1e-3) > 0.95


# motion


@given(st.floats(-0.5, 0.5), st.floats(-0.3, 0.3), st.floats(-3.0, 3.0), st.floats(-3.0, 3.0))
def test_a_motion_without_noise_is_the_odometry_itself(x, y, yaw, heading):
    T_base_new = SE2.from_xyt(x, y, yaw)
    poses = np.array([[1.0, 2.0, heading]])
    motion_model.move(poses, motion_model.decompose(T_base_new), np.zeros((1, 3)))
    wanted = SE2.from_xyt(1.0, 2.0, heading) @ T_base_new
    # Steps below 1 cm count as turns on the spot, then a step along the old heading.
    tolerance = 1e-9 if math.hypot(x, y) >= motion_model.MIN_STEP_M else 2.0 * motion_model.MIN_STEP_M
    assert np.allclose(SE2(poses[0]).xy, wanted.xy, atol=tolerance)
    assert abs(float((SE2(poses[0]).inverse() @ wanted).yaw)) < 1e-9


def test_driving_backwards_is_not_a_turn_by_pi():
    rot1, trans, rot2 = motion_model.decompose(SE2.from_xyt(-0.2, 0.01, 0.05))
    assert abs(rot1) < 0.1
    assert abs(rot2) < 0.11
    assert trans == pytest.approx(-math.hypot(0.2, 0.01))


def test_alphas_are_variances():
    std = motion_model.noise_std((0.3, 0.5, -0.2), (0.1, 0.2, 0.3, 0.4))
    assert std[0] ** 2 == pytest.approx(0.1 * 0.09 + 0.2 * 0.25)
    assert std[1] ** 2 == pytest.approx(0.3 * 0.25 + 0.4 * (0.09 + 0.04))
    assert std[2] ** 2 == pytest.approx(0.1 * 0.04 + 0.2 * 0.25)


# sampling


@given(st.lists(st.floats(0.0, 1.0), min_size=1, max_size=30), st.floats(0.0, 0.999))
def test_low_variance_draws_each_particle_its_share_to_within_one(raw, offset):
    weights = np.array(raw) + 1e-3
    weights /= weights.sum()
    counts = np.bincount(resampling.low_variance(weights, 200, offset), minlength=len(weights))
    assert np.abs(counts - 200 * weights).max() < 1.0 + 1e-6


def test_kld_bound_grows_with_bins_and_meets_the_chi_square_quantile():
    from scipy.stats import chi2

    for bins in (5, 50, 500):
        exact = chi2.ppf(0.99, bins - 1) / (2.0 * 0.02)
        assert resampling.kld_bound(bins, 0.02, 2.3263) == pytest.approx(exact, rel=0.02)
    assert resampling.kld_bound(1, 0.02, 2.33) == 1


def test_kld_needs_few_particles_for_a_point_and_many_for_a_cloud():
    rng = np.random.default_rng(1)
    narrow = resampling.bin_numbers(0.01 * rng.standard_normal((3000, 3)) + 0.12, 0.25, 0.2)
    wide = resampling.bin_numbers(rng.uniform(-3.0, 3.0, size=(3000, 3)), 0.25, 0.2)
    assert resampling.kld_count(narrow, 0.02, 2.33, 100) == 100
    assert resampling.kld_count(wide, 0.02, 2.33, 100) == 3000


def test_bins_are_those_of_a_plain_histogram():
    poses = np.random.default_rng(2).uniform(-2.0, 2.0, size=(500, 3))
    numbers = resampling.bin_numbers(poses, 0.5, 0.3)
    plain = [tuple(row) for row in np.floor(poses / [0.5, 0.5, 0.3]).astype(int)]
    order = {key: i for i, key in enumerate(dict.fromkeys(plain))}
    assert numbers.tolist() == [order[key] for key in plain]


def test_the_heavier_of_two_clusters_is_the_estimate():
    rng = np.random.default_rng(3)
    poses = np.concatenate([[0.0, 0.0, 3.1] + 0.02 * rng.standard_normal((300, 3)), [[4.0, 1.0, 0.0]] * 290])
    poses[:, 2] = (poses[:, 2] + np.pi) % (2.0 * np.pi) - np.pi
    found = main_cluster(poses, np.full(590, 1.0 / 590))
    assert np.allclose(found.T_map_base.xyt, [0.0, 0.0, 3.1], atol=0.01)
    assert np.sqrt(np.diag(found.core)).max() < 0.03
    assert np.sqrt(found.covariance[0, 0]) > 1.0


# beams


def test_deskewing_undoes_the_sweeps_motion():
    room = l_shaped_room()
    T_room_base, T_start_end = SE2.from_xyt(2.0, 2.2, 0.4), SE2.from_xyt(0.06, 0.004, 0.25)
    origins, directions = deskewed(
        LIDAR.directions, np.arange(360) / 360.0, T_BASE_LIDAR.xyt, T_start_end.xyt[None]
    )
    yaw = np.arctan2(directions[:, 1], directions[:, 0]) - LIDAR.angles
    T_start_lidar = SE2.from_xyt(origins[:, 0], origins[:, 1], yaw)
    ranges = room.ranges(T_room_base @ T_start_lidar, LIDAR.angles, LIDAR.range_max)
    beams = prepare(Scan(0, ranges.astype(np.float32), LIDAR), T_BASE_LIDAR, T_start_end)
    ends = T_room_base @ beams.points
    a, b = room.walls[:, :2], room.walls[:, 2:]
    t = np.clip(((ends[:, None] - a) * (b - a)).sum(-1) / ((b - a) ** 2).sum(-1), 0.0, 1.0)
    distance = np.linalg.norm(ends[:, None] - (a + t[..., None] * (b - a)), axis=-1).min(axis=1)
    assert distance.max() < 1e-6
    silent = prepare(Scan(0, np.full(360, np.inf, np.float32), LIDAR), T_BASE_LIDAR, T_start_end)
    np.testing.assert_allclose(silent.silent_origins, origins)
    np.testing.assert_allclose(silent.silent_directions, directions)


def test_nan_and_minus_inf_are_dropped_and_what_is_past_range_max_is_silent():
    ranges = np.full(360, 2.0, dtype=np.float32)
    ranges[:4] = [np.nan, -np.inf, np.inf, 9.0]
    beams = prepare(Scan(0, ranges, LIDAR), T_BASE_LIDAR)
    assert len(beams) == 356
    assert np.allclose(beams.silent_directions, LIDAR.directions[2:4])


@given(st.integers(0, 400), st.integers(1, 100))
def test_beams_are_spaced_evenly(count, most):
    picked = evenly_spaced(count, most)
    assert len(picked) == min(count, most)
    assert len(np.unique(picked)) == len(picked)
    if count > most > 1:
        assert np.ptp(np.diff(picked)) <= 1


def test_a_beam_through_a_wall_and_a_silent_one_into_a_wall_speak_against_a_pose():
    grid = grid_with([(r, 10) for r in range(20)] + [(r, 20) for r in range(20)])
    field = distance_field(grid, 2.0)
    corner = field.T_map_corner
    frame = (float(corner.x), float(corner.y), 0.0, 1.0 / field.resolution)
    left = np.array([[-0.5, 3.0, 0.0]])  # the walls are at x = 0.05 and x = 1.05
    ways = np.array([[0.55, 0.0], [1.55, 0.0], [3.0, 0.0], [-3.0, 0.0]])
    p = path_probabilities(field.distance, frame, left, np.zeros((4, 2)), ways, 2, (0.05, 0.9, 0.01))[0]
    assert p[0] > 0.8  # the near wall
    assert p[1] == pytest.approx(0.01)  # the far one, hidden
    assert p[2] < 0.2  # silence towards the walls
    assert p[3] > 0.8  # silence away from them


@settings(max_examples=30)
@given(st.lists(st.floats(-1e4, 0.0), min_size=100, max_size=200))
def test_tempering_leaves_enough_candidates(raw):
    weights = tempered(np.array(raw))
    assert weights.sum() == pytest.approx(1.0)
    assert resampling.effective_size(weights) >= 0.02 * len(raw) * 0.99


# parameters of others


def test_a_nav2_file_is_read_and_its_strange_keys_are_named():
    data = {
        "amcl": {
            "ros__parameters": {
                "alpha1": 0.2,
                "pf_err": 0.05,
                "laser_model_type": "likelihood_field",
                "laser_likelihood_max_dist": 2.0,
                "max_beams": 60,
                "base_frame_id": "base_footprint",
                "robot_model_type": "nav2_amcl::DifferentialMotionModel",
            }
        }
    }
    assert is_nav2(data)
    known, ignored = read_nav2(data, where="x.yaml")
    assert ignored == ["base_frame_id", "laser_model_type", "robot_model_type"]
    config = AmclConfig(**known)
    assert (config.alpha1, config.kld_err) == (0.2, 0.05)


@pytest.mark.parametrize("turn", [0.0, 0.5 * math.pi, math.pi, 1.5 * math.pi])
def test_walls_in_the_outermost_cells_of_a_map_explain_a_beam(turn):
    row, col = np.indices((11, 11))
    distance = 0.1 * np.minimum.reduce([row, col, 10 - row, 10 - col]).astype(np.float32)
    pose, way = np.array([[0.55, 0.55, turn]]), np.array([[0.5, 0.0]])
    frame, noise = (0.0, 0.0, 0.0, 10.0), (0.05, 0.9, 0.01)
    assert path_probabilities(distance, frame, pose, np.zeros((1, 2)), way, 1, noise)[0, 0] == pytest.approx(
        0.91
    )
    # a return from beyond the map is as likely as any other
    assert path_probabilities(distance, frame, pose, np.zeros((1, 2)), 1.5 * way, 1, noise)[
        0, 0
    ] == pytest.approx(0.01)
