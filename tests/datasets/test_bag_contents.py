"""The messages of a bag beside its scans: what is intact is decoded, what is not is named."""

import numpy as np
import pytest
from rosbags.typesys import Stores, get_typestore

from tests.helpers.bag_samples import write_drive
from tests.helpers.foreign_bags import STORE, S
from tests.helpers.ros1_bags import to_ros1_bag
from turtlebag.datasets.bags import decode
from turtlebag.datasets.bags.contents import Contents
from turtlebag.datasets.bags.copying import into_mcap
from turtlebag.datasets.bags.folder import BagFolder
from turtlebag.datasets.bags.source import open_bag
from turtlebag.datasets.bags.topics import IMU, ODOMETRY

ROS1 = get_typestore(Stores.ROS1_NOETIC)


@pytest.fixture(scope="module", params=["ros2", "ros1"])
def bag(request, tmp_path_factory):
    folder = tmp_path_factory.mktemp("drive")
    write_drive(folder / "bag", seconds=3)
    if request.param == "ros1":
        to_ros1_bag(folder / "bag", folder / "a.bag")
    return open_bag(folder / ("a.bag" if request.param == "ros1" else "bag"))


def read(bag, msgtype, data):
    """A message as rosbags reads it."""
    return (
        ROS1.deserialize_ros1(data, msgtype) if bag.kind == "ros1" else STORE.deserialize_cdr(data, msgtype)
    )


def stamp_of(message):
    return message.header.stamp.sec * S + message.header.stamp.nanosec


def planar(message):
    at = message.pose.pose
    turn = at.orientation
    return at.position.x, at.position.y, decode.yaw_of((turn.x, turn.y, turn.z, turn.w))


def xyz(vector):
    return vector.x, vector.y, vector.z


def spoilt(bag, folder, topic, number, change):
    """A copy of the bag, with one message of a topic changed; and the others of that topic."""
    kept, seen = [], 0
    with BagFolder(folder, custom={}) as out:
        copier = into_mcap(out)
        for message in open_bag(bag.path).messages():
            ours = message.topic.name == topic
            if ours and seen == number:
                message = message._replace(data=change(message.data))
            elif ours:
                kept.append((message.log_time_ns, message.data))
            seen += ours
            copier.write(message)
    return open_bag(folder), kept


@pytest.fixture(scope="module")
def copied(tmp_path_factory):
    folder = tmp_path_factory.mktemp("copied")
    write_drive(folder / "bag", seconds=3)
    return open_bag(folder / "bag")


@pytest.mark.parametrize("spoil", [None, "a short one", "another frame"])
def test_odometry(copied, tmp_path, spoil):
    number = {"a short one": 3, "another frame": 5}.get(spoil, -1)
    other = b"base_footprint", b"base_footprinx"
    change = (lambda data: data.replace(*other)) if spoil == "another frame" else (lambda data: data[:200])
    bag, kept = spoilt(copied, tmp_path / "bag", "/odom", number, change)
    contents = Contents(bag)
    found = contents.read_odometry("/odom")
    expected = [read(bag, ODOMETRY, data) for _, data in kept]
    assert found.log_times_ns.tolist() == [time for time, _ in kept]
    assert found.stamps_ns.tolist() == list(map(stamp_of, expected))
    np.testing.assert_allclose(found.xyt, list(map(planar, expected)), atol=1e-15)
    np.testing.assert_allclose(found.twists, [(0.2, 0.0, 0.1)] * len(kept))
    assert found.child == "base_footprint"
    others = {("odom", "base_footprinx"): 1} if spoil == "another frame" else {}
    assert found.links == {("odom", "base_footprint"): len(kept), **others}
    said = [str(finding) for finding in contents.findings()]
    assert said == (["/odom: 1 of 90 messages cannot be decoded; skipped"] if spoil == "a short one" else [])


def test_all_is_read_from_either_ros(bag):
    contents = Contents(bag)
    odometry, imu = contents.read_odometry("/odom"), contents.read_imu([])
    messages = list(bag.messages())
    poses = [read(bag, ODOMETRY, m.data) for m in messages if m.topic.name == "/odom"]
    samples = [read(bag, IMU, m.data) for m in messages if m.topic.name == "/imu"]
    assert odometry.stamps_ns.tolist() == list(map(stamp_of, poses))
    np.testing.assert_allclose(odometry.xyt, list(map(planar, poses)), atol=1e-15)
    assert imu.stamps_ns.tolist() == list(map(stamp_of, samples))
    np.testing.assert_array_equal(imu.angular_velocity, [xyz(s.angular_velocity) for s in samples])
    np.testing.assert_array_equal(imu.linear_acceleration, [xyz(s.linear_acceleration) for s in samples])
    assert contents.others == {}
    assert set(Contents(bag, everything=True).others) == {"/ground_truth/odom", "/joint_states"}


def test_a_short_sample_of_an_imu_is_left_out(copied, tmp_path):
    bag, kept = spoilt(copied, tmp_path / "bag", "/imu", 2, lambda data: data[:100])
    contents = Contents(bag)
    expected = [stamp_of(read(bag, IMU, data)) for _, data in kept]
    assert contents.read_imu([]).stamps_ns.tolist() == expected
    (finding,) = contents.findings()
    assert (finding.topic, finding.count) == ("/imu", 1)


def test_a_pose_without_a_rotation_is_not_a_number(copied, tmp_path):
    def unturned(data):
        cursor = decode.Cursor(data)
        cursor.header()
        cursor.string()
        cursor.align(8)
        start = cursor.at + 24
        return data[:start] + bytes(32) + data[start + 32 :]

    bag, _ = spoilt(copied, tmp_path / "bag", "/odom", 2, unturned)
    yaw = Contents(bag).read_odometry("/odom").xyt[:, 2]
    assert np.flatnonzero(np.isnan(yaw)).tolist() == [2]


def test_messages_of_several_frames_in_turn_keep_their_order(copied, tmp_path):
    with BagFolder(tmp_path / "bag", custom={}) as out:
        copier = into_mcap(out)
        for k, message in enumerate(m for m in open_bag(copied.path).messages() if m.topic.name == "/odom"):
            name = (b"base_footprint", b"base_footprinx", b"base_footpriny")[k % 3]
            copier.write(message._replace(data=message.data.replace(b"base_footprint", name)))
    found, whole = (
        Contents(open_bag(path)).read_odometry("/odom") for path in (tmp_path / "bag", copied.path)
    )
    assert found.stamps_ns.tolist() == whole.stamps_ns[::3].tolist()
    assert found.log_times_ns.tolist() == whole.log_times_ns[::3].tolist()
    np.testing.assert_array_equal(found.xyt, whole.xyt[::3])
    assert found.links == {("odom", f"base_footprin{last}"): 30 for last in "txy"}
