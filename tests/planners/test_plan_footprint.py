"""The footprint's compiled checks beside plain NumPy on random floors, and at their borders."""

import math

import numpy as np
import pytest
from scipy.ndimage import map_coordinates
from scipy.spatial import ConvexHull

from turtlebag.datasets.se2 import SE2
from turtlebag.datasets.types import RobotModel
from turtlebag.planners.costmap import clearance_field
from turtlebag.planners.footprint import (
    FootprintSamples,
    disc_segment_free,
    field_at,
    footprint_clearance,
    footprint_free,
    in_polygon,
    inner_points,
    path_clearance,
    sample_footprint,
)

RES = 0.05
KITE = np.array([[-0.21, -0.06], [0.02, -0.15], [0.11, -0.02], [0.03, 0.09], [-0.1, 0.12]])
"""Neither as long as wide, nor the same to both sides, nor the same to the front and the back."""


def floor(seed: int, rows: int = 30, cols: int = 44, share: float = 0.03):
    lethal = np.random.default_rng(seed).random((rows, cols)) < share
    return lethal, clearance_field(lethal, RES)


def plain_field(field, res, x, y):
    rows, cols = field.shape
    if not (0.0 <= x < cols * res and 0.0 <= y < rows * res):
        return 0.0
    at = [[y / res - 0.5], [x / res - 0.5]]
    return float(map_coordinates(field.astype(float), at, order=1, mode="nearest")[0])


@pytest.mark.parametrize("shape", [(5, 7), (1, 6), (6, 1), (1, 1), (2, 2)])
def test_the_field_at_a_point_is_the_bilinear_value_on_grids_of_all_shapes(shape):
    rng = np.random.default_rng(1)
    field = rng.uniform(0.1, 2.0, shape).astype(np.float32)
    rows, cols = shape
    xs = [*rng.uniform(-0.3 * RES, (cols + 0.3) * RES, 40), 0.0, cols * RES, 0.5 * RES, (cols - 0.5) * RES]
    ys = [*rng.uniform(-0.3 * RES, (rows + 0.3) * RES, 40), 0.0, rows * RES, 0.5 * RES, (rows - 0.5) * RES]
    for x in xs[-8:]:
        for y in ys:
            assert field_at(field, RES, x, y) == pytest.approx(plain_field(field, RES, x, y), abs=1e-6)
    for y in ys[-8:]:
        for x in xs:
            assert field_at(field, RES, x, y) == pytest.approx(plain_field(field, RES, x, y), abs=1e-6)


def plain_clearance(field, points, inscribed, pose):
    center = plain_field(field, RES, pose[0], pose[1])
    at = SE2(np.asarray(pose)) @ points
    return min(center - inscribed, *(plain_field(field, RES, x, y) for x, y in at))


def test_the_footprints_clearance_is_the_least_over_its_points_and_its_inner_disc():
    _, field = floor(3, share=0.01)
    rng = np.random.default_rng(4)
    poses = np.column_stack([rng.uniform(0.0, 2.2, 200), rng.uniform(0.0, 1.5, 200), rng.uniform(-4, 4, 200)])
    touching = 0
    for pose in poses:
        expected = plain_clearance(field, KITE, 0.09, pose)
        found = footprint_clearance(field, RES, FootprintSamples(KITE, 0.09, 0.22, len(KITE)), *pose)
        if expected <= 0.0:
            touching += 1
            assert found <= 0.0
        else:
            assert found == pytest.approx(expected, abs=1e-6)
    assert 10 < touching < 190


def test_far_from_everything_the_clearance_is_that_of_the_circle_round_the_footprint():
    field = np.full((40, 40), 0.8, dtype=np.float32)
    for circumscribed, expected in ((0.2, 0.6), (0.29, 0.51), (0.31, 0.7)):
        found = footprint_clearance(
            field, RES, FootprintSamples(KITE, 0.1, circumscribed, len(KITE)), 1.0, 1.0, 0.3
        )
        assert found == pytest.approx(expected, abs=1e-6)
    # the inner disc reaches further than any point here
    assert footprint_clearance(
        field, RES, FootprintSamples(KITE[:0], 0.35, 0.4, 0), 1.0, 1.0, 0.0
    ) == pytest.approx(0.45)


