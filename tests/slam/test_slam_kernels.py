"""Compiled alignment, pairs, free-space violations, sets of places, trust in odometry, beside plain NumPy."""

import math

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from tests.helpers.slam_rooms import LDS, ROOM, recording
from turtlebag.datasets.se2 import SE2, between
from turtlebag.pipeline.slam.loops.consistency import grow_set
from turtlebag.pipeline.slam.loops.free_space import violation_shares
from turtlebag.pipeline.slam.odometry.calibration import GROSS
from turtlebag.pipeline.slam.odometry.track import OdometryNoise
from turtlebag.pipeline.slam.odometry.trust import CONTRADICTION_SIGMAS, RECENT, SEVERAL, OdometryTrust
from turtlebag.pipeline.slam.scans.align import (
    FAKED,
    NO_PRIOR,
    PRIOR_SHARE,
    SAME_PARTNERS,
    STEP_COVARIANCE_SCALE,
    SURFACE_VAR,
    Prior,
    align,
    align_kernel,
    contradiction,
    gauss_newton_step,
    observable,
    safe_solve,
    wrap_angle,
)
from turtlebag.pipeline.slam.scans.clouds import make_clouds
from turtlebag.pipeline.slam.scans.correspondences import MIN_NORMAL_DOT, SIGMAS, Limits, find_partner
from turtlebag.pipeline.slam.scans.pairs import linearise_pairs

POSES = np.array([[1.2, 1.0, 0.0], [1.8, 1.5, 1.0], [1.4, 2.0, -1.0], [5.0, 4.6, 3.0], [1.5, 1.2, 0.3]])


@pytest.fixture(scope="module")
def clouds():
    """Four key scans and a fifth, by a lidar that sits off the base's origin."""
    T_base_lidar = SE2.from_xyt(0.1, 0.03, 0.4)
    log = recording(ROOM, (SE2(POSES) @ T_base_lidar).xyt, LDS)
    return make_clouds(type(log)(log.source, log.stamps_ns, log.ranges, LDS, T_base_lidar), 30.0)


def moved_by(xyt, delta):
    return (SE2(np.asarray(xyt, dtype=float)) @ SE2(np.asarray(delta, dtype=float))).xyt


class Normals:
    """Normal equations of a right perturbation, its derivatives taken numerically."""

    def __init__(self):
        self.h, self.g, self.faked = np.zeros((3, 3)), np.zeros(3), 0.0
        self.squares = self.weights = 0.0

    def add(self, error, kernel2, normal_var, share=1.0):
        e = error(np.zeros(3))
        j = np.array([(error(d) - error(-d)) / 2e-6 for d in 1e-6 * np.eye(3)])
        w = share / kernel2 / (1.0 + e * e / kernel2) ** 2
        self.h += w * np.outer(j, j)
        self.g += w * j * e
        self.faked += float(w * (normal_var + SURFACE_VAR))
        self.squares += w * e * e
        self.weights += w
        return e


def partner(clouds, row, T_key_scan, key, gate, kernel2):
    """The row of the line of `key` that a point is matched with, its reach; None where there is none."""
    reach = max(gate, math.sqrt(kernel2))
    found = find_partner(*(SE2(T_key_scan) @ clouds.points[row]), key, clouds, reach)
    return (found if found >= 0 and clouds.line_ok[found] else None), reach


def counts(clouds, row, found, T_key_scan, reach):
    """The error of a match as a function of the perturbation; None when it does not count."""
    turned = SE2(np.array([0.0, 0.0, T_key_scan[2]])) @ clouds.normals[row]
    normal, center = clouds.normals[found], clouds.centers[found]

    def error(delta):
        return float(normal @ (SE2(moved_by(T_key_scan, delta)) @ clouds.points[row] - center))

    return error if turned @ normal >= MIN_NORMAL_DOT and abs(error(np.zeros(3))) <= reach else None


def in_view(clouds, xy, key, margin):
    """Whether two of the three beams of `key` about that bearing are there, and none ends before it."""
    offset = xy - clouds.origin[0]
    bins = clouds.table.shape[1]
    middle = int((math.atan2(offset[1], offset[0]) + math.pi) * bins / (2 * math.pi))
    rows = [clouds.table[key, b % bins] for b in (middle - 1, middle, middle + 1)]
    ranges = [np.hypot(*(clouds.points[row] - clouds.origin[0])) for row in rows if row >= 0]
    return len(ranges) >= 2 and min(ranges) >= np.hypot(*offset) - margin


