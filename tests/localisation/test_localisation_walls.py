"""Surfaces and the wall filter: walls found, slips undone, against plain references."""

import math

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from tests.helpers.localisation_room import LIDAR, T_BASE_LIDAR, l_shaped_room
from turtlebag.datasets.grid import FREE, OCCUPIED, UNKNOWN, OccupancyGrid
from turtlebag.datasets.se2 import SE2
from turtlebag.datasets.types import LidarSpec, Scan
from turtlebag.pipeline.localisation.deskewed_beams import prepare
from turtlebag.pipeline.localisation.small_matrices import multiply, solve
from turtlebag.pipeline.localisation.surfaces import fit_surfaces
from turtlebag.pipeline.localisation.wall_filter import FIXED, MAX_WALLS, POSE, WallFilter


def offsets(track):
    """Offset and its standard deviation [m] of each known wall, by patch."""
    std = np.sqrt(np.diag(track.P)[FIXED:])
    return {int(p): (o, s) for p, o, s in zip(track.walls, track.state[FIXED:], std, strict=True)}


def odometry_errors(track):
    """Share of distance, share of turn, turn by distance [rad/m] that odometry lacks, and their std."""
    return track.state[POSE:FIXED].copy(), np.sqrt(np.diag(track.P)[POSE:FIXED])


@pytest.mark.slow
def test_a_slanted_wall_is_found_finer_than_its_cells():
    angle = 0.4
    normal = np.array([-math.sin(angle), math.cos(angle)])
    cells = np.full((80, 120), UNKNOWN, dtype=np.int8)
    grid = OccupancyGrid(cells, 0.05)
    centres = grid.center_of(np.stack(np.indices(cells.shape), axis=-1))
    above = (centres - [3.0, 2.0]) @ normal
    cells[above > 0.0] = FREE
    for t in np.linspace(-4.0, 4.0, 8000):
        cell = grid.cell_of(np.array([3.0, 2.0]) + t * np.array([math.cos(angle), math.sin(angle)]))
        if grid.contains(cell):
            cells[tuple(cell)] = OCCUPIED
    surfaces = fit_surfaces(grid)
    points = surfaces.T_map_surfaces @ surfaces.points
    inner = np.all((points > 0.4) & (points < [5.6, 3.6]), axis=1)
    stairs = np.abs((grid.center_of(np.argwhere(cells == OCCUPIED))[inner] - [3.0, 2.0]) @ normal)
    fitted = np.abs((points[inner] - [3.0, 2.0]) @ normal)
    assert np.sqrt(np.mean(fitted**2)) < 0.4 * np.sqrt(np.mean(stairs**2))
    assert (surfaces.normals[inner] @ normal).min() > 0.98
    assert np.unique(surfaces.patch[inner]).size <= 3


def test_the_wall_filter_finds_the_pose_and_where_the_walls_stand():
    """Walls 1 cm in front of their cells' centres on one side: the error goes to the wall, not the pose."""
    grid = l_shaped_room().grid()
    room, rng = l_shaped_room(), np.random.default_rng(6)
    T = SE2.from_xyt(2.0, 2.0, 0.1)
    start = T @ SE2.from_xyt(0.03, -0.02, 0.02)
    track = WallFilter(
        fit_surfaces(grid),
        start,
        np.diag([0.05, 0.05, 0.05]) ** 2,
    )
    ranges = room.ranges(SE2((T @ T_BASE_LIDAR).xyt[None]), LIDAR.angles, 3.5)
    for _ in range(10):
        noisy = (ranges + 0.01 * rng.standard_normal(360)).astype(np.float32)
        track.correct(prepare(Scan(0, noisy, LIDAR), T_BASE_LIDAR).points)
    error = T.inverse() @ track.T_map_base
    assert np.hypot(error.x, error.y) < 0.008
    assert abs(float(error.yaw)) < 0.004
    assert max(abs(offset) for offset, _ in offsets(track).values()) < 0.025
    assert all(0.0 < std <= 0.0071 for _, std in offsets(track).values())


def wall_filter(start: SE2, most_walls: int = MAX_WALLS) -> WallFilter:
    cov = np.diag([0.02, 0.02, 0.02]) ** 2
    return WallFilter(fit_surfaces(l_shaped_room().grid()), start, cov, most_walls)


