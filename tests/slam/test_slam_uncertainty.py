"""Position uncertainty of key scans: the graph's covariance against GTSAM's and against sampled maps."""

from dataclasses import replace

import gtsam
import numpy as np
import pytest

from turtlebag.datasets.se2 import SE2, wrap
from turtlebag.pipeline.slam.check.uncertainty import (
    ASKED,
    RANGE_SHARE,
    SPREAD,
    STAMP_S,
    Uncertainty,
    scan_covariances,
    shared_errors,
)
from turtlebag.pipeline.slam.graph.constraints import Constraint, Kind
from turtlebag.pipeline.slam.graph.drift import read_at
from turtlebag.pipeline.slam.graph.pose_graph import noise_model, optimise
from turtlebag.pipeline.slam.odometry.calibration import Calibration
from turtlebag.pipeline.slam.odometry.track import Track


def track_of(T, calibration):
    """Every scan a key scan that fits."""
    n = len(T)
    return Track(
        T, np.arange(n), np.ones(n), np.zeros(n), np.tile(np.eye(3), (n, 1, 1)), np.zeros(n, np.int8),
        None, calibration, np.ones(n, dtype=bool),
    )  # fmt: skip


def position_sigmas(T, constraints, covariance=None, **most):
    """With a calibration of the wheels' three shares, of so much covariance (3, 3), or without."""
    shared = ()
    if covariance is not None:
        shared = shared_errors(track_of(T, Calibration(covariance=covariance)), constraints, np.zeros(len(T)))
    return Uncertainty.of(T, constraints, shared).position_sigmas(**most)


def round_trip(n=30, radius=8.0, closed=False, sigmas=(0.02, 0.01, 0.01)):
    """Keys (n,) around a circle, steps between them, and what closes it."""
    angle = np.linspace(0.0, 2.0 * np.pi, n)
    T = SE2(np.column_stack([radius * np.cos(angle), radius * np.sin(angle), angle + 0.5 * np.pi]))
    ends = [(k, k + 1) for k in range(n - 1)] + ([(0, n - 1)] if closed else [])
    information = np.diag(np.square(sigmas) ** -1.0)
    return T, [Constraint(i, j, (T[i].inverse() @ T[j]).xyt, information, Kind.STEP) for i, j in ends]


def drawn_by_gtsam(T, constraints, rng, maps=4000):
    """Standard deviations as `position_sigmas` states them, of maps drawn from GTSAM's joint covariance."""
    graph, values = gtsam.NonlinearFactorGraph(), gtsam.Values()
    graph.add(gtsam.PriorFactorPose2(0, gtsam.Pose2(*T.xyt[0]), gtsam.noiseModel.Isotropic.Sigma(3, 1e-9)))
    for c in constraints:
        surer = replace(c, information=c.information / SPREAD[c.kind])
        graph.add(gtsam.BetweenFactorPose2(c.i, c.j, gtsam.Pose2(*c.T_i_j), noise_model(surer)))
    for k, pose in enumerate(T.xyt):
        values.insert(k, gtsam.Pose2(*pose))
    keys = list(range(len(T)))
    joint = gtsam.Marginals(graph, values).jointMarginalCovariance(keys).fullMatrix()
    own = rng.multivariate_normal(np.zeros(3 * len(T)), joint, size=maps).reshape(maps, len(T), 3)
    c, s = np.cos(T.yaw), np.sin(T.yaw)
    moved = np.stack([c * own[..., 0] - s * own[..., 1], s * own[..., 0] + c * own[..., 1]], axis=2)
    rigid = np.zeros((2 * len(T), 3))
    rigid[0::2, 0] = rigid[1::2, 1] = 1.0
    rigid[0::2, 2], rigid[1::2, 2] = -T.y, T.x
    flat = moved.reshape(maps, -1).T
    flat = flat - rigid @ np.linalg.lstsq(rigid, flat, rcond=None)[0]
    variances = [np.linalg.eigvalsh(np.cov(flat[2 * k : 2 * k + 2]))[-1] for k in range(len(T))]
    return np.sqrt(variances)


