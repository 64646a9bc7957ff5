"""Surfaces, scan to map and the wall filter's algebra beside plain NumPy."""

import itertools
import math

import numpy as np
import pytest

from tests.helpers.localisation_room import l_shaped_room
from turtlebag.datasets.grid import FREE, OCCUPIED, UNKNOWN, OccupancyGrid
from turtlebag.datasets.se2 import SE2
from turtlebag.pipeline.localisation import surfaces as module
from turtlebag.pipeline.localisation import wall_filter as walls
from turtlebag.pipeline.localisation.small_matrices import multiply, solve
from turtlebag.pipeline.localisation.surfaces import (
    fit_cells,
    fit_parabola,
    fit_surfaces,
    grow_patches,
    towards_free,
)
from turtlebag.pipeline.localisation.wall_filter import (
    ODOMETRY_WALK,
    full_update,
    match_beams,
    move,
    nis,
    normal_equations,
    posterior,
)


def world(seed):
    """Occupied cells along curves, with the direction of free space at each."""
    rng = np.random.default_rng(seed)
    occupied = np.zeros((26, 33), dtype=bool)
    for _ in range(3):
        at, way, bend = rng.uniform(4.0, 22.0, 2), rng.uniform(-3.0, 3.0), rng.normal(0.0, 0.05)
        for _ in range(60):
            way += bend
            at = at + 0.5 * np.array([math.sin(way), math.cos(way)])
            if np.all(at >= 0.0) and np.all(at < occupied.shape):
                occupied[tuple(at.astype(int))] = True
    cells = np.argwhere(occupied)
    index = np.full(occupied.shape, -1, dtype=np.int32)
    index[occupied] = np.arange(len(cells))
    free = ~occupied & (np.arange(33) < 20)
    return cells, index, towards_free(free)[cells[:, 0], cells[:, 1]]


def plain_parabola(near, normal):
    """Weighted least squares by NumPy: height, slope and rms at 0."""
    across = np.array([-normal[1], normal[0]])
    u, v, w = near[:, :2] @ across, near[:, :2] @ normal, near[:, 2]
    basis = np.column_stack([np.ones_like(u), u, u * u])
    h = basis.T @ (w[:, None] * basis) + 1e-6 * np.eye(3)
    found = np.linalg.solve(h, basis.T @ (w * v))
    rest = max(0.0, w @ v**2 - found @ (basis.T @ (w * v)))
    return found[0], found[1], math.sqrt(rest / w.sum())


@pytest.mark.parametrize("seed", range(4))
def test_a_parabola_is_fitted_by_weighted_least_squares(seed):
    rng = np.random.default_rng(seed)
    near = np.column_stack([rng.integers(-3, 4, (14, 2)), rng.random(14)]).astype(float)
    normal = np.array([math.cos(seed), math.sin(seed)])
    assert fit_parabola(near, *normal) == pytest.approx(plain_parabola(near, normal), abs=1e-8)
    # of a true parabola height and slope are those of the curve, and nothing is left
    u = np.linspace(-3.0, 3.0, 9)
    v = 0.4 - 0.3 * u + 0.1 * u**2
    points = np.outer(u, [-normal[1], normal[0]]) + np.outer(v, normal)
    exact = fit_parabola(np.column_stack([points, np.ones(9)]), *normal)
    assert exact == pytest.approx((0.4, -0.3, 0.0), abs=2e-3)


@pytest.mark.parametrize("seed", range(4))
def test_each_cell_gets_the_surface_of_the_cells_about_it_that_face_as_it_does(seed):
    cells, index, towards = world(seed)
    window = 3.5
    shift, normals, rough = fit_cells(cells, index, towards, window)
    flipped = 0
    for i, cell in enumerate(cells):
        length = np.hypot(*towards[i])
        normal = towards[i] / length if length > 1e-9 else np.array([1.0, 0.0])
        off = (cells - cell)[:, ::-1]
        chosen = (np.sum(off**2, axis=1) <= window**2) & (towards @ towards[i] >= 0.0)
        flipped += np.sum((np.sum(off**2, axis=1) <= window**2) & ~chosen)
        if chosen.sum() < 4:
            np.testing.assert_allclose(normals[i], normal, atol=1e-12)
            assert math.isinf(rough[i])
            assert not shift[i].any()
            continue
        near = np.column_stack([off[chosen], np.exp(-2.0 * np.sum(off[chosen] ** 2, axis=1) / window**2)])
        for _ in range(3):
            height, slope, rest = plain_parabola(near, normal)
            normal = normal - slope * np.array([-normal[1], normal[0]])
            normal /= np.linalg.norm(normal)
        np.testing.assert_allclose(normals[i], normal, atol=1e-6)
        np.testing.assert_allclose(shift[i], height * normal, atol=1e-6)
        assert rough[i] == pytest.approx(rest, abs=1e-6)
    assert flipped > 0


