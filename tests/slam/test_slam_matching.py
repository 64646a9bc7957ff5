"""Lines, partners, alignment and correlative search, against plain NumPy and known answers."""

import math

import numpy as np
import pytest

from tests.helpers.slam_rooms import CORRIDOR, LDS, ROOM, SICK, recording
from turtlebag.datasets.se2 import SE2
from turtlebag.datasets.types import LidarSpec
from turtlebag.pipeline.slam.graph.partners import overlapping_pairs
from turtlebag.pipeline.slam.graph.refinement import pair_constraints
from turtlebag.pipeline.slam.odometry.track import blind
from turtlebag.pipeline.slam.scans.align import (
    FAKED,
    STEP_COVARIANCE_SCALE,
    Alignment,
    Prior,
    align,
    observable,
    possible,
)
from turtlebag.pipeline.slam.scans.clouds import make_clouds
from turtlebag.pipeline.slam.scans.correlative import (
    UNSEEN,
    Field,
    best_pose,
    make_field,
    points_in_map,
)
from turtlebag.pipeline.slam.scans.correspondences import Limits, find_partner
from turtlebag.pipeline.slam.scans.pairs import linearise_pairs

HERE = np.array([1.5, 1.2, 0.3])


@pytest.fixture(scope="module")
def room():
    """Five scans in a room: four key scans about a place and the one to align, all at known poses."""
    poses = np.array([[1.2, 1.0, 0.0], [1.8, 1.5, 1.0], [1.4, 2.0, -1.0], [2.0, 1.0, 3.0], HERE])
    return make_clouds(recording(ROOM, poses), 30.0), poses


def test_fitted_lines_lie_on_the_walls(room):
    clouds, poses = room
    for scan, pose in enumerate(poses):
        rows = slice(clouds.starts[scan], clouds.starts[scan + 1])
        ok = clouds.line_ok[rows]
        assert ok.mean() > 0.85
        T = SE2(pose)
        centers, ends = T @ clouds.centers[rows][ok], T @ (clouds.centers[rows] + clouds.normals[rows])[ok]
        distance = np.min(
            [np.abs(centers[:, 0] - x) for x in (0, 8, 3, 3.5, 6, 6.4)]
            + [np.abs(centers[:, 1] - y) for y in (0, 6, 2, 4, 1.5)],
            axis=0,
        )
        assert np.percentile(distance, 90) < 0.012
        normals = ends - centers
        np.testing.assert_allclose(np.linalg.norm(normals, axis=1), 1.0, atol=1e-6)
        # every wall is along an axis: so is its normal, but for range noise
        off_axis = np.arcsin(np.clip(np.abs(normals).min(axis=1), 0, 1))
        assert np.median(off_axis) < 0.1
        # and it points at the sensor
        assert np.all(np.einsum("ij,ij->i", normals, pose[:2] - centers) > 0.0)


def test_dense_beams_on_a_wall_lie_on_one_surface_though_their_noise_parts_them():
    """A depth camera 5 m from a wall: beams 15 mm apart that lie 6 cm off it."""
    camera = LidarSpec(320, -math.radians(29.0), math.radians(58.0) / 319, 0.3, 10.0)
    log = recording(CORRIDOR * 5.0, np.tile([0.0, 0.0, 1.5708], (20, 1)), camera, noise=0.06)
    clouds = make_clouds(log, 30.0)
    assert clouds.line_ok.mean() > 0.7
    assert {clouds.placed_by(scan) for scan in range(20)} == {"lines"}


def test_noise_along_the_rays_does_not_turn_surfaces_towards_them():
    """Walls to both sides of a corridor, 5 cm of noise: turned towards the rays they would all tell, wherever
    the robot is, that it stands still."""
    camera = LidarSpec(640, -math.radians(60.0), math.radians(120.0) / 639, 0.3, 4.0)
    clouds = make_clouds(recording(CORRIDOR, np.zeros((20, 3)), camera, noise=0.05), 30.0)
    near = clouds.line_ok & (np.hypot(*clouds.points.T) < 2.5)
    assert np.count_nonzero(near) > 0.9 * np.count_nonzero(np.hypot(*clouds.points.T) < 2.5)
    assert abs(clouds.normals[near, 0].mean()) < 0.03
    told = np.sqrt(clouds.normal_var[near].mean())
    assert np.sqrt((clouds.normals[near, 0] ** 2).mean()) < 2.0 * told