@pytest.mark.parametrize("closed", [False, True])
def test_the_deviations_are_those_of_maps_drawn_from_gtsams_covariance(closed):
    T, constraints = round_trip(closed=closed)
    asked, sigmas = position_sigmas(T, constraints)
    assert asked.tolist() == list(range(len(T)))
    assert sigmas == pytest.approx(drawn_by_gtsam(T, constraints, np.random.default_rng(1)), rel=0.06)


def test_a_closed_loop_holds_a_map_together():
    (_, open_), (_, closed) = (position_sigmas(*round_trip(closed=closed)) for closed in (False, True))
    assert closed.max() < 0.5 * open_.max()


def test_a_loop_that_its_kernel_has_given_up_holds_nothing():
    T, constraints = round_trip(closed=True)
    *steps, loop = constraints
    wrong = replace(loop, T_i_j=loop.T_i_j + np.array([30.0, 0.0, 0.0]), cauchy=1.0)
    assert position_sigmas(T, [*steps, wrong])[1] == pytest.approx(position_sigmas(T, steps)[1], rel=0.01)
    right = replace(loop, cauchy=1.0)
    assert position_sigmas(T, [*steps, right])[1] == pytest.approx(position_sigmas(T, constraints)[1])


def test_it_does_not_matter_where_the_map_lies():
    T, constraints = round_trip()
    far = SE2(T.xyt + np.array([465_000.0, 5_284_000.0, 0.0]))
    assert position_sigmas(far, constraints)[1] == pytest.approx(position_sigmas(T, constraints)[1], rel=1e-3)


def test_long_logs_are_asked_at_some_keys():
    T, constraints = round_trip(200)
    every = position_sigmas(T, constraints, most=200)
    asked, sigmas = position_sigmas(T, constraints, most=7)
    assert asked.tolist() == [0, 33, 66, 99, 132, 165, 199]
    assert sigmas.max() == pytest.approx(every[1].max(), rel=0.2)
    assert len(position_sigmas(T, constraints)[0]) == ASKED


@pytest.mark.parametrize("closed", [False, True])
def test_wheels_whose_size_is_open_leave_the_size_of_what_they_alone_measured_open(closed):
    T, constraints = round_trip(200, closed=closed, sigmas=(1e-5, 1e-5, 1e-5))
    wheels = np.diag([0.02, 1e-9, 1e-9]) ** 2
    by_wheels = [
        replace(c, kind=Kind.WHEELS) if c.kind == "step" and c.j == c.i + 1 else c for c in constraints
    ]
    # the circle of 8 m is 2 % larger or smaller
    assert position_sigmas(T, by_wheels, wheels)[1] == pytest.approx(np.full(50, 0.16), rel=0.03)
    assert position_sigmas(T, by_wheels)[1].max() < 0.01
    # and where scans measured it, it is as large as their ranges
    assert position_sigmas(T, constraints, wheels)[1] == pytest.approx(
        np.full(50, 8.0 * RANGE_SHARE), rel=0.05
    )


def test_shares_of_turn_bend_the_map_as_they_bend_the_odometry():
    T, constraints = round_trip(60, sigmas=(1e-7, 1e-7, 1e-7))
    by_wheels = [replace(c, kind=Kind.WHEELS) for c in constraints]
    sd = 1e-3 * np.array([1.0, 0.4, 0.2])
    asked, found = position_sigmas(T, by_wheels, np.diag(sd**2))
    steps, covariance = np.array([c.T_i_j for c in constraints]), np.zeros((len(T), 2, 2))
    levers = np.zeros((2 * len(T), 3))
    levers[0::2, 0] = levers[1::2, 1] = 1.0
    levers[0::2, 2], levers[1::2, 2] = -T.y, T.x
    levers = levers.reshape(-1, 2, 3)[asked].reshape(-1, 3)
    for share in np.diag(sd):
        bent = [T[0]]
        for step in Calibration(1.0 + share[0], 1.0 + share[1], share[2]).corrected(steps):
            bent.append(bent[-1] @ SE2(step))
        apart = (np.array([pose.xy for pose in bent]) - T.xy)[asked].ravel()
        apart = (apart - levers @ np.linalg.lstsq(levers, apart, rcond=None)[0]).reshape(-1, 2)
        covariance[asked] += apart[:, :, None] * apart[:, None, :]
    assert found == pytest.approx(np.sqrt(np.linalg.eigvalsh(covariance[asked])[:, -1]), rel=0.01)


