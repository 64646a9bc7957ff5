"""Wheel calibration by scans and by a gyro, by formulas."""

import math

import numpy as np
import pytest

from tests.helpers.slam_rooms import random_poses
from turtlebag.datasets.se2 import SE2, wrap
from turtlebag.datasets.types import ImuLog
from turtlebag.pipeline.slam.graph.pose_graph import chain
from turtlebag.pipeline.slam.odometry import calibration as calib
from turtlebag.pipeline.slam.odometry.calibration import Calibration
from turtlebag.pipeline.slam.sensors import gyro_slip as gyros


def test_baselines_pairs_and_chains_are_sums_along_the_way():
    rng = np.random.default_rng(6)
    steps = np.column_stack([rng.normal(0.3, 0.1, 40), rng.normal(0.0, 0.05, 40), rng.normal(0.0, 0.3, 40)])
    parts = np.hypot(steps[:, 0], steps[:, 1]) / 1.5 + np.abs(steps[:, 2])
    np.testing.assert_allclose(calib.baselines(steps), parts)
    expected = []
    for i in range(41):
        ends = [j for j in range(i, 41) if parts[i:j].sum() >= 1.0]
        if ends:
            expected.append((i, ends[0]))
    pairs = calib.baseline_pairs(steps)
    assert [tuple(p) for p in pairs] == expected
    chained = chain(steps, pairs)
    for (i, j), found in zip(pairs, chained, strict=True):
        T = SE2.identity()
        for step in steps[i:j]:
            T = T @ SE2(step)
        np.testing.assert_allclose(SE2(found).xyt, T.xyt, atol=1e-9)
    np.testing.assert_allclose(
        Calibration(1.1, 0.9, 0.02, np.array([0.01, 0.02, 0.03])).information(steps)[3],
        np.diag((np.array([0.01, 0.02, 0.03]) * math.sqrt(parts[3]) + 0.3 * calib.LEAST_NOISE) ** -2.0),
    )


def test_shares_are_found_from_matches_and_lies_outvoted():
    rng = np.random.default_rng(7)
    true = np.column_stack([rng.uniform(0.1, 0.4, 200), np.zeros(200), rng.normal(0.0, 0.25, 200)])
    wanted = Calibration(1.03, 0.96, 0.01)
    told = true.copy()
    told[:, 0] = true[:, 0] / 1.03
    told[:, 2] = (true[:, 2] - 0.01 * told[:, 0]) / 0.96
    np.testing.assert_allclose(wanted.corrected(told), true, atol=1e-12)
    pairs = calib.baseline_pairs(told)
    matched = chain(true, pairs)
    lies = rng.random(len(pairs)) < 0.15
    matched[lies, 0] += 0.5
    matched += rng.normal(0.0, 0.002, matched.shape)
    information = np.tile(np.diag([1e5, 1e5, 2e5]), (len(pairs), 1, 1))
    found = calib.fit_shares(told, pairs, matched, information)
    assert (found.scale, found.turn_scale, found.turn_per_m) == pytest.approx((1.03, 0.96, 0.01), abs=2e-3)
    assert found.pairs == np.sum(~lies)
    assert np.all(found.noise < [0.01, 0.01, 0.006])
    jacobian = calib.shares_jacobian(told, pairs, chain(told, pairs))
    for k, moved in enumerate(np.eye(3) * 1e-3):
        end = chain(Calibration(1 + moved[0], 1 + moved[1], moved[2]).corrected(told), pairs)
        expected = (SE2(chain(told, pairs)).inverse() @ SE2(end)).xyt / 1e-3
        np.testing.assert_allclose(jacobian[:, :, k], expected, atol=0.02)