def plain_align(clouds, scan, pose, keys, key_poses, limits, prior):
    """The kernel with every partner looked up anew in each round."""
    gate, sigma, iterations, most = limits
    stride = math.ceil((clouds.starts[scan + 1] - clouds.starts[scan]) / most)
    rows = [r for r in range(clouds.starts[scan], clouds.starts[scan + 1], stride) if clouds.line_ok[r]]
    for iteration in range(iterations + 1):
        normals, matched, unknown, cost = Normals(), 0, 0, 0.0
        for row in rows:
            kernel2 = max(sigma**2, SIGMAS**2 * clouds.point_var[row])
            errors, unseen = [], True
            for key, key_pose in zip(keys, key_poses, strict=True):
                T = (SE2(key_pose).inverse() @ SE2(pose)).xyt
                found, reach = partner(clouds, row, T, key, gate, kernel2)
                unseen &= found is None and not in_view(clouds, SE2(T) @ clouds.points[row], key, gate)
                error = None if found is None else counts(clouds, row, found, T, reach)
                if error is not None:
                    errors.append(abs(normals.add(error, kernel2, clouds.normal_var[found], 1.0 / len(keys))))
            matched += bool(errors)
            q = min(errors, default=np.inf) ** 2 / kernel2
            unknown += unseen
            cost += q / (1.0 + q) if errors else float(not unseen)
        if iteration < iterations:
            pose = moved_by(pose, gauss_newton_step(normals.h, normals.faked, normals.g, pose, prior))
    rms = math.sqrt(normals.squares / normals.weights) if normals.weights else 0.0
    return pose, observable(normals.h, normals.faked), matched, len(rows), unknown, rms, cost


@pytest.mark.slow
@pytest.mark.parametrize(
    ("off", "most", "gate", "sigma", "keys"),
    [
        ((0.0, 0.0, 0.0), 10**6, 0.3, 0.05, (0, 1, 2)),
        ((0.06, -0.04, 0.05), 120, 0.3, 0.05, (0, 1, 2)),
        ((-0.1, 0.12, -0.1), 90, 0.15, 0.02, (2,)),
        ((0.02, 0.01, 0.02), 72, 0.01, 0.001, (1, 0)),
        ((0.3, 0.4, 0.5), 90, 0.3, 0.2, (3, 0)),
    ],
)
def test_what_a_scan_tells_of_its_pose_is_what_the_lines_it_meets_say(clouds, off, most, gate, sigma, keys):
    pose, keys = POSES[4] + np.array(off), np.array(keys)
    args = clouds, 4, pose, keys, POSES[keys], Limits(gate, sigma, 0, most), NO_PRIOR
    found, expected = align_kernel(*args), plain_align(*args)
    np.testing.assert_allclose(found[0], pose, atol=1e-12)
    np.testing.assert_allclose(found[1], expected[1], rtol=1e-5, atol=1e-5 * np.abs(expected[1]).max())
    assert found[2:5] == expected[2:5]
    assert found[5:] == pytest.approx(expected[5:], rel=1e-6)


@pytest.mark.slow
def test_steps_follow_one_another_until_they_are_tiny(clouds):
    keys = np.array([0, 1, 2])
    prior = Prior(POSES[4] + [0.02, 0.0, 0.03], np.diag([400.0, 200.0, 900.0]), 2.0)
    limits = Limits(0.3, 0.05, most_points=180)
    pose = POSES[4] + np.array([0.09, -0.07, 0.06])
    for iterations in (1, 2, 3):
        args = clouds, 4, pose, keys, POSES[keys], limits._replace(iterations=iterations), prior
        found, expected = align_kernel(*args), plain_align(*args)
        # steps that move little keep their partners
        tolerance = 1e-6 if iterations == 1 else 2e-3
        np.testing.assert_allclose(found[0], expected[0], atol=tolerance)
    settled = align_kernel(*args[:5], limits._replace(iterations=30), prior)
    again = align_kernel(*args[:2], settled[0], *args[3:5], limits._replace(iterations=1), prior)
    np.testing.assert_allclose(again[0], settled[0], atol=SAME_PARTNERS / 10)
    turned = align_kernel(
        *args[:2],
        settled[0] + [0, 0, 2 * math.pi],
        *args[3:],
    )
    assert abs(turned[0][2]) < math.pi


