"""Straight drives, turns and tight polylines beside plain loops over poses and points."""

import itertools
import math

import numpy as np
import pytest

from turtlebag.datasets.se2 import SE2
from turtlebag.planners.costmap import clearance_field
from turtlebag.planners.footprint import disc_segment_free, field_at, footprint_free
from turtlebag.planners.footprint_motions import Ground, drives, free_from, moves, pull, turning, turns
from turtlebag.planners.grid_distance import descend, grid_distance
from turtlebag.planners.smoothing import Band, densify, path_length, relax, shortcut, with_headings

RES = 0.05
LONG = np.array([[-0.2, -0.07], [0.1, -0.07], [0.13, 0.0], [0.1, 0.07], [-0.2, 0.07]])


def floor(seed: int, share: float = 0.015, rows: int = 36, cols: int = 44):
    return clearance_field(np.random.default_rng(seed).random((rows, cols)) < share, RES)


def ground(field):
    return Ground(field, RES, LONG)


def wrapped(angle):
    return math.remainder(angle, 2.0 * math.pi)


def free_along(field, poses):
    return np.array([footprint_free(field, RES, LONG, *pose) for pose in poses])


def longest_run(mask):
    edges = np.flatnonzero(np.diff(np.concatenate([[0], mask.astype(int), [0]])))
    return int((edges[1::2] - edges[::2]).max(initial=0))


def test_a_drive_that_turns_is_free_just_when_all_poses_between_are():
    field, rng = floor(1), np.random.default_rng(2)
    told = {True: 0, False: 0}
    for _ in range(250):
        a = np.array([*rng.uniform(0.25, [1.9, 1.5]), rng.uniform(-7.0, 7.0)])
        b = np.array([*(a[:2] + rng.normal(0.0, 0.25, 2)), rng.uniform(-7.0, 7.0)])
        turn = wrapped(b[2] - a[2])
        f = np.linspace(0.0, 1.0, 161)[:, None]
        free = free_along(field, a + f * np.array([*(b[:2] - a[:2]), turn]))
        found = moves(ground(field), tuple(a), tuple(b))
        # poses are looked at every half a cell and every 0.1 rad
        steps = max(math.hypot(*(b - a)[:2]) / (0.5 * RES), abs(turn) / 0.1, 1.0)
        if free.all():
            assert found
            told[True] += 1
        elif not (free[0] and free[-1]) or longest_run(~free) > 160.0 / steps + 1:
            assert not found
            told[False] += 1
    assert min(told.values()) > 40


def test_a_drive_in_one_heading_is_a_move_without_a_turn():
    field, rng = floor(3), np.random.default_rng(4)
    told = {True: 0, False: 0}
    for a, b, yaw in zip(
        rng.uniform(0.25, 1.5, (150, 2)), rng.uniform(0.25, 1.5, (150, 2)), rng.normal(size=150), strict=True
    ):
        found = drives(ground(field), a, b, yaw)
        assert found == moves(ground(field), (*a, yaw), (*b, yaw))
        told[found] += 1
    assert min(told.values()) > 10


def test_a_turn_goes_the_shorter_way_where_it_is_free_and_else_the_longer():
    everywhere = np.full((40, 40), 0.5, dtype=np.float32)
    at = np.array([1.0, 1.0])
    for old, new in np.random.default_rng(5).uniform(-7.0, 7.0, (50, 2)):
        assert turning(ground(everywhere), at, old, new) == pytest.approx(wrapped(new - old))
    # a post 15 cm behind the robot, where its tail passes and its nose does not
    lethal = np.zeros((40, 40), dtype=bool)
    lethal[20, 16] = True
    post, here = clearance_field(lethal, RES), np.array([1.025, 1.025])
    for old, new, angle in (
        (0.6, 2.0, 1.4),
        (1.1, -1.2, -2.3 + 0.0),
        (1.1, -2.5, 2.0 * math.pi - 3.6),
        (2.5, -2.6, 2.0 * math.pi - 5.1),
    ):
        blocked = [
            not footprint_free(post, RES, LONG, *here, old + angle * f) for f in np.linspace(0, 1, 200)
        ]
        found = turning(ground(post), here, old, new)
        expected = angle - math.copysign(2.0 * math.pi, angle) if any(blocked) else angle
        assert found == pytest.approx(expected)
        assert turns(ground(post), here, old, new)


def amid_four_posts():
    """A place with a post 20 cm to each side: the robot stands there askew, and cannot turn."""
    lethal = np.zeros((40, 40), dtype=bool)
    lethal[20, 16] = lethal[20, 24] = lethal[16, 20] = lethal[24, 20] = True
    return clearance_field(lethal, RES), np.array([1.025, 1.025])


def test_no_turn_either_way_is_nan_and_any_heading_needs_none():
    cross, here = amid_four_posts()
    quarter = 0.5 * math.pi
    assert footprint_free(cross, RES, LONG, *here, 0.25 * math.pi)
    assert math.isnan(turning(ground(cross), here, 0.5 * quarter, 1.5 * quarter))
    assert not turns(ground(cross), here, 0.5 * quarter, 1.5 * quarter)
    for old, new in ((math.nan, 1.0), (1.0, math.nan)):
        assert turning(ground(cross), here, old, new) == 0.0
        assert turns(ground(cross), here, old, new)


