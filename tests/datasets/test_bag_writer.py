"""Our bags as read by others: rosbags' own serialiser and the official mcap reader."""

import hashlib
import math
import os

import numpy as np
import pytest
import yaml
from mcap.reader import make_reader
from rosbags.highlevel import AnyReader

from tests.helpers.bag_samples import LINKS, observation, write_drive
from tests.helpers.full_disks import files_below
from turtlebag.datasets.bags.recover import recover
from turtlebag.datasets.bags.topics import TOPICS, typestore
from turtlebag.datasets.bags.writer import BagWriter
from turtlebag.datasets.errors import InputError
from turtlebag.datasets.types import Twist

STEP_NS = 33_333_333


@pytest.fixture(scope="module")
def bag(tmp_path_factory):
    folder = tmp_path_factory.mktemp("written") / "bag"
    write_drive(folder, seconds=5, navigation=True)
    return folder


def messages(folder, topic):
    with AnyReader([folder]) as reader:
        connections = [connection for connection in reader.connections if connection.topic == topic]
        return [
            (time, reader.deserialize(raw, connection.msgtype), bytes(raw), connection.msgtype)
            for connection, time, raw in reader.messages(connections)
        ]


@pytest.mark.slow
@pytest.mark.parametrize("topic", sorted(TOPICS))
def test_every_message_has_the_bytes_of_the_reference_serialiser(bag, topic):
    found = messages(bag, topic)
    assert found
    for _, message, raw, msgtype in found:
        assert bytes(typestore().serialize_cdr(message, msgtype)) == raw


@pytest.mark.slow
def test_rates_and_order(bag):
    assert len(messages(bag, "/odom")) == len(messages(bag, "/joint_states")) == 150
    assert len(messages(bag, "/scan")) == 25
    with AnyReader([bag]) as reader:
        times = [time for _, time, _ in reader.messages()]
    assert times == sorted(times)


@pytest.mark.slow
def test_scan_odometry_and_transform_values(bag):
    sample = observation(6)
    time, scan, _, _ = messages(bag, "/scan")[0]
    assert time == sample.stamp_ns
    assert scan.header.stamp.sec * 10**9 + scan.header.stamp.nanosec == sample.scan.stamp_ns
    assert scan.header.frame_id == "base_scan"
    np.testing.assert_array_equal(scan.ranges, sample.scan.ranges)
    assert scan.angle_increment == pytest.approx(math.radians(1.0))
    assert scan.angle_max == pytest.approx(math.radians(359.0))
    assert (scan.range_min, scan.range_max) == (pytest.approx(0.12), 3.5)
    _, odometry, _, _ = messages(bag, "/odom")[5]
    assert (odometry.header.frame_id, odometry.child_frame_id) == ("odom", "base_footprint")
    yaw = 2.0 * math.atan2(odometry.pose.pose.orientation.z, odometry.pose.pose.orientation.w)
    pose = odometry.pose.pose.position
    np.testing.assert_allclose([pose.x, pose.y, yaw], sample.odometry.T_odom_base.xyt, atol=1e-12)
    assert odometry.twist.twist.linear.x == sample.odometry.twist.v
    assert odometry.twist.twist.angular.z == sample.odometry.twist.w
    links = {
        (t.header.frame_id, t.child_frame_id)
        for topic in ("/tf", "/tf_static")
        for _, message, _, _ in messages(bag, topic)
        for t in message.transforms
    }
    assert ("odom", "base_footprint") in links
    assert ("map", "odom") in links
    assert not any("world" in link for link in links)


@pytest.mark.slow
def test_map_plan_and_particles_values(bag):
    grid = messages(bag, "/map")[0][1]
    assert (grid.info.width, grid.info.height) == (3, 2)
    assert grid.data.tolist() == [0, 100, -1, 0, 0, 0]
    assert grid.info.origin.position.x == -1.0
    plan = messages(bag, "/plan")[0][1]
    assert [pose.pose.position.x for pose in plan.poses] == [0.0, 1.0, 2.0]
    assert len(messages(bag, "/particlecloud")[0][1].poses) == 3
    covariance = messages(bag, "/amcl_pose")[0][1].pose.covariance.reshape(6, 6)
    assert (covariance[0, 0], covariance[1, 5], covariance[5, 5]) == (0.1, 0.02, 0.3)