@pytest.mark.parametrize(("cells_off", "own"), [(2, True), (3, False)])
def test_a_cell_is_not_moved_to_a_surface_more_than_a_cell_and_a_half_away(cells_off, own):
    cells = np.array([[1, 8], *[[1 + cells_off, col] for col in range(4, 13)]])
    index = np.full((10, 17), -1, dtype=np.int32)
    index[tuple(cells.T)] = np.arange(len(cells))
    shift, _, rough = fit_cells(cells, index, np.tile([0.0, 1.0], (len(cells), 1)), 6.0)
    assert math.isfinite(rough[0]) == own
    assert shift[0].any() == own
    assert math.isfinite(rough[5])


@pytest.mark.parametrize("seed", range(4))
def test_patches_are_what_a_plain_flood_joins(seed, monkeypatch):
    cells, index, towards = world(seed)
    shift, normals, _ = fit_cells(cells, index, towards, 3.5)
    points = cells[:, ::-1] + 0.5 + shift
    patch = grow_patches(cells, index, points, normals)
    expected, count = np.full(len(cells), -1), 0
    for seed_cell in range(len(cells)):
        if expected[seed_cell] >= 0:
            continue
        expected[seed_cell] = count
        stack = [seed_cell]
        while stack:
            i = stack.pop()
            for j in np.flatnonzero(np.abs(cells - cells[i]).max(axis=1) <= 2):
                goes_on = abs((points[j] - points[i]) @ normals[seed_cell]) < module.ROUGH_CELLS
                alike = normals[j] @ normals[seed_cell] >= module.PATCH_COSINE
                near = np.abs(cells[j] - cells[seed_cell]).max() <= module.PATCH_CELLS
                if expected[j] < 0 and alike and near and goes_on:
                    expected[j] = count
                    stack.append(j)
        count += 1
    np.testing.assert_array_equal(patch, expected)
    assert 3 < count < len(cells)


@pytest.mark.slow
def test_a_patch_is_at_most_sixty_cells_from_where_it_began():
    index = np.full((5, 150), -1, dtype=np.int32)
    index[2, :140] = np.arange(140)
    cells = np.argwhere(index >= 0)
    normals = np.tile([0.0, 1.0], (140, 1))
    patch = grow_patches(cells, index, np.ascontiguousarray(cells[:, ::-1] + 0.5), normals)
    np.testing.assert_array_equal(patch, np.repeat([0, 1, 2], [61, 61, 18]))


def test_surfaces_lie_in_a_padded_frame_and_are_known_as_far_as_they_reach():
    cells = np.full((12, 20), FREE, dtype=np.int8)
    cells[5, 3:17] = OCCUPIED
    cells[6:] = UNKNOWN
    grid = OccupancyGrid(cells, 0.1, SE2.from_xyt(1.0, 2.0, 0.5))
    made = fit_surfaces(grid)
    walls_on_map = grid.center_of(np.argwhere(cells == OCCUPIED))
    on_map = made.T_map_surfaces @ made.points
    np.testing.assert_allclose(on_map[3:-3], walls_on_map[3:-3], atol=2e-3)
    np.testing.assert_allclose(made.normals, np.tile([0.0, -1.0], (14, 1)), atol=0.15)
    assert made.patches == 1
    assert set(np.unique(made.trust)) <= {module.ROUGH_WEIGHT, 1.0}
    assert made.trust[4:-4].min() == 1.0
    margin = module.MARGIN_CELLS
    assert made.nearest.shape == (12 + 2 * margin, 20 + 2 * margin)
    for row, col in itertools.product(range(20), range(28)):
        gaps = np.hypot(row - 5 - margin, col - margin - np.arange(3, 17))
        found = made.nearest[row, col]
        assert (found >= 0) == (gaps.min() <= module.REACH_CELLS)
        assert found < 0 or gaps[found] == gaps.min()