def scanned(T: SE2, rng: np.random.Generator) -> np.ndarray:
    """End points of a noisy scan of the L-shaped room in the base frame."""
    ranges = l_shaped_room().ranges(SE2((T @ T_BASE_LIDAR).xyt[None]), LIDAR.angles, 3.5)
    noisy = (ranges + 0.01 * rng.standard_normal(360)).astype(np.float32)
    return prepare(Scan(0, noisy, LIDAR), T_BASE_LIDAR).points


def test_the_wall_filter_learns_what_odometry_gets_wrong():
    """Wheels 3 % too small and a track 4 % too wide, by odometry's reckoning; little noise beside."""
    T, rng = SE2.from_xyt(1.5, 1.5, 0.0), np.random.default_rng(7)
    track = wall_filter(T)
    for k in range(160):
        step = SE2.from_xyt(0.05, 0.0, 0.0) if (k // 20) % 2 == 0 else SE2.from_xyt(0.0, 0.0, math.pi / 40)
        told = SE2.from_xyt(step.x / 0.97, 0.0, step.yaw / 1.04)
        track.predict(told, (0.0, float(told.x), float(told.yaw)), np.full(3, 1e-3))
        T = T @ step
        track.correct(scanned(T, rng))
    errors, std = odometry_errors(track)
    assert np.all(np.abs(errors - [-0.03, 0.04, 0.0]) < np.maximum(3.0 * std, 0.002))
    assert np.all(std < [0.004, 0.004, 0.004])
    error = T.inverse() @ track.T_map_base
    assert np.hypot(error.x, error.y) < 0.02


def test_a_slip_of_the_wheels_is_noticed_and_undone_by_the_same_scan():
    T, rng = SE2.from_xyt(2.0, 2.0, 0.1), np.random.default_rng(8)
    track = wall_filter(T)
    usual = [track.correct(scanned(T, rng)) for _ in range(20)]
    assert max(usual[5:]) < 3.0
    slip = SE2.from_xyt(0.08, 0.0, 0.05)
    track.predict(slip, (0.0, 0.08, 0.05), np.full(3, 1e-3))
    assert track.correct(scanned(T, rng)) > 6.0
    error = T.inverse() @ track.T_map_base
    assert np.hypot(error.x, error.y) < 0.015
    assert abs(float(error.yaw)) < 0.01


def test_a_wall_has_one_offset_however_often_it_is_seen_and_keeps_it_when_others_are_forgotten():
    """While the robot turns on the spot, a filter that keeps three walls, beside those in sight, knows of
    them what one knows that keeps all."""
    T, rng = SE2.from_xyt(0.6, 0.6, 0.1), np.random.default_rng(8)
    whole, few = wall_filter(T), wall_filter(T, 3)
    cell = fit_surfaces(l_shaped_room().grid()).resolution
    seen: set[int] = set()
    for k in range(11):
        points = ahead(scanned(T, rng))
        for track in (whole, few):
            track.correct(points)
        both = offsets(whole), offsets(few)
        assert len(both[1]) == len(few.walls) <= len(set(whole.walls)) == len(whole.walls)
        for wall, (offset, std) in both[1].items():
            assert (offset, std) == pytest.approx(both[0][wall], abs=1e-9)
        assert all(std <= 0.14 * cell + 1e-12 for _, std in both[0].values())
        seen |= set(both[1])
        step = SE2.from_xyt(0.0, 0.0, 0.5 if k % 2 else 0.0)
        for track in (whole, few):
            track.predict(step, (0.0, 0.0, float(step.yaw)), np.full(3, 1e-3))
        T = T @ step
    assert set(offsets(whole)) == seen
    assert len(whole.walls) == 9
    assert len(few.walls) == 1


@pytest.mark.parametrize("most", [1, 6])
def test_a_slip_where_walls_are_forgotten_leaves_the_others_in_their_place(most):
    """The scan that shows the slip also shows new walls, so that old ones must go."""
    T, rng = SE2.from_xyt(0.6, 0.6, 0.1), np.random.default_rng(8)
    track = wall_filter(T, most)
    for _ in range(10):
        track.correct(ahead(scanned(T, rng)))
    known = set(offsets(track))
    slip = SE2.from_xyt(0.08, 0.0, 0.05)
    track.predict(slip, (0.0, 0.08, 0.05), np.full(3, 1e-3))
    T = T @ SE2.from_xyt(0.0, 0.0, 1.8)
    track.predict(SE2.from_xyt(0.0, 0.0, 1.8), (0.0, 0.0, 1.8), np.full(3, 1e-3))
    assert track.correct(ahead(scanned(T, rng))) > 6.0
    assert known - set(offsets(track))
    assert set(offsets(track)) - known
    error = T.inverse() @ track.T_map_base
    assert np.hypot(error.x, error.y) < 0.03
    assert abs(float(error.yaw)) < 0.02
    assert max(abs(offset) for offset, _ in offsets(track).values()) < 0.02


def ahead(points_base: np.ndarray) -> np.ndarray:
    """What a lidar that looks ahead sees of it."""
    return points_base[np.abs(np.arctan2(points_base[:, 1], points_base[:, 0])) < 0.8]


@given(st.integers(1, 12), st.integers(0, 1000))
@settings(max_examples=30)
def test_small_linear_algebra_equals_numpys(n, seed):
    rng = np.random.default_rng(seed)
    a, b = rng.standard_normal((n, n)) + 3.0 * np.eye(n), rng.standard_normal((n, 3))
    assert np.allclose(multiply(a, b), a @ b)
    assert np.allclose(a @ solve(a, b), b, atol=1e-8)


@pytest.mark.parametrize("turned", [-2.5, 0.0, 0.8])
def test_a_covariance_given_in_the_map_is_meant_in_the_map_however_the_grid_lies_in_it(turned):
    """One long wall along the map's x: it puts right 5 cm across it where 15 cm were expected, not 1 mm."""
    T_map_grid = SE2.from_xyt(1.0, -2.0, turned)
    grid = OccupancyGrid(np.full((120, 120), UNKNOWN, dtype=np.int8), 0.05, T_map_grid)
    middle = T_map_grid @ np.array([3.0, 3.0])
    centres = grid.center_of(np.stack(np.indices(grid.cells.shape), axis=-1)) - middle
    grid.cells[centres[..., 1] < 1.0] = FREE
    for along in np.linspace(-2.0, 2.0, 2000):
        grid.cells[tuple(grid.cell_of(middle + np.array([along, 1.0])))] = OCCUPIED
    points = np.column_stack([np.linspace(-1.2, 1.2, 80), np.full(80, 1.0)])
    off = []
    for std in ([1e-3, 0.15, 1e-3], [0.15, 1e-3, 1e-3]):
        track = WallFilter(
            fit_surfaces(grid), SE2.from_xyt(middle[0], middle[1] + 0.05, 0.0), np.diag(std) ** 2,
        )  # fmt: skip
        track.correct(points)
        off.append(float(track.T_map_base.y) - middle[1])
    # the wall lies somewhere in its cells
    assert abs(off[0]) < 0.03
    assert off[1] == pytest.approx(0.05, abs=0.003)


def test_a_lidar_that_turns_the_other_way_is_seen_from_where_it_was():
    """Beams in the order of their times and against it say the same."""
    room, T, motion = l_shaped_room(), SE2.from_xyt(2.0, 2.0, 0.3), SE2.from_xyt(0.06, 0.0, 0.0)
    fraction = np.arange(360) / 360.0
    T_start_base = SE2.from_xyt(0.06 * fraction, 0.0 * fraction, 0.0 * fraction)
    seen = room.ranges(T @ T_start_base @ SE2(T_BASE_LIDAR.xyt[None]), LIDAR.angles, 3.5).astype(np.float32)
    there = prepare(Scan(0, seen, LIDAR), T_BASE_LIDAR, motion).points
    back = LidarSpec(360, LIDAR.angles[-1], -LIDAR.angle_increment, 0.12, 3.5, -LIDAR.time_increment, 0.2)
    turned = prepare(Scan(0, seen[::-1].copy(), back), T_BASE_LIDAR, motion).points
    assert np.allclose(turned[::-1], there, atol=1e-6)
