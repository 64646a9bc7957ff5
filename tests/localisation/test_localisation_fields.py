"""Likelihood field, beam paths, views and free space, beside plain NumPy."""

import math

import numpy as np
import pytest

from tests.helpers.localisation_room import LIDAR, T_BASE_LIDAR, l_shaped_room, sampled
from turtlebag.datasets.grid import FREE, OCCUPIED, UNKNOWN, OccupancyGrid
from turtlebag.datasets.se2 import SE2
from turtlebag.datasets.types import Scan
from turtlebag.pipeline.localisation import global_search as search
from turtlebag.pipeline.localisation.deskewed_beams import evenly_spaced, prepare
from turtlebag.pipeline.localisation.likelihood_field import (
    LikelihoodField,
    distance_field,
    hit_probability,
    sum_over_beams,
)
from turtlebag.pipeline.localisation.local_search import NEIGHBOURS, climb
from turtlebag.pipeline.localisation.parameters import AmclConfig


def cluttered(seed, shape=(24, 31), share=0.05, T_map_grid=None):
    cells = np.where(np.random.default_rng(seed).random(shape) < share, OCCUPIED, FREE).astype(np.int8)
    return OccupancyGrid(cells, 0.1, T_map_grid or SE2.from_xyt(-1.0, 2.0, 0.4))


def frame_of(field, factor=1):
    x, y, yaw = field.T_map_corner.xyt.tolist()
    return x, y, yaw, factor / field.resolution


def test_beams_ends_are_looked_up_in_the_table_and_beyond_it_its_border_counts():
    rng = np.random.default_rng(10)
    table = rng.random((30, 44)).astype(np.float32)
    frame, points = (0.3, -0.8, 0.9, 8.0), rng.uniform(-9.0, 9.0, (7, 2)).astype(np.float32)
    poses = np.column_stack([rng.uniform(-3.0, 5.0, (300, 2)), rng.uniform(-4.0, 4.0, 300)])
    ends = (SE2(np.array(frame[:3])).inverse() @ (SE2(poses)[:, None] @ (points / 8.0))) * 8.0
    cells = np.trunc(ends).astype(int)
    inside = np.all((cells >= 0) & (cells < [44, 30]), axis=-1)
    value = table[np.clip(cells[..., 1], 0, 29), np.clip(cells[..., 0], 0, 43)]
    expected = value.sum(axis=1)
    found = sum_over_beams(table, frame, poses, points)
    doubtful = np.abs(ends - np.round(ends)).min(axis=(1, 2)) < 1e-4
    np.testing.assert_allclose(found[~doubtful], expected[~doubtful], rtol=1e-5)
    assert inside.all(axis=1).sum() > 20 < (~inside).any(axis=1).sum()


def walk(field, frame, x, y, ux, uy, end):
    """Where a beam in the frame of the field first is in a cell by a wall: its row, column; None by `end`."""
    at, cell = 0.0, 1.0 / frame[3]
    while at < end:
        gx, gy = (x + ux * at) * frame[3], (y + uy * at) * frame[3]
        if not (0.0 <= gx < field.shape[1] and 0.0 <= gy < field.shape[0]):
            return None
        d = field[int(gy), int(gx)]
        if d < 0.5 * cell:
            return int(gy), int(gx)
        at += max(d - 0.75 * cell, 0.5 * cell)
    return None


@pytest.mark.parametrize("seed", range(3))
def test_a_beam_is_as_likely_as_its_path_and_its_end_say(seed):
    rng = np.random.default_rng(seed)
    field = distance_field(cluttered(seed, share=0.03), 1.5)
    frame, noise = frame_of(field), (0.2, 0.8, 0.05)
    T_field_map = SE2(np.array(frame[:3])).inverse()
    poses = np.column_stack([field.T_map_corner @ rng.uniform(1.0, 4.0, (20, 2)), rng.uniform(-4, 4, 20)])
    starts, ways = rng.normal(0.0, 0.2, (12, 2)), rng.normal(0.0, 1.2, (12, 2))
    ways[0] *= 0.1 / np.linalg.norm(ways[0])  # shorter than the slack
    expected = np.empty((20, 12))
    for i, pose in enumerate(poses):
        T = T_field_map @ SE2(pose)
        for j in range(12):
            start, end = T @ starts[j], T @ (starts[j] + ways[j])
            length = np.linalg.norm(end - start)
            ux, uy = (end - start) / length
            blocked = walk(field.distance, frame, *start, ux, uy, length - search.PATH_SLACK_M) is not None
            if j >= 7:
                expected[i, j] = search.P_MISSED if blocked else 1.0 - search.P_MISSED
                continue
            c, r = np.trunc(end * frame[3]).astype(int)
            inside = 0 <= c < field.distance.shape[1] and 0 <= r < field.distance.shape[0]
            d = field.distance[r, c] if inside and not blocked else np.inf
            expected[i, j] = 0.05 + 0.8 * math.exp(-0.5 * (d / 0.2) ** 2)
    found = search.path_probabilities(field.distance, frame, poses, starts, ways, 7, noise)
    assert np.mean(np.isclose(found, expected, atol=1e-6)) > 0.99
    assert len(np.unique(found[:, 7:])) == 2