@pytest.mark.parametrize("corners", [KITE, 1.4 * KITE[::-1, ::-1]])
def test_a_polygon_with_five_corners_stands_free_when_no_lethal_centre_lies_in_it(corners):
    lethal, field = floor(5)
    rng = np.random.default_rng(6)
    hull = ConvexHull(corners).equations
    centres = (np.argwhere(lethal)[:, ::-1] + 0.5) * RES
    free = 0
    for x, y, yaw in np.column_stack(
        [rng.uniform(0, 2.2, 900), rng.uniform(0, 1.5, 900), rng.uniform(-4, 4, 900)]
    ):
        pose = SE2.from_xyt(x, y, yaw)
        outline = pose @ corners
        size = np.array(lethal.shape[::-1]) * RES
        off = np.any(outline < 0.0) or np.any(outline >= size)
        hit = np.any(np.all((pose.inverse() @ centres) @ hull[:, :2].T + hull[:, 2] <= 0.0, axis=1))
        expected = not off and not hit
        free += expected
        assert footprint_free(field, RES, corners, x, y, yaw) == expected
    assert 50 < free < 800


def test_a_lethal_centre_on_the_outline_blocks_and_one_beyond_it_does_not():
    """In units that rounding does not touch: cells of 1 m, a footprint of 2 x 2 m or a little less."""
    lethal = np.zeros((9, 9), dtype=bool)
    lethal[4, 6] = True
    square = np.array([[-1.0, -1.0], [1.0, -1.0], [1.0, 1.0], [-1.0, 1.0]])
    field = clearance_field(lethal, 1.0)
    for x, y in ((5.5, 4.5), (7.5, 4.5), (6.5, 3.5), (6.5, 5.5), (5.5, 3.5), (7.5, 5.5)):
        assert not footprint_free(field, 1.0, square, x, y, 0.0)
        assert footprint_free(field, 1.0, 0.99 * square, x, y, 0.0)
    for x, y in ((4.5, 4.5), (6.5, 2.5), (6.5, 6.5), (4.0, 2.0)):
        assert footprint_free(field, 1.0, square, x, y, 0.0)


def test_the_footprint_may_touch_the_first_border_of_the_grid_and_not_the_last():
    field = clearance_field(np.zeros((6, 8), dtype=bool), 1.0)
    square = np.array([[-1.0, -1.0], [1.0, -1.0], [1.0, 1.0], [-1.0, 1.0]])
    for x, y, fits in (
        (1.0, 3.0, True), (0.9, 3.0, False), (3.0, 1.0, True), (3.0, 0.9, False),
        (7.0, 3.0, False), (6.9, 3.0, True), (3.0, 5.0, False), (3.0, 4.9, True),
        (-0.5, 3.0, False), (8.5, 3.0, False), (3.0, -0.5, False), (3.0, 6.5, False),
    ):  # fmt: skip
        assert footprint_free(field, 1.0, square, x, y, 0.0) == fits


@pytest.mark.parametrize("seed", range(3))
def test_inside_a_convex_polygon_is_behind_all_its_edges(seed):
    rng = np.random.default_rng(seed)
    points = rng.normal(size=(12, 2))
    hull = ConvexHull(points)
    corners = points[hull.vertices]
    for x, y in rng.normal(size=(200, 2)):
        expected = bool(np.all(hull.equations[:, :2] @ [x, y] + hull.equations[:, 2] <= 0.0))
        assert in_polygon(corners, x, y) == expected
    square = np.array([[0.0, 0.0], [2.0, 0.0], [2.0, 1.0], [0.0, 1.0]])
    for x, y in ((0.0, 0.0), (1.0, 0.0), (2.0, 0.5), (1.0, 1.0), (0.0, 0.5)):
        assert in_polygon(square, x, y)


def test_outline_points_are_as_near_as_asked_and_the_inner_ones_lie_inside():
    model = RobotModel("kite", KITE, 0.3, 1.0, 1.0, 1.0)
    samples = sample_footprint(model, 0.03)
    assert samples.inscribed == model.inscribed_radius
    assert samples.circumscribed == model.circumscribed_radius
    inner = inner_points(KITE, 0.03)
    outline = samples.points[: -len(inner)]
    np.testing.assert_array_equal(samples.points[-len(inner) :], inner)
    gaps = np.linalg.norm(np.roll(outline, -1, axis=0) - outline, axis=1)
    assert gaps.min() > 0.015
    assert gaps.max() <= 0.03 + 1e-12
    assert gaps.sum() == pytest.approx(np.linalg.norm(np.roll(KITE, -1, axis=0) - KITE, axis=1).sum())
    for corner in KITE:
        assert np.linalg.norm(outline - corner, axis=1).min() < 1e-12
    hull = ConvexHull(KITE).equations
    assert np.all(inner @ hull[:, :2].T + hull[:, 2] < 0.0)
    # each covers pitch squared
    area = ConvexHull(KITE).volume
    assert len(inner) * 0.03**2 == pytest.approx(area, rel=0.1)
    np.testing.assert_allclose(np.diff(np.unique(np.round(inner[:, 0], 9))), 0.03)
    assert inner[:, 0].min() == pytest.approx(KITE[:, 0].min() + 0.015)
    assert inner[:, 1].min() == pytest.approx(KITE[:, 1].min() + 0.015)
    # one edge of less than a pitch gives its corner alone
    assert len(sample_footprint(model, 1.0).points) == len(KITE)


