"""Submaps compared by appearance, and which recognised places can be true together, by formulas."""

import itertools
import math

import numpy as np
import pytest

from tests.helpers.slam_rooms import ROOM, around_the_room, recording
from turtlebag.datasets.se2 import SE2
from turtlebag.pipeline.slam.graph.constraints import Loop
from turtlebag.pipeline.slam.loops import submaps
from turtlebag.pipeline.slam.loops.consistency import agreeing_sets, competing, support
from turtlebag.pipeline.slam.scans.clouds import make_clouds


@pytest.mark.parametrize("broken_at", [(), (9,), (0, 20, 38)])
def test_windows_lie_between_the_breaks_around_every_sixth_key(broken_at):
    n, broken = 40, np.zeros(39, dtype=bool)
    broken[list(broken_at)] = True
    part = np.concatenate([[0], np.cumsum(broken)])
    expected = {}
    for p in range(part[-1] + 1):
        members = np.flatnonzero(part == p)
        for middle in members[submaps.HALF_KEYS // 2 :: submaps.STRIDE]:
            expected[int(middle)] = members[np.abs(members - middle) <= submaps.HALF_KEYS].tolist()
    assert {k: v.tolist() for k, v in submaps.windows(n, broken).items()} == expected


def test_a_signature_counts_pairs_by_distance_and_angle_whatever_the_viewpoint():
    rng = np.random.default_rng(1)
    points, angle = rng.uniform(-6.0, 6.0, (150, 2)), rng.uniform(-3.0, 3.0, 150)
    normals = np.column_stack([np.cos(angle), np.sin(angle)])
    expected = np.zeros((submaps.PAIR_BINS, submaps.ANGLE_BINS))
    for i, j in itertools.combinations(range(150), 2):
        d = min(int(math.dist(points[i], points[j]) / 0.5), 23)
        turn = abs(math.remainder(angle[i] - angle[j], 2 * math.pi))
        expected[d, min(int(turn / math.pi * 6), 5)] += 1
    found = submaps.signature_of(points, normals)
    np.testing.assert_allclose(found, expected.ravel() / expected.sum(), atol=2 / expected.sum())
    T = SE2.from_xyt(3.0, -2.0, 1.0)
    turned = SE2.from_xyt(0.0, 0.0, 1.0) @ normals
    assert np.abs(submaps.signature_of(T @ points, turned) - found).sum() < 0.002
    many = submaps.signature_of(np.repeat(points, 4, axis=0), np.repeat(normals, 4, axis=0))
    np.testing.assert_allclose(many.sum(), 1.0)
    # of more points than a sample every nth is taken
    np.testing.assert_allclose(
        many, submaps.signature_of(np.repeat(points, 4, axis=0)[::3], np.repeat(normals, 4, axis=0)[::3])
    )
    assert submaps.signature_of(points[:1], normals[:1]).sum() == 0.0


def test_a_submap_is_made_of_what_its_keys_see_from_its_middle():
    poses = around_the_room(40)
    clouds, keys = make_clouds(recording(ROOM, poses), 30.0), np.arange(0, 40, 2)
    chosen = np.arange(3, 12)
    made = submaps.make_submap(clouds, keys, poses[keys], 6, chosen)
    T_middle = SE2(poses[keys[6]]).inverse()
    np.testing.assert_allclose(made.T_middle_keys, (T_middle @ SE2(poses[keys[chosen]])).xyt)
    points, ways = [], []
    for k in chosen:
        T = T_middle @ SE2(poses[keys[k]])
        rows = slice(*clouds.starts[keys[k] : keys[k] + 2])
        points.append(T @ clouds.points[rows])
        ways.append(SE2.from_xyt(0.0, 0.0, float(T.yaw)) @ clouds.normals[rows])
    points, ways = np.concatenate(points), np.concatenate(ways)
    seen = (np.linalg.norm(points, axis=1) < submaps.REACH_M) & (np.abs(ways).sum(axis=1) > 0.0)
    cells = {tuple(c) for c in np.floor(points[seen] / submaps.RESOLUTION_M).astype(int).tolist()}
    found = {tuple(c) for c in np.floor(made.points / submaps.RESOLUTION_M).astype(int).tolist()}
    assert found == cells
    assert len(made.points) == len(cells) == made.directions.sum()
    index = {tuple(np.round(p, 9)): w for p, w in zip(points[seen], ways[seen], strict=True)}
    normals = np.array([index[tuple(np.round(p, 9))] for p in made.points])
    bins = (
        np.floor((np.arctan2(normals[:, 1], normals[:, 0]) + math.pi) / (2 * math.pi) * 120).astype(int) % 120
    )
    np.testing.assert_array_equal(made.directions, np.bincount(bins, minlength=120))
    np.testing.assert_allclose(made.signature, submaps.signature_of(made.points, normals))
    assert submaps.similarity(made, [made])[0] == pytest.approx(1.0)
    assert (
        submaps.make_submap(clouds._replace(normals=0 * clouds.normals), keys, poses[keys], 6, chosen) is None
    )


def test_the_picture_of_a_submap_is_blurred_by_a_cell():
    points = np.array([[0.1, 0.1], [2.6, -1.4], [0.3, 0.1]])
    image = np.fft.irfft2(submaps.spectrum_of(points), (submaps.CELLS, submaps.CELLS))
    expected = np.zeros((submaps.CELLS, submaps.CELLS))
    for col, row in np.floor(points / 0.25).astype(int):
        for dy, dx in itertools.product((-1, 0, 1), repeat=2):
            at = (row + dy) % submaps.CELLS, (col + dx) % submaps.CELLS
            expected[at] = max(expected[at], math.exp(-0.5 * (dx * dx + dy * dy)))
    np.testing.assert_allclose(image, expected, atol=1e-5)


@pytest.mark.parametrize("off", [(1.0, -0.5, 0.6), (-2.0, 1.5, -2.4), (0.25, 0.5, 3.0)])
def test_a_submap_is_laid_on_itself_moved(off):
    poses = around_the_room(40)
    T = SE2.from_xyt(*off)
    moved = (SE2(poses) @ SE2.from_xyt(0, 0, 0)).xyt
    clouds, keys = make_clouds(recording(ROOM, moved), 30.0), np.arange(0, 40, 2)
    chosen = np.arange(2, 12)
    other = submaps.make_submap(clouds, keys, poses[keys], 6, chosen)
    shifted = poses[keys].copy()
    shifted[6] = (SE2(shifted[6]) @ T).xyt
    query = submaps.make_submap(clouds, keys, shifted, 6, np.delete(chosen, 4))
    score, pose = submaps.laid_on(query, other, {})
    assert score > 0.6
    apart = SE2(pose).inverse() @ T
    assert np.hypot(apart.x, apart.y) < 0.3
    assert abs(float(apart.yaw)) < 0.08


def place(i, j, T_j_i, overlap=0.8):
    return Loop(i, j, np.asarray(T_j_i, dtype=float), 0.5, overlap, 0.01, np.eye(3))


def test_sets_that_agree_are_taken_out_the_best_supported_first():
    found = [place(i, 0, (0, 0, 0)) for i in (1, 2, 3, 4, 4, 4, 5, 6)]
    agree = np.eye(8, dtype=bool)
    for group in ((0, 1, 2), (3, 4, 5), (2, 6)):
        agree[np.ix_(group, group)] = True
    # three submaps beat one that was recognised three times
    assert agreeing_sets(found, agree) == [[0, 1, 2], [3, 4, 5], [6], [7]]
    assert [support(found, m) for m in ([0, 1, 2], [3, 4, 5])] == [3, 1]
    comparable = np.ones((8, 8), dtype=bool)
    assert competing([0, 1], [3, 4], comparable, agree)
    assert not competing([0, 1], [3, 4], ~comparable, agree)
    half = agree.copy()
    half[0, 3] = half[0, 4] = True
    assert not competing([0, 1], [3, 4], comparable, half)
    half[0, 4] = False
    assert competing([0, 1], [3, 4], comparable, half)
