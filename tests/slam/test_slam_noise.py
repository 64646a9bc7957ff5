"""Noise estimated from the log itself: of ranges and lines, and the motion during a sweep."""

import math
from dataclasses import replace

import numpy as np
import pytest

from tests.helpers.exact_rays import ranges_to
from tests.helpers.slam_rooms import LDS, ROOM, SICK, around_the_room, drifted, recording
from turtlebag.datasets.motion import KNOTS, sweep_motion
from turtlebag.datasets.se2 import SE2, wrap
from turtlebag.datasets.types import LidarSpec, Recording, Trajectory
from turtlebag.pipeline.slam.odometry.line_icp import Lines
from turtlebag.pipeline.slam.odometry.track import TrackingConfig
from turtlebag.pipeline.slam.odometry.tracker import Tracker
from turtlebag.pipeline.slam.scans.clouds import make_clouds
from turtlebag.pipeline.slam.scans.range_noise import RangeNoise, range_noise

POSES = around_the_room(120)


@pytest.mark.parametrize(
    ("floor", "slope", "square"),
    [
        (0.004, 0.0, 0.0),
        (0.01, 0.0, 0.0),
        (0.03, 0.0, 0.0),
        (0.0, 0.017, 0.0),
        (0.01, 0.02, 0.0),
        (0.003, 0.0, 0.003),
    ],
)
def test_the_noise_of_the_ranges_is_found_in_the_log(floor, slope, square):
    exact = recording(ROOM, POSES, SICK, noise=0.0)
    variance = floor**2 + (slope * exact.ranges) ** 2 + (square * exact.ranges**2) ** 2
    noisy = exact.ranges + np.random.default_rng(4).standard_normal(exact.ranges.shape) * np.sqrt(variance)
    found = range_noise(replace(exact, ranges=noisy.astype(np.float32)), 30.0)
    for r in (1.0, 3.0, 5.0):
        assert math.sqrt(found.variance(r)) == pytest.approx(
            math.hypot(max(floor, 0.003), slope * r, square * r**2), rel=0.2
        )


def test_a_log_with_too_few_returns_has_the_usual_noise():
    empty = recording(ROOM, POSES[:2])
    empty.ranges[:] = np.inf
    assert range_noise(empty, 30.0) == RangeNoise()


@pytest.mark.parametrize("noise", [0.005, 0.01, 0.03])
def test_the_directions_of_lines_err_as_much_as_they_say(noise):
    clouds = make_clouds(recording(ROOM, POSES, LDS, noise=noise), 30.0, noise=RangeNoise(noise))
    scan = np.repeat(np.arange(len(POSES)), np.diff(clouds.starts))
    ok = clouds.line_ok
    angle = np.arctan2(clouds.normals[:, 1], clouds.normals[:, 0]) + POSES[scan, 2]
    error = np.abs(wrap(4.0 * angle[ok])) / 4.0  # all walls stand square to each other
    normalised = error / np.sqrt(clouds.normal_var[ok])
    assert ok.mean() > 0.85
    assert 0.5 < np.median(normalised) / 0.6745 < 1.3
    assert np.mean(normalised > 4.0) < 0.02


def test_no_line_bends_round_the_end_of_a_wall():
    edge = np.array([[2.0, -5.0, 2.0, 0.2], [2.0, 0.2, 2.2, 0.2], [2.2, 0.2, 2.2, 5.0]])
    clouds = make_clouds(recording(edge, np.zeros((40, 3)), LDS, noise=0.01), 30.0, noise=RangeNoise(0.01))
    ok = clouds.line_ok & (np.abs(clouds.points[:, 1] - 0.2) < 0.3)
    error = np.abs(wrap(4.0 * np.arctan2(clouds.normals[ok, 1], clouds.normals[ok, 0]))) / 4.0
    assert np.count_nonzero(ok) > 200
    assert np.mean(error > 4.0 * np.sqrt(clouds.normal_var[ok]) + 0.05) < 0.03


def test_a_robot_that_stops_turning_within_a_sweep_sees_straight_walls():
    lidar = LidarSpec(360, 0.0, math.pi / 180.0, 0.12, 8.0, time_increment=0.2 / 360)
    start, when = np.array([4.5, 3.0, 0.2]), np.arange(361) * (0.2 / 360)
    turned = np.where(when < 0.1, 1.5 * when, 0.15)  # 1.5 rad/s, then nothing
    poses = np.column_stack([np.full((361, 2), start[:2]), start[2] + turned])
    ranges = ranges_to(ROOM, SE2(poses[:360]), lidar.angles, lidar.range_max)[None]
    stamps = (when * 1e9).round().astype(np.int64)
    odometry = Trajectory(stamps, SE2(poses))
    log = Recording(
        "test", stamps[:1], ranges.astype(np.float32), lidar, SE2.identity(), SE2(poses[:1]), odometry
    )
    motion = sweep_motion(log)
    assert motion.shape == (1, KNOTS)
    np.testing.assert_allclose(motion.yaw[0, -1], 0.15, atol=2e-3)
    seen = SE2(start) @ make_clouds(log, 30.0).points
    even = replace(log, odometry=Trajectory(stamps[[0, -1]], SE2(poses[[0, -1]])))
    skewed = SE2(start) @ make_clouds(even, 30.0).points
    walls = [p[(p[:, 0] > 4.0) & (p[:, 0] < 7.0) & (p[:, 1] > 5.5)] for p in (seen, skewed)]
    straight, bent = (np.abs(wall[:, 1] - 6.0).max() for wall in walls)
    assert straight < 0.01
    assert bent > 0.03


def test_after_a_gap_odometry_that_comes_late_is_believed_when_it_fits():
    poses = around_the_room(160)
    kept = np.r_[0:60, 75:160]  # the robot went on 0.6 rad and 0.7 m unseen
    log = recording(ROOM, poses[kept], LDS, odometry=drifted(poses, scale=1.01)[kept])
    odometry = log.T_odom_base.xyt.copy()
    odometry[60] = odometry[59]  # the first scan after the gap has the odometry from before it
    stamps = log.stamps_ns.copy()
    stamps[60:] += 3 * 10**9
    log = replace(log, stamps_ns=stamps, T_odom_base=SE2(odometry))
    made = []

    def make(tracker):
        made.append(Lines(tracker))
        return made[0]

    tracker = Tracker(make_clouds(log, 30.0), log, TrackingConfig(), 30.0, make)
    for wait_s in (1e-9 * np.diff(stamps[:80])).tolist():
        tracker.step(wait_s)
    error = (SE2(poses[kept][79]).inverse() @ SE2(tracker.pose)).xyt
    assert np.hypot(*error[:2]) < 0.1
    assert abs(error[2]) < 0.05
    assert made[0].doubt is None