def test_information_through_noise_and_the_noise_that_is_left():
    rng = np.random.default_rng(8)
    a = rng.normal(size=(5, 3, 3))
    information = a @ np.swapaxes(a, 1, 2) * 100.0
    noise = np.array([0.1, 0.2, 0.05])
    expected = np.linalg.inv(np.linalg.inv(information) + np.diag(noise**2))
    np.testing.assert_allclose(calib.joint_information(information, noise), expected, rtol=1e-6)
    blind = calib.joint_information(np.zeros((1, 3, 3)), noise)
    np.testing.assert_array_equal(blind, np.zeros((1, 3, 3)))
    left = rng.normal(0.0, [0.2, 0.01, 0.05], (60, 3))
    sees = np.tile(np.diag([1e4, 1e-3, 1e5]), (60, 1, 1))
    found = calib.noise_left(left, sees)
    for k in (0, 2):
        measured = 1.4826 * np.median(np.abs(left[:, k]))
        assert found[k] == pytest.approx(60 / 90 * measured + 30 / 90 * calib.USUAL_NOISE[k])
    assert found[1] == calib.USUAL_NOISE[1]
    # a bend: how far it went on is known only as well as how far it turned
    across, bend = np.diag([0.0, 1e4, 0.0]), np.array([-0.1, 0.0, 1.0])
    found = calib.noise_left(left, np.tile(across + 1e5 * np.outer(bend, bend), (60, 1, 1)))
    assert found[0] == calib.USUAL_NOISE[0]
    assert found[2] == calib.USUAL_NOISE[2]
    tiny = calib.noise_left(np.zeros((10**4, 3)), np.tile(1e9 * np.eye(3), (10**4, 1, 1)))
    np.testing.assert_array_equal(tiny, calib.LEAST_NOISE)


def test_the_gyros_turns_are_its_rate_between_stamps_where_it_has_no_hole():
    stamps = np.concatenate([np.arange(0, 100), np.arange(125, 200)]) * 10_000_000
    t = stamps * 1e-9
    rate = np.column_stack([0 * t, 0 * t, 0.3 + 0.5 * t])
    rate[7, 2] = np.nan
    mixed = np.random.default_rng(9).permutation(len(stamps))
    gyro = gyros.GyroTurns(ImuLog(stamps[mixed], rate[mixed], 0 * rate))
    asked = np.array([-5, 0, 3, 41, 98, 110, 126, 150, 199, 205]) * 10_000_000 + np.array(
        [0, 0, 5, 3, 0, 0, 0, 1, 0, 0]
    )
    turns, known = gyro.turns(asked)
    at = asked * 1e-9
    expected = np.diff(0.3 * at + 0.25 * at**2)
    assert known.tolist() == [False, True, True, True, False, False, True, True, False]
    np.testing.assert_allclose(turns[known], expected[known], atol=1e-4)
    assert gyro.turns(np.array([3, 3, 2]) * 10_000_000)[1].tolist() == [False, False]
    nothing = gyros.GyroTurns(ImuLog(stamps[:1], rate[:1], rate[:1])).turns(asked)
    assert not nothing[1].any()


def test_bias_and_shares_between_gyro_and_wheels_are_found_robustly():
    rng = np.random.default_rng(10)
    steps = np.column_stack(
        [rng.uniform(0.0, 0.3, 150), 0.02 * rng.normal(size=150), rng.normal(0.0, 0.2, 150)]
    )
    waits = rng.uniform(0.1, 0.3, 150)
    way = np.hypot(steps[:, 0], steps[:, 1])
    # turns of the gyro that differ from the wheels' by bias, share and metre
    turns = (steps[:, 2] + 0.004 * waits + 0.006 * way) / (1.0 - 0.03)
    steps[::10, 2] += 1.0
    found = gyros.gyro_errors(turns, steps, waits)
    assert found == pytest.approx([0.004, 0.03, 0.006], abs=6e-3)
    np.testing.assert_allclose(gyros.error_parts(turns, steps, waits), np.column_stack([waits, turns, way]))


def test_odometry_is_bent_by_other_turns_on_arcs_of_the_same_length():
    poses = SE2(random_poses(12, 11))
    steps = poses.steps()
    same = gyros.with_turns(poses, steps, steps[:, 2])
    np.testing.assert_allclose(same.xy, poses.xy, atol=1e-9)
    np.testing.assert_allclose(wrap(same.yaw - poses.yaw), 0.0, atol=1e-9)
    turns = steps[:, 2] + np.random.default_rng(12).normal(0.0, 0.3, 11)
    bent = gyros.with_turns(poses, steps, turns)
    found = bent.steps()
    np.testing.assert_allclose(np.hypot(*found[:, :2].T), np.hypot(*steps[:, :2].T))
    np.testing.assert_allclose(wrap(found[:, 2] - turns), 0.0, atol=1e-9)
    bearing = np.arctan2(found[:, 1], found[:, 0]) - np.arctan2(steps[:, 1], steps[:, 0])
    np.testing.assert_allclose(wrap(bearing - 0.5 * (turns - steps[:, 2])), 0.0, atol=1e-9)
