"""Disturbed logs and what stays known of them."""

import numpy as np
import pytest

from benchmarks.disturb import KINDS, MODES, disturbed, mirror, reverse
from benchmarks.known_logs import Known, known
from benchmarks.slam_logs import LIDARS
from benchmarks.slam_scores import by_relations, errors
from turtlebag.datasets.relations import Relations
from turtlebag.datasets.se2 import SE2
from turtlebag.datasets.types import ImuLog, LidarSpec, Recording, Trajectory

NOBODY = np.random.default_rng(0)
N, PERIOD = 2000, 0.2


def a_log(time_increment=0.0):
    """400 s through a wavy corridor, a relation from each 20th scan to the one 12 later."""
    rng = np.random.default_rng(3)
    t = np.round(1e9 * (100.0 + PERIOD * np.arange(N))).astype(np.int64)
    s = np.arange(N) * 0.1
    poses = SE2.from_xyt(s, np.sin(s / 5.0), np.arctan(0.2 * np.cos(s / 5.0)))
    ranges = rng.uniform(0.5, 12.0, (N, 180)).astype(np.float32)
    ranges[rng.random(ranges.shape) < 0.1] = np.inf
    lidar = LidarSpec(180, -np.pi / 2, np.pi / 180, 0.0, 80.0, time_increment, PERIOD)
    fine = np.arange(t[0], t[-1], 33_000_000)
    recording = Recording(
        "made", t, ranges, lidar, SE2(np.array([0.1, 0.02, 0.05])), poses,
        Trajectory(fine, Trajectory(t, poses).at(fine)),
        ImuLog(fine, rng.standard_normal((len(fine), 3)), rng.standard_normal((len(fine), 3))),
    )  # fmt: skip
    a = np.arange(0, N - 12, 20)
    b = a + 12
    return known(recording, poses, Relations(t[a], t[b], poses[a].inverse() @ poses[b]))


def same(a: Known, b: Known):
    """Every array of two logs and of what is known of them is equal, to rounding."""
    x, y = a.recording, b.recording
    pairs = [(x.stamps_ns, y.stamps_ns), (x.ranges, y.ranges), (x.lidar.angles, y.lidar.angles)]
    pairs += [(x.T_base_lidar.xyt, y.T_base_lidar.xyt), (x.T_odom_base.xyt, y.T_odom_base.xyt)]
    pairs += [(x.odometry.stamps_ns, y.odometry.stamps_ns), (x.odometry.poses.xyt, y.odometry.poses.xyt)]
    pairs += [(x.imu.stamps_ns, y.imu.stamps_ns), (x.imu.angular_velocity, y.imu.angular_velocity)]
    pairs += [(x.imu.linear_acceleration, y.imu.linear_acceleration), (a.reference.xyt, b.reference.xyt)]
    pairs += [
        (a.relations.stamps_a_ns, b.relations.stamps_a_ns),
        (a.relations.T_a_b.xyt, b.relations.T_a_b.xyt),
    ]
    return all(p.shape == q.shape and np.allclose(p, q, rtol=0, atol=1e-9) for p, q in pairs)


@pytest.mark.parametrize("way", [mirror, reverse])
def test_mirrored_or_reversed_twice_a_log_is_what_it_was(way):
    log = a_log()
    once = way(log, NOBODY)
    assert not same(log, once)
    assert same(log, way(once, NOBODY))


def test_reversed_stamps_rise_as_before_and_poses_come_last_first():
    log = a_log()
    back = reverse(log, NOBODY)
    assert np.array_equal(np.diff(back.recording.stamps_ns), np.diff(log.recording.stamps_ns)[::-1])
    assert np.array_equal(back.recording.T_odom_base.xyt, log.recording.T_odom_base.xyt[::-1])
    assert np.array_equal(back.recording.ranges, log.recording.ranges[::-1])


def test_a_turning_lidar_is_not_played_backwards():
    with pytest.raises(ValueError, match="backwards"):
        reverse(a_log(time_increment=1e-3), NOBODY)


def test_points_of_a_mirrored_log_are_the_mirrored_points():
    log = a_log()
    there = [
        one.recording.T_odom_base[5] @ (one.recording.T_base_lidar @ one.recording.scan(5).points_lidar())
        for one in (log, mirror(log, NOBODY))
    ]
    assert np.allclose(there[1], there[0] * [1.0, -1.0])


@pytest.mark.parametrize("mode", MODES)
def test_what_is_known_of_a_log_stays_true_in_every_mode(mode):
    log = disturbed(a_log(), mode)
    n = len(log.recording)
    assert log.recording.ranges.shape == (n, 180)
    assert len(log.recording.T_odom_base) == n == len(log.reference)
    assert len(log.which) == len(log.relations) > 0
    found = by_relations(Trajectory(log.recording.stamps_ns, log.reference), log.relations)
    assert found["relations"] == len(log.relations)
    assert found["m"] < 1e-9


def test_a_relation_goes_with_either_of_its_scans():
    log = a_log()
    lost = np.ones(N, dtype=bool)
    lost[[0, 32]] = False  # the first scan of relation 0, the second of relation 1
    assert log.with_scans(lost).which.tolist() == list(range(2, len(log.relations)))
    assert len(disturbed(log, "half").which) == len(log.relations)
    third = disturbed(log, "third")
    stamps = set(third.recording.stamps_ns.tolist())
    assert len(third.which) == sum(
        {a, b} <= stamps
        for a, b in zip(log.relations.stamps_a_ns.tolist(), log.relations.stamps_b_ns.tolist(), strict=True)
    )


