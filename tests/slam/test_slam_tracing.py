"""Compiled beam tracing and matching fields, beside plain NumPy."""

import math

import numpy as np
import pytest

from tests.helpers.slam_rooms import ROOM, around_the_room, recording
from turtlebag.datasets.deskew import deskewed
from turtlebag.datasets.grid import FREE, OCCUPIED, UNKNOWN
from turtlebag.datasets.motion import KNOTS
from turtlebag.datasets.se2 import SE2
from turtlebag.datasets.types import LidarSpec, Recording, Trajectory
from turtlebag.pipeline.slam.grid import (
    Counts,
    OccupancyConfig,
    beam_lengths,
    cast_beams,
    cell_confidence,
    certainty,
    classify,
    make_checked_grid,
    make_grid,
    trace,
    trimmed,
)
from turtlebag.pipeline.slam.scans.clouds import make_clouds
from turtlebag.pipeline.slam.scans.correlative import UNSEEN, Field, best_pose, make_field
from turtlebag.pipeline.slam.thin_walls import beside


def plain_trace(hits, misses, x, y, dx, dy, length, returned, share):
    """The beam's cells from where it crosses the lines between them."""
    crossings = [0.0, length]
    for start, step in ((x, dx), (y, dy)):
        ends = sorted((start, start + step * length))
        lines = np.arange(math.ceil(ends[0]), math.floor(ends[1]) + 1)
        crossings += ((lines - start) / step).tolist() if step else []
    at = np.unique(np.round(crossings, 12))
    middles = 0.5 * (at[1:] + at[:-1])
    cells = [(math.floor(y + dy * t), math.floor(x + dx * t)) for t in middles]
    inside = lambda cell: 0 <= cell[0] < hits.shape[0] and 0 <= cell[1] < hits.shape[1]  # noqa: E731
    for cell, leave in zip(cells[:-1], at[1:-1], strict=True):
        if not inside(cell):
            continue
        if misses[cell] and leave > length - (1.0 if returned else 0.0):
            break
        if not returned and hits[cell] > share * (hits[cell] + misses[cell]):
            return
        misses[cell] = min(misses[cell] + 1, 65535)
    if returned and inside(cells[-1]):
        hits[cells[-1]] = min(hits[cells[-1]] + 1, 65535)


@pytest.mark.parametrize("seed", range(4))
def test_beams_are_counted_in_the_cells_between_the_lines_they_cross(seed):
    rng = np.random.default_rng(seed)
    hits = rng.choice([0, 0, 0, 1, 3, 65535], (17, 23)).astype(np.uint16)
    misses = rng.choice([0, 0, 2, 9, 65535], (17, 23)).astype(np.uint16)
    expected = hits.astype(int), misses.astype(int)
    for _ in range(400):
        x, y = rng.uniform(-4.0, 27.0), rng.uniform(-4.0, 21.0)
        angle, length, returned = rng.uniform(-4, 4), rng.uniform(0.0, 25.0), bool(rng.random() < 0.6)
        if rng.random() < 0.2:
            angle = rng.integers(4) * 0.5 * math.pi
        way = round(math.cos(angle), 15), round(math.sin(angle), 15)
        trace(Counts(hits, misses), (x, y), way, length, returned, 0.25)
        plain_trace(*expected, x, y, *way, length, returned, 0.25)
    np.testing.assert_array_equal(hits, expected[0])
    np.testing.assert_array_equal(misses, expected[1])


@pytest.mark.slow
def test_each_beam_starts_where_the_lidar_was_when_it_was_measured():
    rng = np.random.default_rng(5)
    n, beams, res = 3, 7, 0.1
    poses, motion = rng.normal([2.5, 3.0, 0.0], 0.8, (n, 3)), rng.normal(0.0, 0.2, (n, KNOTS, 3))
    length = rng.uniform(-0.5, 2.5, (n, beams)).astype(np.float32)
    returned = rng.random((n, beams)) < 0.6
    lidar, T_base_lidar = LidarSpec(beams, -2.0, 4.0 / (beams - 1), 0.1, 8.0), np.array([0.15, -0.08, 0.5])
    for moving in (motion, np.zeros((n, 1, 3))):
        found, expected = Counts.none(50, 60), Counts.none(50, 60)
        for with_return in (True, False):
            seen_from = (lidar.directions, lidar.shares, T_base_lidar, moving)
            traced = (length, returned == with_return)
            cast_beams(found, res, traced, seen_from, poses, (with_return, 0.25))
        for with_return in (True, False):
            for k in range(n):
                origins, ways = deskewed(
                    lidar.directions, np.linspace(0.0, 1.0, beams), T_base_lidar, moving[k]
                )
                starts, ways = SE2(poses[k]) @ origins / res, SE2.from_xyt(0.0, 0.0, poses[k, 2]) @ ways
                for b in range(beams):
                    if length[k, b] > 0.0 and returned[k, b] == with_return:
                        reach = float(length[k, b]) / res
                        trace(expected, tuple(starts[b]), tuple(ways[b]), reach, with_return, 0.25)
        np.testing.assert_array_equal(found.hits, expected.hits)
        np.testing.assert_array_equal(found.misses, expected.misses)
        assert found.hits.sum() > 5