@pytest.mark.parametrize("patch_beams", [4.0, 1e9])
def test_beams_are_summed_up_by_wall_with_numerical_derivatives(patch_beams):
    made = fit_surfaces(l_shaped_room().grid())
    rng = np.random.default_rng(3)
    offsets, scale = rng.normal(0.0, 0.01, made.patches), 0.03
    pose = (made.T_map_surfaces.inverse() @ SE2.from_xyt(1.8, 1.7, 0.4)).xyt
    angles = rng.uniform(-4.0, 4.0, 1500)
    beams = rng.uniform(0.3, 3.0, (1500, 1)) * np.column_stack([np.cos(angles), np.sin(angles)])
    sums, right = match_beams(made, pose, beams, offsets, scale, patch_beams)
    rows = []
    for beam in beams:
        x, y = SE2(pose) @ beam
        col, row = math.floor(x / made.resolution), math.floor(y / made.resolution)
        inside = 0 <= row < made.nearest.shape[0] and 0 <= col < made.nearest.shape[1]
        k = made.nearest[row, col] if inside else -1
        if k < 0 or made.normals[k] @ ([x, y] - pose[:2]) > 0.0:
            continue

        def residual(at, k=k, beam=beam):
            return made.normals[k] @ (SE2(at) @ beam - made.points[k]) - offsets[made.patch[k]]

        j = [(residual(pose + d) - residual(pose - d)) / 2e-6 for d in 1e-6 * np.eye(3)]
        r = residual(pose)
        rows.append((made.patch[k], made.trust[k] / (1.0 + (r / scale) ** 2) ** 2, np.array([*j, 1.0]), r))
    expected, wanted = np.zeros_like(sums), np.zeros_like(right)
    for patch in range(made.patches):
        mine = [row for row in rows if row[0] == patch]
        share = min(1.0, patch_beams / max(sum(w for _, w, _, _ in mine), 1e-300))
        for _, w, j, r in mine:
            outer = share * w * np.outer(j, j)
            expected[patch] += np.r_[outer[0, :3], outer[1, 1:3], outer[2, 2], outer[3]]
            wanted[patch] += share * w * r * j
    assert len(rows) > 60
    np.testing.assert_allclose(sums, expected, rtol=1e-5, atol=1e-6)
    np.testing.assert_allclose(right, wanted, rtol=1e-5, atol=1e-6)


def covariance(n, seed):
    a = np.random.default_rng(seed).normal(size=(n, n))
    return 0.01 * (a @ a.T + n * np.eye(n))


def stepped(x, motion):
    """The state after odometry's step, as the filter's own model says."""
    pose = SE2(np.array([x[0], x[1], x[2]]))
    moved = pose @ (np.array(motion[:2]) * (1.0 + x[3]))
    yaw = x[2] + (1.0 + x[4]) * motion[2] + x[5] * motion[0]
    return np.r_[moved, yaw, x[3:]]


@pytest.mark.parametrize("seed", range(4))
def test_odometry_moves_the_state_and_its_covariance_as_numerical_derivatives_say(seed):
    rng = np.random.default_rng(seed)
    n = 9
    x, P, motion = 0.3 * rng.normal(size=n), covariance(n, seed), rng.normal(0.0, 0.3, 3)
    x[2], std = 3.0 - seed, np.array([0.1, 0.2, 0.3])
    rot1, trans = float(rng.normal()), float(rng.normal())
    F = np.column_stack([(stepped(x + d, motion) - stepped(x - d, motion)) / 2e-6 for d in 1e-6 * np.eye(n)])

    def noisy(e):
        """The pose when turns and way come out otherwise."""
        turned = SE2.from_xyt(0.0, 0.0, x[2] + rot1 + e[0])
        return np.r_[turned @ np.array([trans + e[1], 0.0]), e[0] + e[2]]

    G = np.column_stack([(noisy(d) - noisy(-d)) / 2e-6 for d in 1e-6 * np.eye(3)])
    expected = F @ P @ F.T
    expected[:3, :3] += G @ np.diag(std**2) @ G.T
    expected[range(3, 6), range(3, 6)] += ODOMETRY_WALK**2 * abs(trans)
    wanted = stepped(x, motion)
    move(x, P, motion, rot1, trans, std)
    np.testing.assert_allclose(P, expected, rtol=1e-6, atol=1e-9)
    np.testing.assert_allclose(np.delete(x, 2), np.delete(wanted, 2), atol=1e-12)
    assert -math.pi <= x[2] < math.pi
    assert math.remainder(x[2] - wanted[2], 2.0 * math.pi) == pytest.approx(0.0, abs=1e-9)