def test_metadata_names_latched_topics_and_the_custom_data(bag):
    information = yaml.safe_load((bag / "metadata.yaml").read_text())["rosbag2_bagfile_information"]
    assert (information["version"], information["storage_identifier"]) == (9, "mcap")
    assert information["custom_data"] == {"seed": "7"}
    topics = {
        item["topic_metadata"]["name"]: item["topic_metadata"]
        for item in information["topics_with_message_count"]
    }
    for name in ("/map", "/tf_static"):
        assert topics[name]["offered_qos_profiles"][0]["durability"] == "transient_local"
    assert topics["/scan"]["type_description_hash"].startswith("RIHS01_")
    with AnyReader([bag]) as reader:
        assert reader.message_count == information["message_count"]
        assert reader.duration == information["duration"]["nanoseconds"] + 1


def test_the_official_reader_agrees_checksums_and_all(bag):
    with (bag / "bag_0.mcap").open("rb") as file:
        reader = make_reader(file, validate_crcs=True)
        summary = reader.get_summary()
        count = sum(1 for _ in reader.iter_messages())
        metadata = [record.name for record in reader.iter_metadata()]
    assert count == summary.statistics.message_count
    assert metadata == ["custom_data", "rosbag2"]
    assert {channel.topic for channel in summary.channels.values()} == set(TOPICS)
    assert all(schema.encoding == "ros2msg" for schema in summary.schemas.values())


def test_same_data_same_bytes_wherever_it_is_written(bag, tmp_path):
    write_drive(tmp_path / "elsewhere", seconds=5, navigation=True)
    for name in ("bag_0.mcap", "metadata.yaml"):
        a, b = (bag / name).read_bytes(), (tmp_path / "elsewhere" / name).read_bytes()
        assert hashlib.sha256(a).digest() == hashlib.sha256(b).digest()


@pytest.mark.parametrize("error", [KeyboardInterrupt, RuntimeError])
def test_whatever_ends_a_recording_closes_the_bag(tmp_path, error):
    with pytest.raises(error), BagWriter(tmp_path / "bag", custom={}) as writer:  # noqa: PT012
        writer.command(0, Twist(0.1, 0.0))
        raise error
    assert (tmp_path / "bag/metadata.yaml").exists()
    assert len(messages(tmp_path / "bag", "/cmd_vel")) == 1


def drive_until_it_fails(folder):
    with BagWriter(folder, custom={}) as writer:
        for step in range(3000):
            writer.command(step * 10**7, Twist(0.1 * step, 0.0))


@pytest.mark.parametrize(("room", "seconds"), [(8000, 2), (12345, 4)])
def test_where_there_is_no_room_all_whole_chunks_are_kept(tmp_path, room, seconds):
    with files_below(room), pytest.raises(OSError, match="too large"):
        drive_until_it_fails(tmp_path / "bag")
    (file,) = (tmp_path / "bag").iterdir()
    saved = recover(tmp_path / "bag", tmp_path / "saved")
    assert saved.messages == 101 * seconds
    assert file.stat().st_size > 0.7 * room


def test_a_bag_without_room_for_its_head_leaves_no_file_open(tmp_path):
    with files_below(20), pytest.raises(InputError, match="cannot be written") as refused:
        BagWriter(tmp_path / "bag", custom={})
    opened = [os.path.realpath(f"/proc/self/fd/{number}") for number in os.listdir("/proc/self/fd")]
    assert not [path for path in opened if path.startswith(str(tmp_path))], refused


def test_a_bag_without_room_for_any_message_is_none(tmp_path):
    with files_below(1000), pytest.raises(OSError, match="too large"):
        drive_until_it_fails(tmp_path / "bag")
    assert list((tmp_path / "bag").iterdir()) == []


def test_fixed_links_keep_their_place_in_space(bag):
    ((_, message, _, _),) = messages(bag, "/tf_static")
    for link, (parent, child, xyz, yaw) in zip(message.transforms, LINKS, strict=True):
        assert (link.header.frame_id, link.child_frame_id) == (parent, child)
        found, turn = link.transform.translation, link.transform.rotation
        assert (found.x, found.y, found.z) == xyz
        assert (turn.z, turn.w) == pytest.approx((math.sin(yaw / 2), math.cos(yaw / 2)))
