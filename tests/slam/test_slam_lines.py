"""Points with surface lines beside plain NumPy: growing lines, bearings, the motion during a sweep."""

import math

import numpy as np
import pytest
from scipy.special import chdtri, ndtr

from tests.helpers.slam_rooms import LDS, ROOM, recording
from turtlebag.datasets.deskew import deskewed
from turtlebag.datasets.motion import KNOTS, sweep_motion, sweep_motion_by_track
from turtlebag.datasets.se2 import SE2
from turtlebag.datasets.types import LidarSpec, Recording, Trajectory
from turtlebag.pipeline.slam.scans import clouds as module
from turtlebag.pipeline.slam.scans.clouds import (
    Clouds,
    bearing_tables,
    chi_squared_limit,
    fit_lines,
    make_clouds,
    point_information,
)
from turtlebag.pipeline.slam.scans.range_noise import LEAST_M, RangeNoise


def plain_line(points, lo, hi, i, origin, increment, range_var):
    """Normal, centroid and variances of the line grown about point i; None where there is none."""
    ray = points[i] - origin
    distance = np.linalg.norm(ray)
    ray, spacing = ray / distance, distance * increment
    reach = min(max(module.MIN_REACH_M, module.REACH_BEAMS * spacing), 2.0 * module.MAX_REACH_M)
    gap = math.hypot(
        min(max(module.MIN_GAP_M, module.GRAZING * spacing), module.MAX_REACH_M),
        module.Z_SURFACE * math.sqrt(2.0 * range_var[i]),
    )
    members, alive = [i], [True, True]
    normal, variance, turn_var = None, range_var[i], 1e9
    while any(alive):
        for side in (0, 1):
            if not alive[side]:
                continue
            last = min(members) if side == 0 else max(members)
            j = last + (2 * side - 1)
            alive[side] = False
            if not lo <= j < hi or np.linalg.norm(points[j] - points[last]) > gap:
                continue
            off = np.linalg.norm(points[j] - points[i])
            sure = turn_var < module.SURE_RAD**2
            if off > (reach if sure else max(reach, module.MAX_REACH_M)):
                continue
            tried = points[[*members, j]]
            n = len(tried)
            scatter = np.cov(tried.T, bias=True)
            values, vectors = np.linalg.eigh(scatter - range_var[i] * (n - 1) / n * np.outer(ray, ray))
            small, large = max(float(vectors[:, 0] @ scatter @ vectors[:, 0]), 0.0), values[1]
            across = float(vectors[:, 0] @ ray)
            steep = min(1.0, across**2 + range_var[i] / max(n * large, 1e-12))
            noise = range_var[i] * steep + LEAST_M**2
            if n >= 3 and n * small > noise * chi_squared_limit(n - 2):
                continue
            members.append(j)
            alive[side] = True
            normal, variance, turn_var = vectors[:, 0], noise, noise / max(n * large, 1e-12)
    if len(members) < 3 or turn_var > module.UNSURE_RAD**2:
        return None
    normal = -normal if normal @ ray > 0.0 else normal
    return normal, points[members].mean(axis=0), variance, turn_var