def test_normal_equations_put_each_walls_sums_in_its_rows():
    rng = np.random.default_rng(4)
    seen, weight = np.array([5, 2], dtype=np.int32), 7.0
    expected, wanted, sums, right = np.zeros((5, 5)), np.zeros(5), np.zeros((8, 10)), np.zeros((8, 4))
    for place, patch in enumerate(seen):
        for _ in range(4):
            j, r, w = rng.normal(size=3), rng.normal(), rng.random()
            whole = np.zeros(5)
            whole[:3], whole[3 + place] = j, -1.0
            expected += weight * w * np.outer(whole, whole)
            wanted += weight * w * r * whole
            sums[patch] += w * np.r_[np.outer(j, j)[np.triu_indices(3)], j, 1.0]
            right[patch] += w * r * np.r_[j, 1.0]
    information, gradient = normal_equations(sums, right, seen, weight)
    np.testing.assert_allclose(information, expected)
    np.testing.assert_allclose(gradient, wanted)


@pytest.mark.parametrize("seed", range(3))
def test_a_step_and_its_covariance_are_the_kalman_filters(seed):
    """A measurement of some of the states, by the textbook's inverse of the whole covariance."""
    rng = np.random.default_rng(seed)
    n, state = 10, np.array([0, 1, 2, 6, 8])
    P, x, information = covariance(n, seed), 0.1 * rng.normal(size=n), np.linalg.inv(covariance(5, seed + 9))
    before, gradient = x[state], rng.normal(size=5)
    last = before + 0.05 * rng.normal(size=5)
    prior = P[state][:, state].copy()
    found = posterior(before, prior, last, information, gradient)
    moved = last - before
    step = np.linalg.solve(np.linalg.inv(prior) + information, information @ moved - gradient)
    np.testing.assert_allclose(found, before + step, rtol=1e-8)
    H = np.zeros((5, n))
    H[range(5), state] = 1.0
    whole = np.linalg.inv(np.linalg.inv(P) + H.T @ information @ H)
    wanted = x + whole @ (H.T @ (information @ moved - gradient))
    full_update(x, P, state, before, last, information, gradient)
    np.testing.assert_allclose(P, whole, rtol=1e-7, atol=1e-10)
    np.testing.assert_allclose(x, wanted, rtol=1e-7, atol=1e-10)
    # a heading that turned over is a small step
    over = last.copy()
    over[2] += 2.0 * math.pi
    np.testing.assert_allclose(posterior(before, prior, over, information, gradient), found, rtol=1e-8)


@pytest.mark.slow
def test_the_nis_of_a_correction_is_as_expected():
    P = covariance(3, 5)
    # As the filter hands them over: the corner of all that it knows.
    less, same = (np.pad(share * P, (0, 2))[:3, :3] for share in (0.3, 1.0))
    step = np.array([0.02, -0.03, 0.05])
    expected = step @ np.linalg.solve(P - less + walls.NO_STEP**2 * np.eye(3), step) / 3.0
    before = np.array([1.0, 2.0, 3.12])
    assert nis(before, P, before + step, less) == pytest.approx(expected)
    assert nis(before, P, before + step - [0, 0, 2 * math.pi], less) == pytest.approx(expected)
    assert nis(before, P, before + np.array([1e-4, 0, 0]), same) == pytest.approx(1.0 / 3.0)


@pytest.mark.parametrize("seed", range(5))
def test_elimination_swaps_rows_where_a_pivot_is_nought(seed):
    rng = np.random.default_rng(seed)
    n = 2 + seed
    a, b = rng.integers(-3, 4, (n, n)).astype(float), rng.normal(size=(n, 2))
    a[0, 0] = 0.0
    while abs(np.linalg.det(a)) < 0.5:
        a[1:] = rng.integers(-3, 4, (n - 1, n))
        a[0, 1:] = rng.integers(-3, 4, n - 1)
    kept = a.copy(), b.copy()
    np.testing.assert_allclose(solve(a, b), np.linalg.solve(a, b), atol=1e-9)
    np.testing.assert_array_equal(a, kept[0])
    np.testing.assert_array_equal(b, kept[1])
    np.testing.assert_allclose(
        multiply(a, rng.normal(size=(n, 3)) * 0 + b[:, :1]), a @ np.repeat(b[:, :1], 3, axis=1)
    )
    big = np.array([[1e-20, 1.0], [1.0, 1.0]])
    np.testing.assert_allclose(solve(big, np.array([[1.0], [2.0]])), [[1.0], [1.0]])
