"""Odometry whose pose never changes while its twist is right: the path is that of the twist."""

import math

import numpy as np
import pytest

from tests.helpers.foreign_bags import (
    LASER,
    ODOMETRY,
    SCAN,
    TF,
    laser_scan,
    odometry,
    tf,
    transform,
    write_foreign,
)
from turtlebag.datasets.recordings import load_recording

STEP = 50_000_000
TIMES = np.arange(200) * STEP
V, W = 0.3, 0.4
NOTE = "/odom: the pose never changes but the twist does; the path is integrated from the twist"


def unfilled(k, v=V, w=W, x=0.0, quaternion=None):
    message = odometry(int(TIMES[k]), x)
    message.twist.twist.linear.x, message.twist.twist.angular.z = v, w
    if quaternion is not None:
        for name, value in zip("xyzw", quaternion, strict=True):
            setattr(message.pose.pose.orientation, name, value)
    return message


def loaded(tmp_path, of_odometry, *, order=None, link=None):
    """The drive with the messages of odometry that `of_odometry` makes, and `link` at each step in /tf."""
    messages = [("/tf_static", TF, 0, tf(transform(0, *LASER)))]
    for k in range(len(TIMES)):
        time = int(TIMES[k])
        messages.append(("/odom", ODOMETRY, time, of_odometry(k if order is None else order[k])))
        if link is not None:
            messages.append(("/tf", TF, time, tf(transform(time, "odom", "base_footprint", *link(k)))))
        if k % 4 == 0:
            messages.append(("/scan", SCAN, time, laser_scan(time, np.linspace(1.0, 3.0, 360))))
    return load_recording(write_foreign(tmp_path / "bag", messages))


def circle(stamps):
    t = stamps * 1e-9
    return np.column_stack([V / W * np.sin(W * t), V / W * (1.0 - np.cos(W * t)), W * t])


@pytest.mark.parametrize("quaternion", [None, (0.0, 0.0, 0.0, 0.0)], ids=["zero pose", "no rotation"])
def test_the_path_is_integrated_from_the_twist_and_said_to_be(tmp_path, quaternion):
    found = loaded(tmp_path, lambda k: unfilled(k, quaternion=quaternion))
    np.testing.assert_allclose(found.T_odom_base.xy, circle(found.stamps_ns)[:, :2], atol=1e-3)
    np.testing.assert_allclose(np.unwrap(found.T_odom_base.yaw), circle(found.stamps_ns)[:, 2], atol=1e-9)
    assert found.notes == (NOTE,)


def test_it_begins_at_the_pose_and_goes_by_the_stamps_in_whatever_order_they_are(tmp_path):
    order = np.arange(len(TIMES))
    order[[10, 11]] = 11, 10
    found = loaded(tmp_path, lambda k: unfilled(k, x=5.0), order=order)
    np.testing.assert_allclose(found.T_odom_base.xy - (5.0, 0.0), circle(found.stamps_ns)[:, :2], atol=1e-3)
    assert NOTE in found.notes


@pytest.mark.parametrize("speed", [math.nan, math.inf, 1e308])
def test_a_twist_that_is_no_speed_counts_as_none(tmp_path, speed):
    found = loaded(tmp_path, lambda k: unfilled(k, v=speed if k == 7 else V, w=0.0))
    assert found.T_odom_base.x[-1] == pytest.approx(V * (found.stamps_ns[-1] - STEP) * 1e-9)


@pytest.mark.parametrize(
    "of_odometry",
    [lambda k: unfilled(k, v=0.01 * (-1) ** k, w=0.01 * (-1) ** k), lambda k: unfilled(k, x=0.015 * k)],
    ids=["a robot at rest", "a pose that changes"],
)
def test_other_poses_are_left_as_they_are(tmp_path, of_odometry):
    found = loaded(tmp_path, of_odometry)
    assert not any("twist" in note for note in found.notes)
    assert found.T_odom_base.x[-1] in (0.0, pytest.approx(0.015 * 196))
    assert np.ptp(found.T_odom_base.yaw) == 0.0