def test_how_far_a_beam_clears_and_whether_it_ends_on_something():
    inf, nan = math.inf, math.nan
    ranges = np.array(
        [
            [0.05, 0.1, 2.0, 5.0, 5.1, 8.0, 8.1, nan],
            [inf, inf, 2.0, inf, 2.0, inf, 6.0, inf],
            [2.0, inf, 2.0, 2.0, inf, inf, 2.0, -inf],
        ],
        dtype=np.float32,
    )
    length, returned = beam_lengths(ranges, LidarSpec(8, 0.0, 0.1, 0.1, 8.0), 5.0, 4.0)
    f = np.float32
    np.testing.assert_array_equal(
        length,
        [
            [0, f(0.1), 2, 5, 5, 4, 4, 0],
            [4, 4, 2, 0, 2, 4, 5, 4],
            [2, 0, 2, 2, 4, 4, 2, 0],
        ],
    )
    assert returned.tolist() == [
        [False, bool(f(0.1) >= 0.1), True, True, False, False, False, False],
        [False, False, True, False, True, False, False, False],
        [True, False, True, True, False, False, True, False],
    ]
    blind = LidarSpec(3, 0.0, 0.1, 0.0, 8.0)
    assert not beam_lengths(np.full((1, 3), 0.009, np.float32), blind, 5.0, 4.0)[1].any()


def test_the_counts_agree_or_not_in_bits():
    hits = np.array([[4, 0, 2, 1, 3]], dtype=np.uint16)
    misses = np.array([[0, 5, 2, 1, 1]], dtype=np.uint16)
    share = np.array([1.0, 0.0, 0.5, 0.75])  # the fourth was met twice only
    bits = [0.0 if p in (0.0, 1.0) else -p * math.log2(p) - (1 - p) * math.log2(1 - p) for p in share]
    counts = Counts(hits, misses)
    found = certainty(counts, 2)
    assert found.entropy_bits == pytest.approx(np.mean(bits))
    assert found.wall_share == pytest.approx(np.mean([1.0, 0.5, 0.75]))
    assert certainty(counts, 3).wall_share == pytest.approx(np.mean([1.0, 0.75]))
    assert math.isnan(certainty(counts, 9).wall_share)
    nothing = certainty(Counts(hits[:, 3:4], misses[:, 3:4]), 1)
    assert math.isnan(nothing.entropy_bits)
    assert math.isnan(nothing.wall_share)
    # exactly as many beams as are needed, and more than sixteen bits hold
    just = Counts(np.array([[2]], np.uint16), np.array([[1]], np.uint16))
    assert certainty(just, 1).wall_share == pytest.approx(2 / 3)
    full = np.array([[65535]], np.uint16)
    assert certainty(Counts(full, full), 1).wall_share == 0.5


def test_a_cell_is_a_wall_from_its_share_and_hits_on_and_free_from_one_miss():
    hits = np.array([[0, 0, 1, 2, 2, 2, 65000]], dtype=np.uint16)
    misses = np.array([[0, 1, 0, 6, 7, 0, 65000]], dtype=np.uint16)
    config = OccupancyConfig(occupied_share=0.25, min_hits=2, behind_share=0.0, before_share=0.0)
    u, f, x = UNKNOWN, FREE, OCCUPIED
    assert classify(Counts(hits, misses), config).tolist() == [[u, f, u, x, f, x, x]]


def test_neighbours_are_the_four_beside_a_cell_and_none_beyond_the_border():
    cells = np.zeros((3, 4), dtype=np.int8)
    for row, col in np.ndindex(3, 4):
        for r, c in np.ndindex(3, 4):
            marked = cells.copy()
            marked[r, c] = 7
            assert beside(marked, row, col, 7) == (abs(r - row) + abs(c - col) == 1)


