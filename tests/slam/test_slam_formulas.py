"""Joined sessions, interpolated scan poses, pairs, residuals and the self-check, by formulas."""

import itertools
from types import SimpleNamespace

import numpy as np
import pytest

from tests.helpers.made_drives import Drive, FloorPlan, Sensor, make_log
from tests.helpers.slam_rooms import ROOM, around_the_room, random_poses, recording
from turtlebag.datasets import se3
from turtlebag.datasets.se2 import SE2, between, wrap
from turtlebag.datasets.types import LidarSpec
from turtlebag.pipeline.slam.check.verdict import contradicted_keys, hypothesis_shares, revisits_of
from turtlebag.pipeline.slam.explain import candidate
from turtlebag.pipeline.slam.graph.constraints import Constraint, Kind, Loop
from turtlebag.pipeline.slam.graph.cost import mahalanobis
from turtlebag.pipeline.slam.graph.partners import RADIUS_M, overlapping_pairs, partner_radius
from turtlebag.pipeline.slam.graph.pose_graph import carried_poses, optimise, write_g2o
from turtlebag.pipeline.slam.graph.refinement import RefineConfig, refine
from turtlebag.pipeline.slam.odometry.calibration import Calibration
from turtlebag.pipeline.slam.odometry.track import HYPOTHESES, Track
from turtlebag.pipeline.slam.scans.clouds import make_clouds
from turtlebag.pipeline.slam.sessions import border_constraint, joined_clouds, joined_track


def place(i, j, T_j_i, overlap=0.8):
    return Loop(i, j, np.asarray(T_j_i, dtype=float), 0.5, overlap, 0.01, np.eye(3))


def track(n, keys, seed, odometry=True):
    rng = np.random.default_rng(seed)
    steps = rng.normal(size=(len(keys) - 1, 3)) if odometry else None
    return Track(
        SE2(random_poses(n, seed)), np.array(keys), rng.random(n), rng.random(n), rng.random((n, 3, 3)),
        rng.integers(0, 4, n).astype(np.int8), steps, Calibration(), rng.random(n) < 0.8,
    )  # fmt: skip


def test_a_track_is_appended_where_it_lies_and_its_scans_are_numbered_on():
    a, b, T = track(6, [0, 2, 5], 1), track(5, [0, 3], 2), SE2.from_xyt(4.0, 1.0, 0.7)
    both = joined_track(a, b, T)
    np.testing.assert_allclose(both.T_track_base.xyt[6:], (T @ b.T_track_base).xyt)
    np.testing.assert_allclose(both.T_track_base.xyt[:6], a.T_track_base.xyt)
    assert both.keys.tolist() == [0, 2, 5, 6, 9]
    border = (a.T_track_base[5].inverse() @ (T @ b.T_track_base[0])).xyt
    np.testing.assert_allclose(both.odometry_steps, [*a.odometry_steps, border, *b.odometry_steps])
    for name in ("overlap", "rmse", "information", "source", "usable"):
        np.testing.assert_array_equal(
            getattr(both, name), np.concatenate([getattr(a, name), getattr(b, name)])
        )
    assert joined_track(a, track(5, [0, 3], 2, odometry=False), T).odometry_steps is None
    T_map_keys, T_map_b = SE2(random_poses(3, 3)), SE2.from_xyt(1.0, 2.0, 3.0)
    border = border_constraint(a, T_map_keys, T_map_b, b)
    assert (border.i, border.j, border.kind) == (2, 3, Kind.BORDER)
    np.testing.assert_allclose(border.T_i_j, (T_map_keys[2].inverse() @ T_map_b @ b.T_track_base[0]).xyt)
    np.testing.assert_array_equal(border.information, np.diag([25.0, 25.0, 100.0]))