@pytest.mark.slow
@pytest.mark.parametrize(
    ("seed", "noise", "beams"), [(0, 0.01, 360), (1, 0.03, 360), (2, 0.002, 180), (3, 0.01, 90)]
)
def test_lines_grow_beam_by_beam_as_plain_numpy_grows_them(seed, noise, beams):
    rng = np.random.default_rng(seed)
    lidar = LidarSpec(beams, 0.0, 2.0 * math.pi / beams, 0.12, 8.0)
    log = recording(ROOM, np.array([[1.2, 1.0, 0.3], [5.0, 4.5, 2.0]]), lidar, noise=noise, seed=seed)
    log.ranges[:, rng.integers(0, beams, beams // 20)] = np.inf
    clouds = make_clouds(log, 30.0, noise=RangeNoise(noise, 0.004, 0.001))
    range_var = RangeNoise(noise, 0.004, 0.001).variance(log.ranges[np.isfinite(log.ranges)].astype(float))
    found = 0
    for scan in range(2):
        lo, hi = clouds.starts[scan : scan + 2]
        for i in range(lo, hi):
            expected = plain_line(
                clouds.points, lo, hi, i, clouds.origin[0], 2.0 * math.pi / beams, range_var
            )
            assert clouds.line_ok[i] == (expected is not None)
            if expected is None:
                assert (clouds.point_var[i], clouds.normal_var[i]) == (np.float32(range_var[i]), 0.0)
                continue
            found += 1
            np.testing.assert_allclose(clouds.normals[i], expected[0], atol=1e-6)
            np.testing.assert_allclose(clouds.centers[i], expected[1], atol=1e-9)
            assert (clouds.point_var[i], clouds.normal_var[i]) == pytest.approx(expected[2:], rel=1e-5)
    assert found > 0.5 * clouds.starts[-1]


def test_scans_do_not_grow_into_each_other_and_far_places_reach_further():
    wall = np.column_stack([np.full(9, 2.0), np.linspace(-0.08, 0.08, 9)])
    points, starts = np.vstack([wall, wall[::-1] + np.array([0.0, 0.17])]), np.array([0, 9, 18])
    shape = points.shape
    normals, centers = np.zeros(shape, np.float32), points.astype(np.float32)
    ok, point_var, normal_var = np.zeros(18, bool), np.zeros(18, np.float32), np.zeros(18, np.float32)
    fit_lines(points, starts, np.zeros(2), 0.01, (normals, centers, ok, point_var, normal_var))
    assert ok.all()
    np.testing.assert_allclose(normals, np.tile([-1.0, 0.0], (18, 1)), atol=1e-9)
    np.testing.assert_allclose(centers[[4, 13]], [[2.0, 0.0], [2.0, 0.17]], atol=1e-7)


def test_the_limit_is_that_of_chi_squared_once_in_a_thousand_times():
    for freedom, off in ((1, 0.031), (2, 0.024), (3, 0.018), (5, 0.012), (10, 0.006), (40, 0.002)):
        assert chi_squared_limit(freedom) == pytest.approx(chdtri(freedom, ndtr(-3.09)), rel=off)


def test_each_bearing_keeps_the_nearest_point_and_of_equals_the_first():
    rng = np.random.default_rng(4)
    points, starts, origin = rng.normal(size=(400, 2)), np.array([0, 150, 150, 400]), np.array([0.2, -0.1])
    points[40] = points[39]
    table = np.full((3, 24), -1, dtype=np.int32)
    bearing_tables(points, starts, origin, table)
    rays = points - origin
    bins = np.floor((np.arctan2(rays[:, 1], rays[:, 0]) + math.pi) / (2 * math.pi) * 24).astype(int) % 24
    for scan in range(3):
        for b in range(24):
            rows = [r for r in range(starts[scan], starts[scan + 1]) if bins[r] == b]
            expected = min(rows, key=lambda r: np.linalg.norm(rays[r]), default=-1)
            assert table[scan, b] == expected


def test_points_are_counted_by_what_places_a_scan():
    def cloud(points, lines):
        ok = np.zeros(points + 5, dtype=bool)
        ok[5 : 5 + lines] = True
        empty = np.zeros((points + 5, 2))
        starts = np.array([0, 5, points + 5])
        points, table, one = (empty, empty, empty, ok, empty[:, 0], empty[:, 0]), np.zeros((2, 8)), [8]
        return Clouds(*points, starts, table, np.zeros((1, 2)), np.array(one), np.zeros(2, dtype=np.uint8))

    for points, lines, by in (
        (20, 8, "lines"), (20, 7, "points"), (100, 30, "lines"), (100, 29, "points"),
        (8, 8, "lines"), (8, 3, "points"), (7, 7, "nothing"),
    ):  # fmt: skip
        made = cloud(points, lines)
        assert made.placed_by(1) == by
        assert made.lines(1) == lines
        assert [made.lines(0), made.lines(1)] == [0, lines]
        assert len(made.of(1)) == points


def test_points_tell_of_a_pose_what_moving_it_moves_them():
    points = np.random.default_rng(5).normal(size=(30, 2))
    expected = np.zeros((3, 3))
    for p in points:
        j = [(SE2(d) @ p - SE2(-d) @ p) / 2e-6 for d in 1e-6 * np.eye(3)]
        expected += np.array(j) @ np.array(j).T
    np.testing.assert_allclose(point_information(points), expected, atol=1e-5)


def test_ranges_that_say_nothing_are_no_points():
    lidar = LidarSpec(6, 0.0, 0.1, 0.005, 8.0)
    ranges = np.array(
        [[0.009, 0.011, 3.0, 8.0, 8.01, np.nan], [0.5, 5.0, 5.01, -np.inf, np.inf, 0.0]], np.float32
    )
    log = Recording("x", np.array([0, 10**8]), ranges, lidar, SE2.from_xyt(1.0, 2.0, 0.0))
    kept = make_clouds(log, 30.0)
    assert kept.starts.tolist() == [0, 2, 5]  # at range_max nothing came back
    np.testing.assert_allclose(
        kept.points[0], [1.0 + 0.011 * math.cos(0.1), 2.0 + 0.011 * math.sin(0.1)], atol=1e-6
    )
    assert make_clouds(log, 5.0).starts.tolist() == [0, 2, 4]
    above = LidarSpec(6, 0.0, 0.1, 0.5, 8.0)
    assert make_clouds(
        Recording("x", log.stamps_ns, ranges, above, SE2.identity()), 30.0
    ).starts.tolist() == [0, 1, 4]
    assert kept.table.shape == (2, 63)


SLOW = LidarSpec(11, -1.0, 0.2, 0.1, 30.0, time_increment=0.02)


def moving(seconds):
    """The base on a curve whose speed and turn change all the time."""
    t = np.asarray(seconds)
    return SE2.from_xyt(0.4 * t + 0.2 * np.sin(3.0 * t), 0.3 * np.cos(2.0 * t), 0.8 * np.sin(2.5 * t))


def test_the_motion_of_a_sweep_is_odometrys_at_even_instants_of_it():
    times = np.arange(0, 3.0, 0.005)
    odometry = Trajectory((times * 1e9).astype(np.int64), moving(times))
    stamps = np.array([4, 11, 17]) * 10**8
    log = Recording("x", stamps, np.full((3, 11), 2.0, np.float32), SLOW, SE2.identity(), odometry=odometry)
    motion = sweep_motion(log)
    for k, stamp in enumerate(stamps * 1e-9):
        expected = moving(stamp).inverse() @ moving(stamp + 0.2 * np.arange(1, KNOTS + 1) / KNOTS)
        np.testing.assert_allclose(motion.xyt[k], expected.xyt, atol=2e-5)
    alone = Trajectory(odometry.stamps_ns[:1], odometry.poses[:1])
    for too_short in (None, alone):
        assert (
            sweep_motion(Recording("x", stamps, log.ranges, SLOW, SE2.identity(), odometry=too_short)) is None
        )


def test_points_of_a_sweep_are_put_where_the_base_was_when_they_were_seen():
    rng = np.random.default_rng(6)
    motion, T_base_lidar = SE2(rng.normal(0.0, 0.2, (3, KNOTS, 3))), SE2.from_xyt(0.1, -0.05, 0.4)
    stamps, ranges = np.arange(3) * 10**9, rng.uniform(1.0, 5.0, (3, 11)).astype(np.float32)
    ranges[1, 2:9], ranges[2] = np.inf, np.nan
    found = make_clouds(Recording("x", stamps, ranges, SLOW, T_base_lidar), 30.0, motion)
    for k in range(3):
        hit, when = np.isfinite(ranges[k]), np.linspace(0.0, 1.0, 11)
        origins, ways = deskewed(SLOW.directions, when, T_base_lidar.xyt, motion.xyt[k])
        np.testing.assert_allclose(found.of(k), (origins + ways * ranges[k, :, None])[hit], atol=1e-12)
    # the last beam is seen at the very end of the sweep
    log = Recording("x", stamps, np.full((3, 11), 2.0, np.float32), SLOW, SE2.identity())
    ends = make_clouds(log, 30.0, motion).points.reshape(3, 11, 2)
    np.testing.assert_allclose(ends[:, 0], np.tile(2.0 * SLOW.directions[0], (3, 1)), atol=1e-6)
    for k in range(3):
        np.testing.assert_allclose(ends[k, -1], motion[k, -1] @ (2.0 * SLOW.directions[-1]), atol=1e-6)


def test_without_odometry_a_sweep_moves_by_the_mean_speed_before_and_after():
    stamps = np.array([0, 500, 900, 900, 9000, 9400]) * 10**6
    poses = moving(stamps * 1e-9)
    log = Recording("x", stamps, np.full((6, 11), 2.0, np.float32), SLOW, SE2.identity())
    motion = sweep_motion_by_track(log, poses)
    speed = []
    for k in range(5):
        seconds = (stamps[k + 1] - stamps[k]) * 1e-9
        step = (poses[k].inverse() @ poses[k + 1]).xyt
        # after no time and after too long nothing is known
        speed.append(step / seconds if 0.0 < seconds < 4.0 else np.zeros(3))
    for k in range(6):
        mean = 0.5 * (speed[max(k - 1, 0)] + speed[min(k, 4)])
        for knot in range(KNOTS):
            np.testing.assert_allclose(motion.xyt[k, knot], 0.2 * mean * (knot + 1) / KNOTS, atol=1e-12)


def test_the_noise_of_a_range_is_the_sum_of_three_variances():
    noise = RangeNoise(0.02, 0.03, 0.004)
    np.testing.assert_allclose(
        noise.variance(np.array([0.0, 1.0, 4.0])), [4e-4, 1.316e-3, 4e-4 + 0.0144 + 0.004096]
    )


def test_a_lidars_own_bearings_are_those_of_its_table():
    clouds = make_clouds(recording(ROOM, np.array([[1.2, 1.0, 0.0]]), LDS), 30.0)
    seen = clouds.table[0][clouds.table[0] >= 0]
    assert len(np.unique(seen)) == len(seen) > 300