@pytest.mark.slow
def test_the_outcome_is_in_shares_of_the_points_and_every_nth_of_many_is_used(clouds):
    total = int(clouds.starts[5] - clouds.starts[4])
    keys = np.array([0, 1])
    for most, stride in ((10**6, 1), (total, 1), (total - 1, 2), (total // 3, 4 if total % 3 else 3)):
        args = clouds, 4, POSES[4], keys, POSES[keys], Limits(0.3, 0.05, 2, most)
        result, raw = align(*args), align_kernel(*args, NO_PRIOR)
        assert raw[3] == np.count_nonzero(clouds.line_ok[clouds.starts[4] : clouds.starts[5] : stride])
        np.testing.assert_array_equal(result.T_map_base.xyt, raw[0])
        np.testing.assert_array_equal(result.information, raw[1])
        assert result.overlap == raw[2] / raw[3]
        known = raw[3] - raw[4]
        assert (result.known, result.rmse, result.cost) == (known / raw[3], raw[5], raw[6] / known)
        assert result.agreement == pytest.approx(raw[2] / known)
    bare = clouds._replace(line_ok=np.zeros_like(clouds.line_ok))
    blind = align(bare, 4, POSES[4], keys, POSES[keys], Limits(0.3, 0.05))
    assert (blind.overlap, blind.cost, blind.rmse, blind.agreement) == (0.0, 1.0, 0.0, 0.0)


def random_information(seed):
    a = np.random.default_rng(seed).normal(size=(6, 3))
    return a.T @ a


@pytest.mark.parametrize("seed", range(5))
def test_a_step_weighs_the_scan_against_the_prior(seed):
    rng = np.random.default_rng(seed)
    h, faked, g = 900.0 * random_information(seed), 200.0 * rng.random(), rng.normal(size=3)
    pose, prior = rng.normal(0.0, 2.0, 3), rng.normal(0.0, 2.0, 3)
    information = 500.0 * random_information(seed + 10)
    seen = observable(h, faked)
    toward = -seen @ np.linalg.solve(h, g)
    for cauchy in (0.0, 1.5):
        # the error of the pose as the prior's pose sees it, in the frame of the base
        e = (SE2(np.array([0, 0, -pose[2]])) @ (pose[:2] - prior[:2])).tolist()
        e = np.array([*e, math.remainder(pose[2] - prior[2], 2 * math.pi)])
        # both variances together, by what the points of a scan share
        d, sure = e - np.linalg.solve(h, g), seen / STEP_COVARIANCE_SCALE
        q = d @ np.linalg.solve(np.linalg.inv(information) + np.linalg.pinv(sure), d) if cauchy else 0.0
        w = PRIOR_SHARE / (1.0 + (q / cauchy**2 if cauchy else 0.0))
        expected = np.linalg.solve(seen + w * information, toward - w * information @ e)
        found = gauss_newton_step(h, faked, g, pose, Prior(prior, information, cauchy))
        np.testing.assert_allclose(found, expected, rtol=1e-3, atol=1e-6)
    alone = gauss_newton_step(h, faked, g, pose, Prior(prior, np.zeros((3, 3)), 1.5))
    np.testing.assert_allclose(seen @ alone, toward, rtol=1e-3, atol=1e-3)


@pytest.mark.slow
@pytest.mark.parametrize("seed", range(6))
def test_the_weaker_direction_loses_what_normals_fake(seed):
    h = random_information(seed) * np.array([1.0, 3.0, 0.5])[:, None] * np.array([1.0, 3.0, 0.5])
    schur = h[:2, :2] - np.outer(h[:2, 2], h[2, :2]) / h[2, 2]
    values, vectors = np.linalg.eigh(schur)
    for faked in (0.0, 0.4 * values[0], 0.9 * values[0]):
        v = np.array([*vectors[:, 0], 0.0])
        expected = h - min(FAKED * faked, values[0]) * np.outer(v, v)
        np.testing.assert_allclose(observable(h, faked), expected, atol=1e-9)
    flat = np.diag([1.0, 2.0, 0.0])
    np.testing.assert_array_equal(observable(flat, 9.0), flat)


def test_solving_damps_by_a_millionth_of_the_information():
    a, b = random_information(1), np.array([1.0, -2.0, 0.5])
    scale = 1e-9 + 1e-6 * (a[0, 0] + a[1, 1])
    damped = a + np.diag([scale, scale, 1e-9 + 1e-6 * a[2, 2] + 1e-3 * scale])
    np.testing.assert_allclose(damped @ safe_solve(a, b), b, rtol=1e-9)
    np.testing.assert_allclose(
        safe_solve(np.diag([4.0, 0.0, 2.0]), np.array([4.0, 0.0, 1.0])), [1.0, 0.0, 0.5], rtol=1e-4
    )
    for angle in (0.0, 3.0, -3.0, 4.0, 9.5, -9.5):
        assert wrap_angle(angle) == pytest.approx(Rotation.from_euler("z", angle).as_euler("xyz")[2])


def test_a_partner_is_found_all_round_and_where_the_bearing_turns_over(clouds):
    for scan in (1, 3):
        kept = clouds.table[scan][clouds.table[scan] >= 0]
        rng = np.random.default_rng(scan)
        around = np.repeat(clouds.points[kept], 2, axis=0)
        around = around + rng.normal(0.0, 0.02, around.shape)
        gaps = np.linalg.norm(clouds.points[kept] - around[:, None], axis=2)
        expected = np.where(gaps.min(axis=1) < 0.05, kept[gaps.argmin(axis=1)], -1)
        found = [find_partner(x, y, scan, clouds, 0.05) for x, y in around]
        np.testing.assert_array_equal(found, expected)


@pytest.mark.slow
@pytest.mark.parametrize(("gate", "sigma"), [(0.3, 0.06), (0.1, 0.03), (0.03, 0.01)])
def test_a_pair_is_linearised_as_both_scans_lines_say(clouds, gate, sigma):
    rng = np.random.default_rng(2)
    keys, pairs = np.array([4, 0, 2, 1]), np.array([[0, 1], [2, 0], [3, 2]])
    poses = POSES[keys] + rng.normal(0.0, [0.03, 0.03, 0.02], (4, 3))
    relative, information, overlap = linearise_pairs(clouds, keys, poses, pairs, Limits(gate, sigma))
    for k, (a, b) in enumerate(pairs):
        T = (SE2(poses[a]).inverse() @ SE2(poses[b])).xyt
        normals, shares = Normals(), []
        for scan, key, T_key_scan, inverted in (
            (keys[b], keys[a], T, False),
            (keys[a], keys[b], SE2(T).inverse().xyt, True),
        ):
            used = hit = 0
            for row in range(clouds.starts[scan], clouds.starts[scan + 1]):
                if not clouds.line_ok[row]:
                    continue
                used += 1
                kernel2 = max(sigma**2, SIGMAS**2 * clouds.point_var[row])
                found, reach = partner(clouds, row, T_key_scan, key, gate, kernel2)
                error = None if found is None else counts(clouds, row, found, T_key_scan, reach)
                if error is None:
                    continue
                hit += 1
                normal, center, point = clouds.normals[found], clouds.centers[found], clouds.points[row]

                def perturbed(delta, normal=normal, center=center, point=point, inverted=inverted, T=T):
                    moved = SE2(moved_by(T, delta))
                    return float(normal @ ((moved.inverse() if inverted else moved) @ point - center))

                normals.add(perturbed, kernel2, clouds.normal_var[found])
            shares.append(hit / used)
        step = -safe_solve(normals.h, normals.g)
        np.testing.assert_allclose(relative[k], moved_by(T, step), atol=1e-5)
        np.testing.assert_allclose(
            information[k],
            observable(normals.h, normals.faked),
            rtol=1e-4,
            atol=1e-5 * np.abs(normals.h).max(),
        )
        assert overlap[k] == max(shares)


def test_a_point_is_agreeing_near_what_the_other_saw_and_violating_where_it_saw_through(clouds):
    keys = np.array([0, 1, 2, 4])
    pairs = np.array([[0, 1], [1, 0], [2, 3], [3, 2], [1, 3]])
    wall, through, n_bins = 0.1, 0.25, clouds.table.shape[1]
    for shift in ((0.0, 0.0, 0.0), (0.3, -0.2, 0.1), (0.6, 0.5, -0.3)):
        poses = POSES[keys].copy()
        poses[1:3] += shift
        expected = []
        for a, b in pairs:
            points = (SE2(poses[b]).inverse() @ SE2(poses[a])) @ clouds.of(keys[a])
            rays = points - clouds.origin[0]
            agreeing = violating = 0
            for point, distance, bearing in zip(
                points, np.linalg.norm(rays, axis=1), np.arctan2(rays[:, 1], rays[:, 0]), strict=True
            ):
                middle = int((bearing + math.pi) / (2 * math.pi) * n_bins)
                half = min(6, int(wall / max(distance, wall) * n_bins / (2 * math.pi)) + 1)
                seen = clouds.table[keys[b]][np.arange(middle - half, middle + half + 1) % n_bins]
                seen = clouds.points[seen[seen >= 0]]
                if len(seen) and np.linalg.norm(seen - point, axis=1).min() < wall:
                    agreeing += 1
                elif (
                    len(seen) >= 3
                    and np.linalg.norm(seen - clouds.origin[0], axis=1).min() > distance + through
                ):
                    violating += 1
            expected.append(violating / (agreeing + violating) if agreeing + violating >= 20 else np.nan)
        found = violation_shares(clouds, keys, poses, pairs, wall, through)
        np.testing.assert_allclose(found, expected)
    assert np.nanmax(found) > 0.1


def grown_plainly(seed, left, agree, overlap):
    members, candidates = [seed], [k for k in left if k != seed and agree[seed, k]]
    while candidates:
        inside = {k: sum(agree[k, other] for other in candidates) for k in candidates}
        chosen = max(candidates, key=lambda k: (inside[k], overlap[k], -k))
        members.append(chosen)
        candidates = [k for k in candidates if k != chosen and agree[chosen, k]]
    return members


@pytest.mark.parametrize("seed", range(20))
def test_sets_of_places_grow_as_a_plain_search_grows_them(seed):
    rng = np.random.default_rng(seed)
    n = int(rng.integers(1, 14))
    upper = np.triu(rng.random((n, n)) < rng.random(), 1)
    agree, overlap = upper | upper.T, np.round(rng.random(n), 1)
    left = np.flatnonzero(rng.random(n) < 0.8)
    for place in left.tolist():
        assert grow_set(place, left, agree, overlap).tolist() == grown_plainly(place, left, agree, overlap)


def judged_plainly(steps, poses, seen, noise):
    """Whether the odometry is believed after each step: `OdometryTrust` by its words, on SE2 poses."""
    odometry, lies, said = [np.zeros(3)], 0, []
    for k, step in enumerate(steps):
        odometry.append(moved_by(odometry[-1], step))
        told, error = {}, {}
        for since in {max(k - RECENT, 0), max(k - 1, 0)}:
            told[since] = between(odometry[since + 1], odometry[-1])
            error[since] = between(told[since], between(poses[since], poses[k]))
        if k > 0:
            first, last = max(k - RECENT, 0), k - 1
            sigma = noise.information(told[last])[0, 0] ** -0.5
            contradicted = abs(error[last][0]) > CONTRADICTION_SIGMAS * sigma
            if np.hypot(*step[:2]) > 2.0 * noise.floor and not contradicted:
                lies = 0
            along = np.zeros((3, 3))
            along[0, 0] = noise.information(told[first])[0, 0]
            longer = max(abs(told[first][0]), abs(told[first][0] + error[first][0]))
            gross = abs(error[first][0]) > GROSS * longer
            apart = contradiction(error[first], along, seen[k]) > CONTRADICTION_SIGMAS**2
            lies += bool(contradicted and gross and apart)
        said.append(lies < SEVERAL)
    return said


@pytest.mark.parametrize("seed", range(10))
def test_odometry_is_judged_as_in_plain_numpy(seed):
    rng, noise = np.random.default_rng(seed), OdometryNoise()
    steps = np.column_stack([rng.uniform(0.0, 0.2, 60), np.zeros(60), rng.normal(0.0, 0.1, 60)])
    lies = np.repeat(rng.random(12) < 0.7, 5)
    true = np.where(lies[:, None], steps * rng.choice([0.0, -1.0, 3.0], (60, 3)), steps)
    true += rng.normal(0.0, 0.003, (60, 3))
    poses = [np.zeros(3)]
    for step in true:
        poses.append(moved_by(poses[-1], step))
    blind = rng.random(60) < 0.3
    seen = np.where(blind[:, None, None], np.diag([0.0, 1e4, 1e5]), np.diag([1e4, 1e4, 1e5]))
    trust, said = OdometryTrust(noise), []
    for step, pose, saw in zip(steps, poses[1:], seen, strict=True):
        trust.judge(step, pose, saw)
        said.append(trust.trusted)
    assert said == judged_plainly(steps, poses[1:], seen, noise)
    assert len(set(said)) == 2