@pytest.mark.parametrize("margin", [0.0, 0.1, 0.12])
def test_the_map_is_cut_to_what_is_known_and_a_margin(margin):
    cells = np.full((20, 30), UNKNOWN, dtype=np.int8)
    cells[7, 11], cells[12, 20] = FREE, OCCUPIED
    border = math.ceil(margin / 0.05)
    grid = trimmed(cells, np.array([-40.0, 7.0]), OccupancyConfig(resolution_m=0.05, margin_m=margin))
    np.testing.assert_array_equal(grid.cells, cells[7 - border : 13 + border, 11 - border : 21 + border])
    np.testing.assert_allclose(
        grid.T_map_grid.xyt, [(-40 + 11 - border) * 0.05, (7 + 7 - border) * 0.05, 0.0]
    )
    assert (grid.cells[border, border], grid.cells[-1 - border, -1 - border]) == (FREE, OCCUPIED)
    cells[0, 0] = cells[19, 29] = FREE
    assert trimmed(cells, np.zeros(2), OccupancyConfig(margin_m=margin)).cells.shape == (20, 30)
    nothing = trimmed(
        np.full((20, 30), UNKNOWN, dtype=np.int8), np.zeros(2), OccupancyConfig(margin_m=margin)
    )
    assert nothing.cells.shape == (border + 1, border + 1)


def test_a_grid_is_made_of_all_that_the_beams_met():
    """The room's own walls, drawn by a lidar in motion with and without its odometry."""
    poses = around_the_room(40)
    grid = make_grid(recording(ROOM, poses), SE2(poses), OccupancyConfig(margin_m=0.3), 30.0)
    assert np.allclose(grid.T_map_grid.xy / 0.05, np.round(grid.T_map_grid.xy / 0.05))
    walls = np.argwhere(grid.cells == OCCUPIED)[:, ::-1] * 0.05 + 0.025 + grid.T_map_grid.xy
    off = np.min(
        [np.abs(walls[:, 0] - v) for v in (0, 8, 3, 3.5, 6, 6.4)]
        + [np.abs(walls[:, 1] - v) for v in (0, 6, 2, 4, 1.5)],
        axis=0,
    )
    assert off.max() < 0.06
    assert grid.value_at(np.array([[2.0, 3.0]]))[0] == FREE
    open_beams = LidarSpec(8, 0.0, math.pi / 4.0, 0.1, 6.0)
    silent = Recording("x", np.array([0]), np.full((1, 8), np.inf, np.float32), open_beams, SE2.identity())
    for config, reach in (
        (OccupancyConfig(no_return_m=2.0), 2.0), (OccupancyConfig(no_return_m=9.0), 4.0),
    ):  # fmt: skip
        free = np.argwhere(make_grid(silent, SE2.identity(1), config, 4.0).cells == FREE)
        assert (np.ptp(free, axis=0) * 0.05).tolist() == pytest.approx([2 * reach, 2 * reach], abs=0.11)
    none = make_grid(silent, SE2.identity(1), OccupancyConfig(no_return_m=0.0), 4.0)
    assert (none.cells == UNKNOWN).all()


def test_a_sweep_in_motion_is_drawn_by_its_own_odometry_or_by_what_it_is_told():
    lidar = LidarSpec(3, 0.0, 0.01, 0.1, 6.0, time_increment=0.5)
    stamps = np.array([0, 5], dtype=np.int64) * 10**8
    odometry = Trajectory(stamps * 4, SE2.from_xyt(np.array([0.0, 1.0]), np.zeros(2), np.zeros(2)))
    log = Recording(
        "x", stamps[:1], np.array([[2.0, 2.0, 2.0]], np.float32), lidar, SE2.identity(), odometry=odometry
    )
    config = OccupancyConfig(min_hits=1)
    ahead = SE2.from_xyt(np.full((1, KNOTS), 0.4), np.zeros((1, KNOTS)), np.zeros((1, KNOTS)))
    for motion, farthest in ((None, 2.5), (ahead, 2.4)):
        grid = make_checked_grid(log, SE2.identity(1), config, 30.0, motion).grid
        walls = np.argwhere(grid.cells == OCCUPIED)[:, 1] * 0.05 + 0.025 + grid.T_map_grid.x
        assert walls.max() == pytest.approx(farthest, abs=0.04)


