"""The streams of a bag beside its scans: what is intact is decoded, what is not is counted."""

import numpy as np
import pytest

from tests.helpers.bag_samples import write_drive
from turtlebag.datasets.bags import decode
from turtlebag.datasets.bags.convert import to_ros1_bag
from turtlebag.datasets.bags.source import open_bag
from turtlebag.datasets.bags.streams import Streams


@pytest.fixture(scope="module", params=["ros2", "ros1"])
def bag(request, tmp_path_factory):
    folder = tmp_path_factory.mktemp("drive")
    write_drive(folder / "bag", seconds=3)
    if request.param == "ros1":
        to_ros1_bag(folder / "bag", folder / "a.bag")
    return open_bag(folder / ("a.bag" if request.param == "ros1" else "bag"))


@pytest.mark.slow
@pytest.mark.parametrize("spoil", [None, "a short one", "another frame"])
def test_odometry(bag, spoil):
    streams = Streams(bag)
    raw = streams.odometry["/odom"]
    left = {"a short one": 3, "another frame": 5}.get(spoil)
    if spoil is not None:
        time, data = raw[left]
        short = data.replace(b"base_footprint", b"base_footprinx") if spoil == "another frame" else data[:200]
        raw[left] = (time, short)
    kept = [message for index, message in enumerate(raw) if index != left]
    found = streams.read_odometry("/odom")
    expected = [decode.odometry(bag.cursor(data)) for _, data in kept]
    assert found.log_times_ns.tolist() == [time for time, _ in kept]
    assert found.stamps_ns.tolist() == [pose.stamp_ns for pose in expected]
    np.testing.assert_allclose(found.xyt, [(pose.x, pose.y, pose.yaw) for pose in expected], atol=1e-15)
    assert found.child == "base_footprint"
    assert found.others == ({"odom -> base_footprinx": 1} if spoil == "another frame" else {})
    assert streams.bad == (spoil == "a short one")


def test_imu(bag):
    streams = Streams(bag)
    raw = streams.imu["/imu"]
    raw[2] = (raw[2][0], raw[2][1][:100])
    expected = [decode.imu(bag.cursor(data)) for index, (_, data) in enumerate(raw) if index != 2]
    found = streams.read_imu()
    assert found.stamps_ns.tolist() == [sample.stamp_ns for sample in expected]
    np.testing.assert_array_equal(found.angular_velocity, [sample.angular for sample in expected])
    np.testing.assert_array_equal(found.linear_acceleration, [sample.linear for sample in expected])
    assert streams.bad == 1


def test_a_pose_without_a_rotation_is_not_a_number(bag):
    streams = Streams(bag)
    raw = streams.odometry["/odom"]
    time, data = raw[2]
    cursor = bag.cursor(data)
    cursor.header()
    cursor.string()
    cursor.align(8)
    start = cursor.at + 24
    raw[2] = (time, data[:start] + bytes(32) + data[start + 32 :])
    yaw = streams.read_odometry("/odom").xyt[:, 2]
    assert np.flatnonzero(np.isnan(yaw)).tolist() == [2]