def test_joined_clouds_point_at_their_own_rows():
    logs = [recording(ROOM, around_the_room(40)[s]) for s in (slice(0, 2), slice(5, 8), slice(9, 10))]
    clouds = [make_clouds(log, 30.0) for log in logs]
    both = joined_clouds(clouds)
    scan = 0
    for cloud in clouds:
        for k in range(len(cloud.starts) - 1):
            rows, own = slice(*both.starts[scan : scan + 2]), slice(*cloud.starts[k : k + 2])
            for name in ("points", "normals", "centers", "line_ok", "point_var", "normal_var"):
                np.testing.assert_array_equal(getattr(both, name)[rows], getattr(cloud, name)[own])
            np.testing.assert_array_equal(both.table[scan] >= 0, cloud.table[k] >= 0)
            seen = cloud.table[k] >= 0
            np.testing.assert_array_equal(
                both.points[both.table[scan][seen]], cloud.points[cloud.table[k][seen]]
            )
            scan += 1
    assert scan == len(both.starts) - 1 == len(both.table)


def test_scans_are_carried_by_the_keys_before_and_after_and_across_a_gap_by_one():
    told = track(11, [0, 4, 10], 4)
    T_map_keys = SE2(random_poses(3, 5))
    before = [0, 0, 0, 0, 1, 1, 1, 1, 1, 1, 2]
    for gaps, shares in (
        (np.zeros((0, 2), dtype=int), [0, 0.25, 0.5, 0.75, 0, *[k / 6 for k in range(1, 6)], 0]),
        (np.array([[6, 8]]), [0, 0.25, 0.5, 0.75, 0, 0, 0, 0.5, 1, 1, 0]),
    ):
        found = carried_poses(told.T_track_base, told.keys, T_map_keys, gaps)
        for k in range(11):
            carried = [
                T_map_keys[q] @ (told.T_track_base[told.keys[q]].inverse() @ told.T_track_base[k])
                for q in (before[k], min(before[k] + 1, 2))
            ]
            expected = carried[0].interpolate(carried[1], shares[k])
            np.testing.assert_allclose(found.xyt[k, :2], expected.xy, atol=1e-9)
            assert float(wrap(found.yaw[k] - expected.yaw)) == pytest.approx(0.0, abs=1e-9)


def test_partners_are_the_nearest_by_way_and_turn_no_two_alike():
    poses = SE2(random_poses(40, 6, std=1.5))
    found = {tuple(p) for p in overlapping_pairs(poses, 2.0, 4).tolist()}
    expected = {(k, k + 1) for k in range(39)} | {(k, k + 2) for k in range(38)}
    ahead = np.column_stack([np.cos(poses.yaw), np.sin(poses.yaw)])
    for i in range(40):
        far = np.linalg.norm(np.hstack([poses.xy - poses.xy[i], 0.5 * (ahead - ahead[i])]), axis=1)
        taken = []
        for k in np.argsort(far):
            if k != i and far[k] < 2.0 and len(taken) < 4 and all(abs(k - t) > 2 for t in taken):
                taken.append(k)
        expected |= {(min(i, k), max(i, k)) for k in taken}
    assert found == expected


def test_passes_farther_apart_than_four_metres_are_laid_together_where_the_lidar_sees_so_far():
    rng, plan = np.random.default_rng(3), FloorPlan(60.0, 60.0)
    plan.carve(0.1, 0.1, 59.9, 59.9)
    for xy in rng.uniform(12.0, 48.0, (120, 2)):
        if np.abs(xy[1] - [27.0, 33.5]).min() > 0.6:
            plan.pillar(*xy, 0.2)
    sensor = Sensor(LidarSpec(720, -np.pi, np.pi / 360.0, 0.1, 20.0), 0.5)
    legs = [
        make_log("pass", plan, np.array([(22.0, y), (38.0, y)]), sensor, drive=Drive(v=0.8))
        for y in (27.0, 33.5)
    ]
    clouds = joined_clouds([make_clouds(leg.recording, 20.0) for leg in legs])
    assert partner_radius(clouds) > 6.5
    assert partner_radius(clouds._replace(points=np.zeros((0, 2)))) == RADIUS_M
    n, truth = len(legs[0].recording), SE2(np.concatenate([leg.reference.xyt for leg in legs]))
    off = SE2(truth.xyt + np.where(np.arange(len(truth)) < n, 0.0, 0.1)[:, None] * [1.0, 0.5, 0.0])
    steps = [
        Constraint(
            k, k + 1, between(off.xyt[k], off.xyt[k + 1]), np.eye(3) * (1e4 if k + 1 != n else 1.0), Kind.STEP
        )
        for k in range(len(off) - 1)
    ]
    found, _ = refine(clouds, np.arange(len(off)), off, steps, RefineConfig())
    error = (truth[0] @ found[0].inverse() @ found).xy - truth.xy
    assert np.linalg.norm(error[n:].mean(axis=0) - error[:n].mean(axis=0)) < 0.03