def test_scan_without_returns_has_no_points():
    log = recording(ROOM, np.array([HERE, HERE]))
    log.ranges[0] = np.nan
    clouds = make_clouds(log, 30.0)
    assert len(clouds.of(0)) == 0
    assert clouds.lines(0) == 0 < clouds.lines(1)


def test_partner_is_the_nearest_point_of_the_scan(room):
    clouds, _ = room
    rng = np.random.default_rng(3)
    gate = 0.1
    kept = clouds.table[0][clouds.table[0] >= 0]
    assert len(kept) > 0.7 * len(clouds.of(0))
    around = clouds.points[kept[rng.integers(0, len(kept), 300)]] + rng.normal(0.0, 0.04, (300, 2))
    found = np.array([find_partner(*p, 0, clouds, gate) for p in around])
    distances = np.linalg.norm(clouds.points[kept] - around[:, None], axis=2)
    expected = np.where(distances.min(axis=1) < gate, kept[distances.argmin(axis=1)], -1)
    np.testing.assert_array_equal(found, expected)


@pytest.mark.parametrize("off", [(0.08, -0.05, 0.04), (-0.1, 0.1, -0.05), (0.0, 0.0, 0.1)])
def test_alignment_finds_the_true_pose(room, off):
    clouds, poses = room
    start = HERE + np.array(off)
    result = align(clouds, 4, start, np.arange(4), poses[:4], Limits(0.3, 0.05, 20))
    np.testing.assert_allclose(result.T_map_base.xyt, HERE, atol=0.006)
    assert result.overlap > 0.9
    assert result.rmse < 0.02


def test_corridor_leaves_the_way_along_to_the_prior():
    keys = np.array([[0.0, 0.1, 0.0], [0.4, 0.0, 0.02], [0.8, 0.05, -0.02]])
    truth = np.array([1.2, 0.0, 0.0])
    clouds = make_clouds(recording(CORRIDOR, np.vstack([keys, truth]), SICK), 30.0)
    prior = np.array([1.25, 0.06, 0.03])  # off along, across and in yaw
    result = align(
        clouds, 3, prior, np.arange(3), keys, Limits(0.3, 0.05, 30),
        Prior(prior, np.diag([100.0, 100.0, 400.0])),
    )  # fmt: skip
    x, y, yaw = result.T_map_base.xyt
    assert x == pytest.approx(1.25, abs=0.005)
    assert y == pytest.approx(0.0, abs=0.01)
    assert yaw == pytest.approx(0.0, abs=0.005)
    assert result.information[0, 0] < 0.01 * result.information[1, 1]


def test_a_direction_counts_as_far_as_it_exceeds_what_noisy_normals_fake():
    information = np.diag([10.0, 100.0, 50.0])
    np.testing.assert_allclose(observable(information, 0.0), information)
    half = observable(information, 5.0 / FAKED)
    np.testing.assert_allclose(half, np.diag([5.0, 100.0, 50.0]), atol=1e-9)
    np.testing.assert_allclose(observable(information, 20.0 / FAKED)[0], 0.0, atol=1e-9)


def test_a_round_corridor_leaves_the_turn_about_its_centre_open_and_nothing_else():
    bearing, radius = np.linspace(0.0, 2.0 * np.pi, 40, endpoint=False), 3.0
    # every normal passes through the centre, left of the robot
    rows = np.stack([np.cos(bearing), np.sin(bearing), -radius * np.cos(bearing)], axis=1)
    rows *= np.where(np.abs(np.cos(bearing)) < 0.5, 1.0, 0.1)[:, None]
    seen, faked = rows.T @ rows, np.diag([0.4, 0.0, 0.0])
    found = observable(seen + faked, 0.5)
    np.testing.assert_allclose(found, seen, atol=1e-9)
    np.testing.assert_allclose(found @ [radius, 0.0, 1.0], 0.0, atol=1e-9)
    assert blind(found)
    assert not blind(np.diag([1.0, 1.0, 0.0]))


