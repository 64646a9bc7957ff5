"""The gyro as evidence of rotation: used if it is credible, rejected if it is not."""

from dataclasses import replace
from functools import cache

import numpy as np
import pytest

from benchmarks.slam_scores import errors
from tests.helpers.made_drives import Lie
from tests.helpers.slam_rooms import ROOM, around_the_room, drifted, recording
from tests.slam.test_slam_hostile import office
from turtlebag.datasets.se2 import SE2, wrap
from turtlebag.datasets.types import ImuLog, Trajectory
from turtlebag.pipeline.slam.mapper import SlamConfig, run_slam
from turtlebag.pipeline.slam.sensors.gyro_slip import with_gyro

TRUTH = around_the_room(300, laps=2)
BIAS = 0.004


def gyro(stamps_ns, yaw, *, sign=1.0, scale=1.0, bias=BIAS, seed=1):
    """100 Hz samples of a motion given by yaws at stamps."""
    t = np.arange(stamps_ns[0] * 1e-9 - 0.2, stamps_ns[-1] * 1e-9 + 0.2, 0.01)
    rate = np.gradient(np.interp(t, stamps_ns * 1e-9, np.unwrap(yaw)), 0.01)
    w = np.zeros((len(t), 3))
    w[:, 2] = sign * (scale * rate + bias) + 0.002 * np.random.default_rng(seed).standard_normal(len(t))
    return ImuLog(np.round(t * 1e9).astype(np.int64), w, np.zeros_like(w))


@cache
def slipping():
    """A log whose wheels turn alone for a while; made once."""
    T = SE2.from_array(TRUTH)
    steps = T.steps()
    steps[100:150, 2] += 0.06
    poses = [TRUTH[0]]
    for step in steps:
        poses.append((SE2(poses[-1]) @ SE2(step)).xyt)
    return recording(ROOM, TRUTH, odometry=np.array(poses))


def yaw_error(log):
    true = SE2.from_array(TRUTH).yaw
    return np.abs(wrap(log.T_odom_base.yaw - true))


@pytest.mark.parametrize("sign", [1.0, -1.0])
def test_slipping_turns_are_the_gyro_s_and_all_else_the_wheels(sign):
    log = slipping()
    assert yaw_error(log).max() > 2.5
    fused = with_gyro(replace(log, imu=gyro(log.stamps_ns, TRUTH[:, 2], sign=sign)))
    assert yaw_error(fused).max() < 0.1
    assert np.linalg.norm(fused.T_odom_base.xy - TRUTH[:, :2], axis=1).max() < 0.3
    before, after = (T.steps() for T in (log.T_odom_base, fused.T_odom_base))
    np.testing.assert_allclose(np.hypot(*after.T[:2]), np.hypot(*before.T[:2]), atol=1e-9)
    slipped = np.isin(np.arange(299), np.arange(100, 150))
    np.testing.assert_allclose(after[~slipped], before[~slipped], atol=1e-12)


def test_wheels_that_do_not_slip_are_believed():
    log = recording(ROOM, TRUTH, odometry=drifted(TRUTH))
    assert with_gyro(replace(log, imu=gyro(log.stamps_ns, TRUTH[:, 2]))).T_odom_base is log.T_odom_base


def test_stream_between_the_scans_turns_too():
    log = slipping()
    log = replace(log, odometry=Trajectory(log.stamps_ns, log.T_odom_base))
    fused = with_gyro(replace(log, imu=gyro(log.stamps_ns, TRUTH[:, 2])))
    np.testing.assert_allclose(fused.odometry.poses.xyt, fused.T_odom_base.xyt, atol=1e-12)


def broken(kind, log):
    imu = gyro(log.stamps_ns, TRUTH[:, 2])
    if kind == "none":
        return None
    w = imu.angular_velocity.copy()
    if kind == "dead":
        w[:] = 0.0
    elif kind == "not a number":
        w[:] = np.nan
    elif kind == "degrees":
        w *= 57.3
    elif kind == "noise":
        w[:, 2] = np.random.default_rng(2).normal(0.0, 3.0, len(w))
    elif kind == "another axis":
        w = w[:, [2, 0, 1]]
    return ImuLog(imu.stamps_ns[:0], w[:0], w[:0]) if kind == "empty" else replace(imu, angular_velocity=w)


@pytest.mark.parametrize(
    "kind", ["none", "dead", "not a number", "degrees", "noise", "another axis", "empty"]
)
def test_gyro_that_does_not_turn_with_the_robot_is_left_alone(kind):
    log = slipping()
    log = replace(log, imu=broken(kind, log))
    assert with_gyro(log) is log


def test_holes_are_filled_by_the_wheels():
    log = slipping()
    imu = gyro(log.stamps_ns, TRUTH[:, 2])
    kept = np.abs(imu.stamps_ns - log.stamps_ns[50]) > 10**9
    holed = ImuLog(imu.stamps_ns[kept], imu.angular_velocity[kept], imu.linear_acceleration[kept])
    fused = with_gyro(replace(log, imu=holed))
    assert fused is not log
    assert yaw_error(fused).max() < 0.1


@pytest.mark.slow
def test_wheels_that_spin_while_no_scan_sees_it_do_not_bend_the_path():
    log = office(Lie("spin", 20.0, 4.0)).with_scans(slice(160))
    late = (log.recording.stamps_ns - log.recording.stamps_ns[0]) * 1e-9
    ranges = log.recording.ranges.copy()
    ranges[(late >= 20.0) & (late < 24.0)] = np.nan
    imu = gyro(log.recording.stamps_ns, log.truth.poses.yaw)
    blind = replace(log.recording, ranges=ranges, imu=imu)
    worst = [
        errors(run_slam(blind, SlamConfig(gyro=used)).trajectory.poses, log.reference)["worst_m"]
        for used in (True, False)
    ]
    assert worst[0] < 0.06
    assert worst[1] > 4.0 * worst[0]