def test_a_discs_way_is_free_or_not_where_samples_of_it_leave_no_doubt():
    _, field = floor(7, share=0.012)
    rng = np.random.default_rng(8)
    told = {True: 0, False: 0}
    for x0, y0, x1, y1 in rng.uniform(0.1, [2.1, 1.4, 2.1, 1.4], (400, 4)):
        f = np.linspace(0.0, 1.0, 300)
        least = min(plain_field(field, RES, x0 + t * (x1 - x0), y0 + t * (y1 - y0)) for t in f[::6])
        found = disc_segment_free(field, RES, 0.1, x0, y0, x1, y1)
        if least > 0.1 + 0.02 or least < 0.1 - 0.02:
            assert found == (least > 0.1)
            told[found] += 1
    assert min(told.values()) > 60


def test_a_discs_way_counts_its_ends_and_a_clearance_of_just_the_radius_is_too_little():
    field = np.full((10, 40), 0.3, dtype=np.float32)
    assert disc_segment_free(field, RES, 0.29, 0.2, 0.25, 1.8, 0.25)
    assert not disc_segment_free(field, RES, float(np.float32(0.3)), 0.2, 0.25, 1.8, 0.25)
    assert disc_segment_free(field, RES, 0.29, 0.2, 0.25, 0.2, 0.25)
    assert not disc_segment_free(field, RES, 0.31, 0.2, 0.25, 0.2, 0.25)
    for blocked, ends in ((2, (0.125, 1.5)), (30, (0.3, 1.525))):
        holed = field.copy()
        holed[:, blocked] = 0.0
        a, b = ends
        assert not disc_segment_free(holed, RES, 0.1, a, 0.25, b, 0.25)
        assert not disc_segment_free(holed, RES, 0.1, b, 0.25, a, 0.25)
    # across a low place of one cell, on steps of half a cell
    dip = np.full((40, 40), 0.11, dtype=np.float32)
    dip[20, 20] = 0.05
    assert not disc_segment_free(dip, RES, 0.1, 0.8, 1.025, 1.3, 1.025)
    assert disc_segment_free(dip, RES, 0.1, 0.8, 1.1, 1.3, 1.1)


def test_a_paths_clearance_is_the_least_over_its_poses_from_the_nearest_one_on():
    _, field = floor(9, share=0.006)
    rng = np.random.default_rng(10)
    for _ in range(40):
        steps = rng.normal(0.0, 0.08, (25, 2)).cumsum(axis=0) + rng.uniform([0.5, 0.4], [1.7, 1.1])
        poses = np.column_stack([steps, rng.uniform(-3.0, 3.0, 25)])
        x, y = steps[rng.integers(25)] + rng.normal(0.0, 0.02, 2)
        ahead = rng.uniform(0.05, 1.5)
        first = int(np.argmin(np.hypot(steps[:, 0] - x, steps[:, 1] - y)))
        driven = np.concatenate([[0.0], np.linalg.norm(np.diff(steps[first:], axis=0), axis=1).cumsum()])
        seen = [plain_clearance(field, KITE, 0.09, pose) for pose in poses[first:][driven <= ahead][1:]]
        expected = min(seen, default=np.inf)
        found = path_clearance(field, RES, FootprintSamples(KITE, 0.09, 0.22, len(KITE)), poses, x, y, ahead)
        if expected > 0.0:
            assert found == pytest.approx(expected, abs=1e-6)
        else:
            assert found <= 0.0


def test_of_two_poses_as_near_the_clearance_counts_from_the_first():
    field = np.full((20, 40), 0.5, dtype=np.float32)
    field[:, 20:] = 0.3
    poses = np.array([[0.5, 0.5, 0.0], [1.5, 0.5, 0.0], [0.5, 0.5, 0.0]])
    assert path_clearance(
        field, RES, FootprintSamples(KITE, 0.1, 0.2, len(KITE)), poses, 0.5, 0.5, 9.0
    ) == pytest.approx(0.2)
    assert math.isinf(
        path_clearance(field, RES, FootprintSamples(KITE, 0.1, 0.2, len(KITE)), poses, 0.5, 0.5, 0.9)
    )