def test_the_likelihood_field_multiplies_what_evenly_spaced_beams_say():
    room, rng = l_shaped_room(), np.random.default_rng(11)
    T = SE2.from_xyt(2.0, 2.0, 0.3)
    ranges = room.ranges(SE2((T @ T_BASE_LIDAR).xyt[None]), LIDAR.angles, 2.0)
    beams = prepare(Scan(0, ranges.astype(np.float32), LIDAR), T_BASE_LIDAR)
    field, config = distance_field(room.grid(), 2.0), AmclConfig(max_beams=30)
    poses = T.xyt + rng.normal(0.0, 0.1, (5, 3))
    distance, factor = field.finer()
    table = np.log(hit_probability(distance, config.sigma_hit, config.z_hit, config.z_rand, 2.0)).astype(
        np.float32
    )
    points = (beams.points[evenly_spaced(len(beams), 30)] * factor / 0.05).astype(np.float32)
    wanted = sum_over_beams(table, frame_of(field, factor), poses, points)
    np.testing.assert_allclose(LikelihoodField(config, field, 2.0).weigh(poses, beams), wanted, rtol=1e-6)


def test_a_field_four_times_finer_is_interpolated_between_the_same_centres():
    field = distance_field(cluttered(12, share=0.02), 1.5)
    fine, factor = field.finer()
    assert factor == 4
    rows, cols = fine.shape
    inner = [(r, c) for r in range(4, rows - 4, 7) for c in range(4, cols - 4, 5)]
    for r, c in inner:
        at = field.T_map_corner @ (np.array([c + 0.5, r + 0.5]) / 4 * field.resolution)
        assert fine[r, c] == pytest.approx(float(sampled(field, at)), abs=1e-5)
    assert sampled(field, field.T_map_corner @ np.array([-1.0, -1.0])) == 1.5


def test_poses_are_drawn_from_the_free_cells_alone_and_from_all_of_each():
    cells = np.full((6, 9), UNKNOWN, dtype=np.int8)
    cells[2, 3], cells[4, 7], cells[1, 1] = FREE, FREE, OCCUPIED
    grid = OccupancyGrid(cells, 0.5, SE2.from_xyt(1.0, -2.0, 0.6))
    poses = search.GlobalSearch(grid, distance_field(grid, 1.0), AmclConfig(), 3.0).uniform(
        4000, np.random.default_rng(13)
    )
    inside = (grid.T_map_grid.inverse() @ poses[:, :2]) / 0.5
    corner = np.floor(inside).astype(int)
    assert set(map(tuple, corner.tolist())) == {(3, 2), (7, 4)}
    within = inside - corner
    assert within.min() < 0.01
    assert within.max() > 0.99
    assert np.abs(within.mean(axis=0) - 0.5).max() < 0.02
    assert abs(np.mean(corner[:, 0] == 3) - 0.5) < 0.05
    assert (poses[:, 2].min(), poses[:, 2].max()) == pytest.approx((-math.pi, math.pi), abs=0.01)


def test_climbing_ends_on_the_top_of_a_hill_in_ever_finer_steps():
    top = np.array([0.31, -0.17, 0.22])
    calls = []

    def height(poses):
        calls.append(len(poses))
        return -np.abs(poses - top).sum(axis=1)

    best, pose = climb(height, np.zeros(3))
    assert np.all(np.abs(pose - top) < [0.011, 0.011, 0.007])
    assert best == pytest.approx(float(height(pose[None])[0]))
    assert set(calls[1:-1]) == {27}
    assert np.abs(NEIGHBOURS).sum() == 54
    # on flat ground it stays where it is
    assert climb(lambda poses: np.zeros(len(poses)), top) == (0.0, pytest.approx(top))
