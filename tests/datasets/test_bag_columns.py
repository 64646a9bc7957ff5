"""Whole columns of messages decode to what the messages decode to one by one."""

import numpy as np
import pytest

from tests.helpers.bag_samples import write_drive
from turtlebag.datasets.bags import columns, decode
from turtlebag.datasets.bags.convert import to_ros1_bag
from turtlebag.datasets.bags.source import open_bag


@pytest.fixture(scope="module", params=["ros2", "ros1"])
def bag(request, tmp_path_factory):
    folder = tmp_path_factory.mktemp("drive")
    write_drive(folder / "bag", seconds=3)
    if request.param == "ros1":
        to_ros1_bag(folder / "bag", folder / "a.bag")
    return open_bag(folder / ("a.bag" if request.param == "ros1" else "bag"))


def raw(bag, topic):
    return [message.data for message in bag.messages(lambda candidate: candidate.name == topic)]


def other_frame(message):
    return message.replace(b"base_footprint", b"base_footprinx")


@pytest.mark.slow
@pytest.mark.parametrize("spoil", [None, "a short one", "another frame"])
def test_odometry(bag, spoil):
    messages = raw(bag, "/odom")
    if spoil == "a short one":
        messages[3] = messages[3][:200]
    if spoil == "another frame":
        messages[5] = other_frame(messages[5])
    found = columns.odometry(messages, bag.cursor)
    left = {"a short one": 3, "another frame": 5}.get(spoil)
    kept = [index for index in range(len(messages)) if index != left]
    expected = [decode.odometry(bag.cursor(messages[index])) for index in kept]
    assert found.kept.tolist() == kept
    assert found.stamps_ns.tolist() == [pose.stamp_ns for pose in expected]
    np.testing.assert_allclose(found.xyt, [pose[3:6] for pose in expected], atol=1e-15)
    assert found.child == "base_footprint"
    assert found.others == ({"odom -> base_footprinx": 1} if spoil == "another frame" else {})


def test_imu(bag):
    messages = raw(bag, "/imu")
    found = columns.imu(messages, bag.cursor)
    expected = [decode.imu(bag.cursor(message)) for message in messages]
    assert found.stamps_ns.tolist() == [sample.stamp_ns for sample in expected]
    np.testing.assert_array_equal(found.angular_velocity, [sample.angular for sample in expected])
    np.testing.assert_array_equal(found.linear_acceleration, [sample.linear for sample in expected])


def test_a_pose_without_a_rotation_is_not_a_number(bag):
    messages = raw(bag, "/odom")
    cursor = bag.cursor(messages[0])
    cursor.header()
    cursor.string()
    cursor.align(8)
    start = cursor.at + 24
    messages[2] = messages[2][:start] + bytes(32) + messages[2][start + 32 :]
    yaw = columns.odometry(messages, bag.cursor).xyt[:, 2]
    assert np.flatnonzero(np.isnan(yaw)).tolist() == [2]