def test_gaps_lie_in_turns_and_are_as_long_as_they_say():
    gaps = [np.diff(disturbed(a_log(), mode).recording.stamps_ns) for mode in ("gap3", "gap20")]
    assert [int((gap > 1.5e9 * PERIOD).sum()) for gap in gaps] == [5, 3]
    assert np.allclose([gap.max() * 1e-9 for gap in gaps], [3.2, 20.2], atol=0.25)
    log = a_log()
    turn = np.abs(log.odometry.steps()[:, 2])
    assert turn[log.around(log.places(5), 3.0)[:-1]].mean() > 1.3 * turn.mean()


def test_odometry_goes_wrong_by_as_much_as_the_mode_says():
    log = a_log()
    true = log.odometry.steps()
    assert np.allclose(disturbed(log, "bias").odometry.steps()[:, 0], 1.05 * true[:, 0], atol=1e-9)
    assert (np.abs(disturbed(log, "stuck").odometry.steps()).max(axis=1) < 1e-9).sum() == 5 * 15
    jumps = np.linalg.norm(disturbed(log, "jump").odometry.steps()[:, :2] - true[:, :2], axis=1)
    assert np.allclose(jumps[jumps > 1e-6], 2.0)
    assert (jumps > 1e-6).sum() == 3
    late = disturbed(log, "late").odometry
    assert np.allclose(late[100].xyt, Trajectory(log.recording.stamps_ns, log.odometry).at(
        log.recording.stamps_ns[[100]] - 300_000_000
    ).xyt[0], atol=1e-3)  # fmt: skip


def test_the_full_rate_odometry_goes_where_that_of_the_scans_goes():
    log = a_log()
    same_again = log.with_odometry(log.odometry)
    assert same(log, same_again)
    for mode in ("bias", "noisy", "stuck"):
        r = disturbed(log, mode).recording
        at_scans = r.odometry.at(r.stamps_ns[:-1])
        assert np.linalg.norm((at_scans.xy - r.T_odom_base.xy[:-1]), axis=1).max() < 0.03


def test_beams_are_lost_as_the_mode_says():
    log = a_log()
    before, angles = log.recording.ranges, np.degrees(log.recording.lidar.angles)
    near = disturbed(log, "range8").recording.ranges
    assert np.array_equal(near[before <= 8.0], before[before <= 8.0])
    assert np.isinf(near[before > 8.0]).all()
    view = np.isfinite(disturbed(log, "fov120").recording.ranges).any(axis=0)
    assert np.array_equal(view, np.abs(angles) <= 60.0 + 1e-6)
    finite = np.isfinite(before)
    assert np.isfinite(disturbed(log, "drop30").recording.ranges[finite]).mean() == pytest.approx(
        0.7, abs=0.01
    )
    noise = disturbed(log, "noise3").recording.ranges[finite] - before[finite]
    assert noise.std() == pytest.approx(0.03, rel=0.02)


def test_a_seed_gives_the_same_log_and_another_another():
    log = a_log()
    a, b, c = (disturbed(log, "noisy", seed) for seed in (1, 1, 2))
    assert same(a, b)
    assert not same(a, c)


def test_the_synthetic_lidars_are_what_their_names_say():
    log = a_log()
    assert LIDARS["3.5 m"](log).recording.lidar.range_max == 3.5
    assert np.isinf(LIDARS["3.5 m"](log).recording.ranges[log.recording.ranges > 3.5]).all()
    assert np.median(np.diff(LIDARS["1 Hz"](log).recording.stamps_ns)) == 1e9
    full = LIDARS["range_max"](log).recording.ranges
    assert (full == 80.0).sum() == np.isinf(log.recording.ranges).sum()


def test_errors_of_a_map_that_is_turned_or_bent_are_known():
    log = a_log()
    turned = SE2(np.array([1.0, 2.0, 0.3])) @ log.reference
    assert errors(turned, log.reference)["anchored_worst_m"] < 1e-6
    moved = log.reference.xyt.copy()
    moved[-1, 1] += 0.5
    found = errors(SE2(moved), log.reference)
    assert found["worst_m"] == pytest.approx(0.5, abs=0.01)
    assert found["anchored_worst_m"] == pytest.approx(0.5)
    moved[-1] = np.nan
    assert errors(log.reference, SE2(moved))["worst_m"] < 1e-6


@pytest.mark.parametrize("kind", KINDS)
def test_every_kind_of_the_detector_keeps_a_pose_for_each_scan(kind):
    log = a_log()
    log = KINDS[kind](log, np.random.default_rng(1))
    assert len(log.reference) == len(log.recording) == len(log.odometry)
    assert np.isfinite(log.reference.xyt).all(axis=1).mean() >= 0.89


def test_scans_of_an_upside_down_lidar_mirror_what_it_sees():
    log = a_log()
    there = [one.recording.scan(3).points_lidar() for one in (log, log.mirrored_scans())]
    assert np.allclose(there[1], there[0] * [1.0, -1.0])