def walk(field, seed):
    """A dense polyline over free floor for a disc of 9 cm."""
    free = field > 0.09
    rng = np.random.default_rng(seed)
    cells = np.argwhere(free)
    while True:
        start, goal = cells[rng.integers(len(cells), size=2)]
        distance = grid_distance(free, *start, np.inf)
        if 12.0 < distance[tuple(goal)] < np.inf:
            return (descend(distance, *goal)[:, ::-1] + 0.5) * RES


def line(a, b):
    return math.atan2(b[1] - a[1], b[0] - a[0])


def pulled(field, path, first, last):
    """Greedy: the farthest point to which the robot drives straight and from which it can turn on."""

    def goes_on(at, yaw):
        if at == len(path) - 1:
            return turns(ground(field), path[at], yaw, last)
        ahead = line(path[at], path[at + 1])
        return any(turns(ground(field), path[at], yaw, ahead + back) for back in (0.0, math.pi))

    corners, yaws, yaw = [0], [], first
    while corners[-1] < len(path) - 1:
        at = corners[-1]
        for target in range(len(path) - 1, at, -1):
            ways = [
                way
                for way in (line(path[at], path[target]), line(path[at], path[target]) + math.pi)
                if turns(ground(field), path[at], yaw, way)
                and drives(ground(field), path[at], path[target], way)
                and goes_on(target, way)
            ]
            if ways:
                break
        yaw = ways[0] if ways else line(path[at], path[target])
        corners.append(target)
        yaws.append(yaw)
    return path[corners], np.array(yaws)


@pytest.mark.parametrize("seed", range(12))
def test_a_path_is_pulled_to_the_longest_drives_that_can_be_turned_into(seed):
    field = floor(seed, share=0.02)
    path, rng = walk(field, seed), np.random.default_rng(seed)
    for first, last in (rng.uniform(-3.0, 3.0, 2), (math.nan, math.nan)):
        corners, yaws = pull(ground(field), path, first, last)
        expected = pulled(field, path, first, last)
        np.testing.assert_array_equal(corners, expected[0])
        np.testing.assert_allclose(yaws, expected[1], atol=1e-12)