def test_search_finds_a_pose_far_off(room):
    clouds, poses = room
    field = make_field(clouds, np.arange(4), poses[:4], 0.1)
    start = HERE + np.array([0.7, -0.6, 0.4])
    pose, score = best_pose(field, clouds.of(4), start, 1.0, 0.6, 0.03)
    np.testing.assert_allclose(pose, HERE, atol=0.08)
    assert score > 0.6


def test_what_was_seen_empty_denies_and_what_was_not_seen_does_not():
    """One scan from within the room: its free space, its walls, and what lies behind them."""
    clouds = make_clouds(recording(ROOM, np.array([[1.5, 1.2, 0.3]]), noise=0.0), 30.0)
    field = make_field(clouds, np.array([0]), np.array([[1.5, 1.2, 0.3]]), 0.05)

    def value(x, y):
        return field.values[tuple(((np.array([y, x]) - field.corner[::-1]) / field.resolution).astype(int))]

    assert value(1.5, 3.0) == 0  # in view
    assert value(0.0, 1.5) > 200  # the wall
    assert value(4.5, 3.6) == UNSEEN  # behind the pillar


def test_a_scan_of_space_nobody_saw_agrees_with_what_was_seen():
    """Half a circle looking up the room, matched with one that looks down it from the same place."""
    poses = np.array([[1.5, 3.0, 0.9], [1.5, 3.0, -1.4]])
    clouds = make_clouds(recording(ROOM, poses, SICK), 30.0)
    found = align(clouds, 1, poses[1], np.array([0]), poses[:1], Limits(0.2, 0.05, 0))
    assert found.overlap < 0.5
    assert found.agreement > 0.95


def test_a_scan_laid_where_others_looked_through_disagrees():
    poses = np.array([[1.5, 3.0, 0.2], [1.5, 3.0, 0.4]])
    clouds = make_clouds(recording(ROOM, poses, SICK), 30.0)
    truly, aside = (
        align(clouds, 1, poses[1] + off, np.array([0]), poses[:1], Limits(0.2, 0.05, 0))
        for off in (np.zeros(3), np.array([-0.6, 0.0, 0.2]))
    )
    assert truly.agreement > 0.95
    assert aside.known > 0.4
    assert aside.agreement < 0.6
    assert aside.cost > truly.cost + 0.3


def test_search_scores_as_numpy_does():
    rng = np.random.default_rng(2)
    values = rng.integers(0, 255, (20, 30)).astype(np.uint8)
    field = Field(values, np.array([-1.0, -1.0]), 0.1)
    points = rng.uniform(-0.5, 0.9, (40, 2))
    pose, score = best_pose(field, points, np.zeros(3), 0.2, 0.1, 0.05)

    def reference(x, y, yaw):
        moved = SE2.from_xyt(0.0, 0.0, yaw) @ points
        cols = np.floor((moved[:, 0] + 1.0) / 0.1).astype(int) + round(x / 0.1)
        rows = np.floor((moved[:, 1] + 1.0) / 0.1).astype(int) + round(y / 0.1)
        inside = (rows >= 0) & (rows < 20) & (cols >= 0) & (cols < 30)
        seen = values[rows[inside], cols[inside]].sum(dtype=int)
        return (seen + UNSEEN * np.count_nonzero(~inside)) / (255.0 * 40)

    offsets = np.arange(-2, 3) * 0.1
    best = max(reference(x, y, yaw) for x in offsets for y in offsets for yaw in np.arange(-2, 3) * 0.05)
    assert score == pytest.approx(best, abs=1e-4)
    assert reference(*pose) == pytest.approx(best, abs=1e-4)