def test_a_cell_is_the_surer_the_more_beams_agree_on_it():
    cells = np.array([[OCCUPIED, OCCUPIED, OCCUPIED, FREE, FREE, UNKNOWN]], dtype=np.int8)
    hits = np.array([[2, 50, 13, 0, 0, 0]], dtype=np.uint16)
    misses = np.array([[1, 5, 38, 1, 80, 0]], dtype=np.uint16)
    (few, many, even, once, often, unknown) = cell_confidence(cells, Counts(hits, misses), 0.25)[0].tolist()
    assert 102 < even < 178 < few < many
    assert 128 < once < 242 < often <= 255
    assert unknown == 0


def test_the_confidence_of_a_grid_has_its_cells():
    poses = around_the_room(5)
    drawn = make_checked_grid(recording(ROOM, poses), SE2(poses), OccupancyConfig(margin_m=0.3), 30.0)
    assert drawn.confidence.shape == drawn.grid.shape
    assert ((drawn.confidence > 0) == (drawn.grid.cells != UNKNOWN)).all()
    assert drawn.confidence[drawn.grid.cells == OCCUPIED].mean() > 204


@pytest.mark.slow
def test_a_field_holds_how_near_the_nearest_point_is():
    clouds = make_clouds(recording(ROOM, around_the_room(3)), 30.0)
    poses, res = around_the_room(3) + np.array([0.1, -0.2, 0.3]), 0.1
    field = make_field(clouds, np.array([2, 0]), poses[[2, 0]], res)
    points = np.vstack([SE2(poses[k]) @ clouds.of(k) for k in (2, 0)])
    margin = 5.0 * res
    np.testing.assert_allclose(field.corner, points.min(axis=0) - margin)
    cells = np.unique(np.floor((points - field.corner) / res).astype(int), axis=0)
    rows, cols = field.values.shape
    assert (np.array([cols, rows]) * res >= points.max(axis=0) - field.corner + margin).all()
    around = np.stack(np.meshgrid(np.arange(cols), np.arange(rows)), axis=-1)[:, :, None] - cells
    value = np.round(255.0 * np.exp(-0.5 * np.sum(around**2, axis=-1)))
    value[np.abs(around).max(axis=-1) > 3] = 0.0
    # what a beam passed through is empty, all else unseen
    seen = np.zeros((rows, cols), dtype=bool)
    for k in (2, 0):
        lidar = (SE2(poses[k]) @ clouds.origin[0] - field.corner) / res
        for end in (SE2(poses[k]) @ clouds.of(k) - field.corner) / res:
            steps = int(np.abs(end - lidar).max())
            way = np.floor(lidar + (end - lidar) * (np.arange(steps) / max(steps, 1))[:, None]).astype(int)
            way = way[((way >= 0) & (way < [cols, rows])).all(axis=1)]
            seen[way[:, 1], way[:, 0]] = True
    np.testing.assert_array_equal(field.values, np.maximum(value.max(axis=-1), np.where(seen, 0, UNSEEN)))
    empty = make_field(clouds, np.zeros(0, dtype=np.int64), np.zeros((0, 3)), res)
    assert empty.values.tolist() == [[UNSEEN]]


@pytest.mark.parametrize("seed", range(4))
def test_the_best_pose_is_that_of_all_that_can_be_tried(seed):
    rng = np.random.default_rng(seed)
    values = rng.integers(0, 256, (14, 19)).astype(np.uint8)
    field, center = Field(values, np.array([-0.7, -0.4]), 0.1), np.array([0.13, 0.21, 0.4])
    points = rng.uniform(-0.6, 0.9, (25, 2))
    window, turn, step = 0.25, 0.22, 0.1
    scores = {}
    for a in range(-3, 4):
        at = center[:2] + (SE2.from_xyt(0.0, 0.0, center[2] + a * step) @ points)
        cells = np.floor((at - field.corner) / 0.1).astype(int)
        for dr in range(-3, 4):
            for dc in range(-3, 4):
                c, r = (cells + np.array([dc, dr])).T
                ok = (r >= 0) & (r < 14) & (c >= 0) & (c < 19)
                scores[dr, dc, a] = int(values[r[ok], c[ok]].sum()) + UNSEEN * np.count_nonzero(~ok)
    liked = {k: s - 1e-3 * len(points) * sum(map(abs, k)) for k, s in scores.items()}
    dr, dc, a = max(liked, key=lambda k: liked[k])
    pose, score = best_pose(field, points, center, window, turn, step)
    np.testing.assert_allclose(pose, center + np.array([dc * 0.1, dr * 0.1, a * step]))
    assert score == pytest.approx(liked[dr, dc, a] / (255.0 * 25))
    nothing = best_pose(field, points[:0], center, window, turn, step)
    np.testing.assert_array_equal(nothing[0], center)
    assert nothing[1] == 0.0