@pytest.mark.parametrize("seed", range(8))
def test_a_path_is_free_from_the_first_pose_after_its_last_obstacle(seed):
    field, rng = floor(seed, share=0.02), np.random.default_rng(seed)
    path = walk(field, seed)[:: 4 if seed % 2 else 9]
    poses = np.column_stack([path, rng.uniform(-3.0, 3.0, len(path))])
    if seed % 3 == 0:
        poses[:-1, 2] = [line(a, b) for a, b in itertools.pairwise(path)]
        poses[len(path) // 2] = poses[len(path) // 2 - 1]
    n = len(poses)
    expected, after = n, poses[-1, 2]
    if footprint_free(field, RES, LONG, *poses[-1]):
        expected = n - 1
        while expected > 0:
            k = expected - 1
            a, b = poses[k, :2], poses[k + 1, :2]
            yaw = line(a, b) if math.hypot(*(b - a)) > 1e-6 else poses[k, 2]
            if k > 0 and math.cos(yaw - poses[k, 2]) < 0.0:
                yaw += math.pi
            if not (turns(ground(field), b, yaw, after) and drives(ground(field), a, b, yaw)):
                break
            expected, after = k, yaw
        if expected == 0 and not turns(ground(field), poses[0, :2], poses[0, 2], after):
            expected = 1
    assert free_from(ground(field), poses) == expected


def test_a_path_in_the_open_is_free_and_one_whose_goal_is_not_is_nowhere():
    field = floor(0, share=0.0)
    poses = np.array([[0.4, 0.4, 1.0], [0.8, 0.4, 0.0], [0.8, 0.4, 2.0], [1.2, 0.9, -2.0]])
    assert free_from(ground(field), poses) == 0
    assert free_from(ground(field), np.vstack([poses, [[0.05, 0.9, 0.0]]])) == 5
    # a start that has no room to turn; driven straight on it is free
    tight = np.array([[0.25, 0.1, 0.0], [0.7, 0.1, 0.0], [0.9, 0.5, 0.0]])
    assert free_from(ground(field), tight) == 2
    tight[1, :2] = (0.7, 0.5)
    assert free_from(ground(field), tight) == 1
    assert free_from(ground(field), tight[:1]) == 0
    # a start from which the first drive is free, and the turn into it is not
    cross, (x, y) = amid_four_posts()
    away = np.array([[x, y, 0.25 * math.pi], [x - 0.3, y + 0.3, 0.75 * math.pi]])
    assert free_from(ground(cross), away) == 1
    away[0, 2] = 0.75 * math.pi
    assert free_from(ground(cross), away) == 0
    # a pose said twice keeps its heading, and has no other to turn to
    moved = np.roll(cross, 5, axis=1)
    assert free_from(ground(moved), np.tile([x + 5 * RES, y, 0.25 * math.pi], (3, 1))) == 0


@pytest.mark.parametrize("seed", range(4))
def test_descending_goes_to_the_least_of_the_eight_neighbours_each_time(seed):
    rng = np.random.default_rng(seed)
    distance = grid_distance(rng.random((20, 26)) > 0.25, 5, 6, np.inf)
    distance[7, 8] = 0.3  # a dip that leads nowhere
    starts = np.argwhere(np.isfinite(distance))
    for row, col in starts[rng.integers(len(starts), size=20)]:
        expected = [(row, col)]
        while distance[expected[-1]] > 0.0:
            r, c = expected[-1]
            around = [
                (r + dr, c + dc)
                for dr, dc in ((0, 1), (0, -1), (1, 0), (-1, 0), (1, 1), (1, -1), (-1, 1), (-1, -1))
                if 0 <= r + dr < 20 and 0 <= c + dc < 26
            ]
            best = min(around, key=lambda cell: distance[cell])
            if distance[best] >= distance[r, c]:
                break
            expected.append(best)
        np.testing.assert_array_equal(descend(distance, row, col), expected)


@pytest.mark.parametrize("spacing", [0.1, 0.25, 0.07])
def test_densify_cuts_each_piece_into_the_fewest_equal_parts(spacing):
    rng = np.random.default_rng(7)
    path = np.vstack([[[0.0, 0.0], [1.0, 0.0], [1.0, 0.0], [1.0, 0.5]], rng.normal(size=(6, 2))])
    parts = [path[:1]]
    for a, b in itertools.pairwise(path):
        steps = max(1, math.ceil(math.hypot(*(b - a)) / spacing))
        parts.append(np.linspace(a, b, steps + 1)[1:])
    np.testing.assert_allclose(densify(path, spacing), np.concatenate(parts), atol=1e-12)
    assert path_length(path) == pytest.approx(sum(math.hypot(*(b - a)) for a, b in itertools.pairwise(path)))


@pytest.mark.parametrize("seed", range(6))
def test_shortcuts_are_the_longest_free_chords_from_the_front_and_then_from_the_back(seed):
    field = floor(seed, share=0.02)
    path = walk(field, seed)

    def greedy(points):
        kept, at = [points[0]], 0
        while at < len(points) - 1:
            for target in range(len(points) - 1, at, -1):
                if target == at + 1 or disc_segment_free(field, RES, 0.07, *points[at], *points[target]):
                    break
            kept.append(points[target])
            at = target
        return np.array(kept)

    expected = greedy(greedy(path)[::-1])[::-1]
    assert 2 <= len(expected) < len(path)
    np.testing.assert_array_equal(shortcut(field, RES, 0.07, path), expected)


@pytest.mark.slow
@pytest.mark.parametrize("seed", range(4))
def test_the_elastic_band_is_that_of_a_plain_loop(seed):
    field = floor(seed, share=0.01)
    path = densify(walk(field, seed)[::6].copy(), 0.06)
    radius, reach, fade, draw, push = 0.09, 0.3, 4.0, 0.4, 0.15
    expected = path.copy()

    def at(point, dx=0.0, dy=0.0):
        return field_at(field, RES, point[0] + dx, point[1] + dy)

    for _ in range(5):
        for k in range(1, len(path) - 1):
            p, d = expected[k].copy(), at(expected[k])
            move = draw * ((expected[k - 1] + expected[k + 1]) / 2.0 - p)
            gradient = np.array([at(p, RES) - at(p, -RES), at(p, 0.0, RES) - at(p, 0.0, -RES)])
            if d < reach and np.any(gradient):
                cost = (math.exp(fade * (radius - d)) - math.exp(fade * (radius - reach))) / fade
                move += push * cost * gradient / np.linalg.norm(gradient)
            if at(p + move) > min(radius, d):
                expected[k] = p + move
    found = relax(field, RES, radius, path, Band(reach, fade, draw, push, 5))
    assert np.abs(found - path).max() > 0.01
    np.testing.assert_allclose(found, expected, atol=1e-9)
    np.testing.assert_array_equal(found[[0, -1]], path[[0, -1]])


def test_the_band_does_not_move_a_point_to_the_radius_unless_that_is_an_improvement():
    field = np.tile(np.linspace(0.0, 0.4, 20, dtype=np.float32), (20, 1))
    y = np.array([0.5, 0.5, 0.5])
    for x, drawn_to, moves_on in ((0.6, 0.3, False), (0.2, 0.1, False), (0.2, 0.4, True)):
        path = np.column_stack([[drawn_to, x, drawn_to], y])
        found = relax(field, RES, 0.2, path, Band(0.0, 1.0, 0.5, 0.0, 1))
        assert (found[1, 0] != x) == moves_on


def test_headings_look_along_the_way_to_come():
    points = np.array([[0.0, 0.0], [1.0, 0.0], [1.0, 2.0], [0.0, 1.0]])
    poses = with_headings(points, 0.3, -0.4)
    np.testing.assert_allclose(poses.xy, points)
    np.testing.assert_allclose(poses.yaw, [0.3, 0.5 * math.pi, -0.75 * math.pi, -0.4])
    assert isinstance(poses, SE2)