def test_points_are_moved_into_the_map(room):
    clouds, poses = room
    moved = points_in_map(clouds.points, clouds.starts, np.array([3, 1]), poses[[3, 1]])
    expected = np.vstack([SE2(poses[3]) @ clouds.of(3), SE2(poses[1]) @ clouds.of(1)])
    np.testing.assert_allclose(moved, expected, atol=1e-12)


def test_pairs_know_their_relative_pose(room):
    clouds, poses = room
    off = poses.copy()
    off[1] += [0.04, -0.03, 0.02]
    pairs = np.array([[0, 1], [0, 2]])
    limits = Limits(0.3, 0.06)
    relative, information, overlap = linearise_pairs(clouds, np.arange(5), off, pairs, limits)
    true = (SE2(poses[0]).inverse() @ SE2(poses[1])).xyt
    np.testing.assert_allclose(relative[0], true, atol=0.015)
    assert overlap.min() > 0.6
    assert np.linalg.eigvalsh(information[0])[0] > 1.0
    found = pair_constraints(clouds, np.arange(5), SE2(off), pairs, limits)
    np.testing.assert_allclose(found[0].information * STEP_COVARIANCE_SCALE, information[0])


def test_partners_are_spread_over_the_visits():
    visit = np.column_stack([np.linspace(0, 3, 30), np.zeros(30), np.zeros(30)])
    poses = np.vstack([visit, visit + np.array([0.0, 0.5, 0.0])])
    pairs = overlapping_pairs(SE2(poses), 2.0, 6)
    assert np.all(pairs[:, 0] < pairs[:, 1])
    across = (pairs[:, 0] < 30) & (pairs[:, 1] >= 30)
    assert across.mean() > 0.25
    assert {(k, k + 1) for k in range(59)} <= {tuple(pair) for pair in pairs.tolist()}


def test_lidar_off_the_base_is_looked_up_from_its_own_place():
    poses = np.array([[1.2, 1.0, 0.0], [1.5, 1.2, 0.3]])
    T_base_lidar = SE2.from_xyt(0.2, 0.05, 0.5)
    log = recording(ROOM, (SE2(poses) @ T_base_lidar).xyt, LDS)
    log = type(log)(log.source, log.stamps_ns, log.ranges, log.lidar, T_base_lidar)
    clouds = make_clouds(log, 30.0)
    result = align(clouds, 1, poses[1] + [0.05, 0.05, 0.03], np.array([0]), poses[:1], Limits(0.3, 0.05))
    np.testing.assert_allclose(result.T_map_base.xyt, poses[1], atol=0.015)


def test_what_lies_beyond_the_field_s_edges_is_not_found_at_the_opposite_edge():
    """Points at the lower edge and walls at the upper one: the walls are not met, however far is searched;
    outside the field nothing is known."""
    values = np.zeros((6, 30), dtype=np.uint8)
    values[-1] = 255
    field = Field(values, np.zeros(2), 0.1)
    points = np.column_stack([np.linspace(0.5, 2.5, 20), np.full(20, 0.05)])
    pose, score = best_pose(field, points, np.zeros(3), 0.3, 0.0, 0.05)
    assert score == pytest.approx(UNSEEN / 255.0, abs=1e-4)
    assert pose[1] < 0.0
    _, score = best_pose(field, points + np.array([0.0, 0.3]), np.zeros(3), 0.3, 0.0, 0.05)
    assert score == pytest.approx(1.0, abs=1e-3)


@pytest.mark.parametrize(
    ("overlap", "known", "says"),
    [
        (0.29, 1.0, (False, False)),
        (0.3, 1.0, (True, False)),
        (0.46, 0.5, (True, True)),
        (0.0, 0.0, (False, False)),
    ],
)
def test_an_alignment_says_whether_it_is_possible_and_certain(overlap, known, says):
    alignment = Alignment(SE2(HERE), np.eye(3), overlap, 0.01, 0.2, known)
    assert (alignment.possible, alignment.certain) == says
    assert possible(np.array([overlap, 1.0])).tolist() == [says[0], True]