def test_the_way_that_nobody_saw_before_a_log_s_end_may_be_off_by_itself():
    T, constraints = round_trip(10)
    steady = [replace(c, kind=Kind.STEADY) for c in constraints]
    unseen = np.where(np.arange(10) >= 7, 0.3, 0.0)
    [(of, errors)] = shared_errors(track_of(T, Calibration()), steady, unseen)
    assert of.tolist() == [6, 7, 8]
    for k, error in zip(of, errors, strict=True):
        # along and across, as the step's end has them; nothing turns
        along = SE2.from_xyt(0.0, 0.0, -steady[k].T_i_j[2]).matrix()[:2, :2]
        np.testing.assert_allclose(error, [*(0.3 * along), [0.0, 0.0]], atol=1e-12)


def test_one_scan_is_where_it_is():
    asked, sigmas = position_sigmas(SE2(np.zeros((1, 3))), [])
    assert asked.tolist() == [0]
    assert sigmas.tolist() == [0.0]


def test_ellipses_of_95_percent_hold_as_many_of_the_maps_that_are_drawn():
    T, constraints = round_trip(12, closed=True)
    rng, spread = np.random.default_rng(2), SPREAD[Kind.STEP]
    covariance = Uncertainty.of(T, constraints).keys()
    covariance = read_at(covariance, T.xyt - [*T.xy.mean(axis=0), 0.0])
    np.testing.assert_allclose(covariance, covariance.transpose(0, 2, 1), atol=1e-12)
    assert (np.linalg.eigvalsh(covariance[1:]) > 0.0).all()
    assert np.abs(covariance[0]).max() < 1e-9
    held = []
    for _ in range(200):
        noise = rng.standard_normal((len(constraints), 3)) * np.sqrt(spread) * [0.02, 0.01, 0.01]
        drawn = [
            replace(c, T_i_j=(SE2(c.T_i_j) @ SE2(off)).xyt) for c, off in zip(constraints, noise, strict=True)
        ]
        error = optimise(T, drawn).xyt - T.xyt
        error[:, 2] = wrap(error[:, 2])
        held.append([error[k] @ np.linalg.solve(covariance[k], error[k]) < 7.815 for k in (3, 6, 9)])
    assert ((np.mean(held, axis=0) >= 0.9) & (np.mean(held, axis=0) <= 0.99)).all()


def test_scans_between_keys_are_less_certain_than_keys_and_their_stamps_are_late_along_the_way():
    n = 21
    T = SE2.from_xyt(0.1 * np.arange(n), np.zeros(n), np.zeros(n))
    track = replace(
        track_of(T, Calibration()), keys=np.arange(0, n, 5), information=np.tile(1e6 * np.eye(3), (n, 1, 1))
    )
    T_keys = T[track.keys]
    steps = [Constraint(k, k + 1, step, 1e6 * np.eye(3), Kind.STEP) for k, step in enumerate(T_keys.steps())]
    stamps = (np.arange(n) * 2e8).astype(np.int64)
    found = scan_covariances(Uncertainty.of(T_keys, steps), track, T, stamps)
    assert found.shape == (n, 3, 3)
    assert not found[0].any()
    assert (np.linalg.eigvalsh(found[1:]) > 0.0).all()
    across = found[:, 1, 1]
    assert (across[[7, 12]] > across[[5, 10]]).all()
    late = found[:, 0, 0] - across
    np.testing.assert_allclose(late[[5, 10]], (0.5 * STAMP_S) ** 2, rtol=0.3)