def testrevisits_of_are_pairs_near_in_place_and_far_in_time():
    poses = SE2(random_poses(80, 7, std=1.0))
    expected = [
        (i, j) for i, j in itertools.combinations(range(80), 2)
        if j - i >= 30 and np.linalg.norm(poses.xy[i] - poses.xy[j]) <= 1.5
    ]  # fmt: skip
    assert [tuple(p) for p in revisits_of(poses)] == expected
    assert len(expected) > 20
    pairs, share = np.array([[0, 5], [0, 6], [1, 5], [1, 7], [2, 7]]), np.array([0.9, 0.5, 0.1, 0.5, 0.51])
    # key 0 in both of its visits, 2 in its only one; 5 and 7 in one of two
    assert contradicted_keys(pairs, share, 0.4).tolist() == [0, 2, 6, 7]
    assert contradicted_keys(pairs, share, 0.5).tolist() == [2]
    assert contradicted_keys(np.zeros((0, 2), dtype=int), np.zeros(0), 0.5).tolist() == []


def test_how_often_each_start_of_the_front_end_won():
    source = np.array([3, 0, 1, 1, 2, 1], dtype=np.int8)
    shares = hypothesis_shares(SimpleNamespace(source=source))
    assert list(shares.values()) == [0.2, 0.6, 0.2, 0.0, 0.0][: len(HYPOTHESES)]
    assert set(hypothesis_shares(SimpleNamespace(source=source[:1])).values()) == {0.0}


def test_residuals_in_standard_deviations_and_the_graph_as_text(tmp_path):
    poses = SE2(random_poses(4, 8))
    rng, constraints, expected = np.random.default_rng(9), [], []
    for i, j in ((0, 1), (1, 2), (3, 0)):
        a = rng.normal(size=(3, 3))
        off, information = rng.normal(0.0, 0.1, 3), a @ a.T
        T = poses[i].inverse() @ poses[j] @ SE2(off).inverse()
        constraints.append(Constraint(i, j, T.xyt, information, Kind.PAIR))
        expected.append(off @ information @ off)
    np.testing.assert_allclose(mahalanobis(poses, constraints), expected, rtol=1e-6)
    assert mahalanobis(poses, []).shape == (0,)
    write_g2o(tmp_path / "a.g2o", poses, constraints)
    words = [line.split() for line in (tmp_path / "a.g2o").read_text().splitlines()]
    for k in range(4):
        assert words[k][:2] == ["VERTEX_SE2", str(k)]
        np.testing.assert_allclose(np.array(words[k][2:], dtype=float), poses.xyt[k], atol=1e-9)
    for line, c in zip(words[4:], constraints, strict=True):
        assert line[:3] == ["EDGE_SE2", str(c.i), str(c.j)]
        wanted = [*c.T_i_j, *c.information[np.triu_indices(3)]]
        np.testing.assert_allclose(np.array(line[3:], dtype=float), wanted, rtol=1e-7)
    exact = [
        Constraint(i, j, (poses[i].inverse() @ poses[j]).xyt, np.eye(3), Kind.STEP)
        for i, j in ((0, 1), (1, 2), (2, 3))
    ]
    start = poses.xyt.copy()
    start[1:] += rng.normal(0.0, 0.1, (3, 3))
    np.testing.assert_allclose(SE2(optimise(SE2(start), exact).xyt).xy, poses.xy, atol=1e-4)
    found = place(2, 1, (poses[1].inverse() @ poses[2] @ SE2.from_xyt(0.3, 0.4, -0.2)).xyt)
    left = candidate(found, poses)
    assert (left["residual_m"], left["residual_rad"]) == pytest.approx((0.5, 0.2))
    in_space = candidate(place(2, 1, se3.lifted(SE2(found.T_j_i))), se3.SE3(se3.lifted(poses)))
    assert (in_space["residual_m"], in_space["residual_rad"]) == pytest.approx((0.5, 0.2), rel=0.02)
