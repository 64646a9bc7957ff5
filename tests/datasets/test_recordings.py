"""Whatever a bag's format and conventions, scans, odometry and laser pose are the same."""

import math
import shutil
from pathlib import Path

import numpy as np
import pytest
from rosbags.rosbag1 import Writer as Writer1
from rosbags.rosbag2 import CompressionFormat, CompressionMode, StoragePlugin
from rosbags.rosbag2 import Writer as Writer2
from rosbags.typesys import Stores, get_typestore

from tests.helpers.bag_samples import LIDAR, LINKS, observation, pose, stamp, write_drive
from tests.helpers.foreign_bags import (
    ODOMETRY,
    SCAN,
    STORE,
    TF,
    header,
    laser_scan,
    odometry,
    tf,
    transform,
    write_foreign,
)
from turtlebag.datasets.bags.copying import into_mcap
from turtlebag.datasets.bags.decode import yaw_of
from turtlebag.datasets.bags.doctor import examine
from turtlebag.datasets.bags.folder import BagFolder
from turtlebag.datasets.bags.reader import bag_info, read_commands, read_particles, read_poses
from turtlebag.datasets.bags.source import open_bag
from turtlebag.datasets.bags.writer import BagWriter
from turtlebag.datasets.errors import InputError
from turtlebag.datasets.recordings import load_recording
from turtlebag.datasets.se2 import SE2

FULL_TURN = 2.0 * math.pi


def same(a, b):
    assert a.stamps_ns.tolist() == b.stamps_ns.tolist()
    np.testing.assert_array_equal(a.ranges, b.ranges)
    np.testing.assert_array_equal(a.T_odom_base.xyt, b.T_odom_base.xyt)
    np.testing.assert_array_equal(a.T_base_lidar.xyt, b.T_base_lidar.xyt)


def test_scans_odometry_laser_pose_and_imu(drive):
    recording = load_recording(drive)
    scans = [sample.scan for step in range(1, 181) if (sample := observation(step)).scan]
    assert recording.stamps_ns.tolist() == [scan.stamp_ns for scan in scans]
    np.testing.assert_array_equal(recording.ranges, [scan.ranges for scan in scans])
    np.testing.assert_allclose(recording.T_base_lidar.xyt, [-0.032, 0.0, 0.0])
    assert recording.lidar.angle_increment == pytest.approx(LIDAR.angle_increment)
    assert recording.lidar.time_increment == pytest.approx(1 / 1800)
    expected = [pose(max(step - 6, 1)).xyt for step in range(6, 181, 6)]
    np.testing.assert_allclose(recording.T_odom_base.xyt, expected, atol=1e-9)
    assert len(recording.odometry) == 180
    samples = [sample for step in range(1, 181) for sample in observation(step).imu]
    assert recording.imu.stamps_ns.tolist() == [sample.stamp_ns for sample in samples]
    np.testing.assert_allclose(recording.imu.angular_velocity, [s.angular_velocity for s in samples])
    np.testing.assert_allclose(recording.imu.linear_acceleration, [s.linear_acceleration for s in samples])
    assert recording.notes == ()


def test_odometry_between_its_stamps_is_interpolated(tmp_path):
    with BagWriter(tmp_path / "bag", custom={}) as writer:
        writer.static_transforms(0, LINKS)
        for step in range(0, 12):
            sample = observation(step)
            if sample.scan is not None:
                scan = type(sample.scan)(stamp(2) + 10_000_000, sample.scan.ranges, LIDAR)
                sample = type(sample)(sample.stamp_ns, sample.odometry, sample.joints, scan)
            writer.observation(sample)
    recording = load_recording(tmp_path / "bag")
    between = pose(2).interpolate(pose(3), 0.3)
    np.testing.assert_allclose(recording.T_odom_base.xyt[0], between.xyt, atol=1e-8)


def test_metadata_nested_without_end_is_left_aside(drive, tmp_path):
    shutil.copytree(drive, tmp_path / "bag")
    (tmp_path / "bag/metadata.yaml").write_text("[" * 500_000)
    recording = load_recording(tmp_path / "bag")
    same(recording, load_recording(drive))
    assert recording.notes[0].startswith("metadata.yaml cannot be used (nested too deeply")


def test_every_way_to_name_the_same_bag(drive, tmp_path):
    expected = load_recording(drive)
    shutil.copytree(drive, tmp_path / "run" / "bag")
    same(load_recording(tmp_path / "run"), expected)
    same(load_recording(tmp_path / "run" / "bag" / "bag_0.mcap"), expected)
    (tmp_path / "run" / "bag" / "metadata.yaml").unlink()
    without = load_recording(tmp_path / "run")
    same(without, expected)
    assert any("metadata.yaml is missing" in note for note in without.notes)
    (tmp_path / "run" / "bag" / "metadata.yaml").write_text("a: [")
    same(load_recording(tmp_path / "run" / "bag"), expected)


def test_truth_is_never_read(drive, tmp_path):
    write_drive(tmp_path / "bag", seconds=6, truth=False)
    with_truth, without = load_recording(drive), load_recording(tmp_path / "bag")
    same(with_truth, without)


def test_an_option_places_the_laser(drive):
    T = SE2.from_xyt(0.1, 0.2, 0.3)
    assert load_recording(drive, T_base_lidar=T).T_base_lidar is T


@pytest.mark.parametrize(
    ("links", "known"),
    [
        ([], "base_footprint, odom"),
        ([("base_footprint", "laser")], "base_footprint, laser, odom"),
        (
            [("base_footprint", "base_link"), ("mast", "base_scan")],
            "base_footprint, base_link, base_scan, mast, odom",
        ),
    ],
    ids=["no static transforms", "another frame", "two trees"],
)
def test_scans_in_a_frame_that_nothing_connects_to_the_robot_say_so_and_what_to_do(tmp_path, links, known):
    sits = (-0.032, 0.0, 0.172), (0.0, 0.0, 0.0, 1.0)
    messages = [("/tf_static", TF, 0, tf(transform(0, *link, *sits))) for link in links]
    for k in range(10):
        messages.append(("/odom", ODOMETRY, k * 10**8, odometry(k * 10**8, 0.01 * k)))
        link = transform(k * 10**8, "odom", "base_footprint", (0.01 * k, 0, 0), (0, 0, 0, 1))
        messages.append(("/tf", TF, k * 10**8, tf(link)))
        messages.append(("/scan", SCAN, k * 10**8, laser_scan(k * 10**8, np.ones(360))))
    bag = write_foreign(tmp_path / "bag", messages)
    recording = load_recording(bag)
    (note,) = (note for note in recording.notes if "no fixed transform" in note)
    assert note.startswith("/scan: no fixed transform base_footprint -> base_scan ")
    assert f"frames in /tf and /tf_static: {known})" in note
    assert "--laser X,Y,YAW" in note
    assert recording.T_base_lidar.xyt.tolist() == [0.0, 0.0, 0.0]
    placed = load_recording(bag, T_base_lidar=SE2.from_xyt(-0.032, 0.0, 0.0))
    assert not any("no fixed transform" in note for note in placed.notes)
    assert any("--laser" in finding.remedy for finding in examine(bag))


def test_single_streams(drive):
    stamps, v, w = read_commands(drive)
    assert stamps.tolist() == [stamp(step) for step in range(180)]
    assert set(v) == {0.2}
    assert set(w) == {0.1}
    truth = read_poses(drive, "/ground_truth/odom")
    np.testing.assert_allclose(truth.poses.xyt, [pose(step).xyt for step in range(1, 181)], atol=1e-12)
    estimate = read_poses(drive, "/amcl_pose")
    assert estimate.stamps_ns.tolist() == [stamp(step) for step in range(30, 181, 30)]
    batch = [[0.0, 0.0, 0.0], [1.0, 0.5, 1.0], [2.0, 1.0, -3.0]]
    stream = read_particles(drive)
    assert [time for time, _ in stream] == [stamp(step) for step in range(30, 181, 30)]
    np.testing.assert_allclose(stream[0][1].xyt, batch, atol=1e-12)


def test_info_counts_rates_and_gaps(drive):
    info = bag_info(drive)
    topics = {topic.name: topic for topic in info.topics}
    assert topics["/scan"].count == 30
    assert topics["/scan"].rate_hz() == pytest.approx(5.0)
    assert topics["/odom"].longest_gap_ns == pytest.approx(1e9 / 30, abs=1)
    assert info.duration() == pytest.approx(6.0)
    assert info.count == sum(topic.count for topic in info.topics)


@pytest.mark.parametrize("storage", [StoragePlugin.MCAP, StoragePlugin.SQLITE3])
def test_odometry_and_laser_pose_from_tf(tmp_path, storage):
    half = math.sin(math.pi / 4), math.cos(math.pi / 4)
    messages = [
        ("/tf_static", TF, 0, tf(transform(0, "base_link", "laser", (0.1, 0.0, 0.2), (0, 0, *half)))),
        ("/tf_static", TF, 1, tf(transform(0, "base_footprint", "base_link", (0, 0, 0.01), (0, 0, 0, 1)))),
    ]
    for k in range(11):
        time = k * 100_000_000
        link = transform(time, "odom", "base_footprint", (0.1 * k, 0, 0), (0, 0, 0, 1))
        messages.append(("/tf", TF, time, tf(link)))
        if k % 2:
            messages.append(("/lidar/scan", SCAN, time, laser_scan(time + 50_000_000, np.ones(360), "laser")))
    recording = load_recording(write_foreign(tmp_path / "bag", messages, storage))
    np.testing.assert_allclose(recording.T_base_lidar.xyt, [0.1, 0.0, math.pi / 2], atol=1e-12)
    np.testing.assert_allclose(recording.T_odom_base.x, [0.15, 0.35, 0.55, 0.75, 0.95])
    assert any("odometry from /tf" in note for note in recording.notes)
    if storage == StoragePlugin.SQLITE3:
        same(load_recording(next((tmp_path / "bag").glob("*.db3"))), recording)


@pytest.mark.parametrize("length", [0.2, 1.0, 3.0])
def test_a_quaternion_s_length_does_not_matter(length):
    for yaw in np.linspace(-3.1, 3.1, 9):
        tilted = np.array(
            [0.1 * math.sin(yaw / 2), 0.1 * math.cos(yaw / 2), math.sin(yaw / 2), math.cos(yaw / 2)]
        )
        x, y, z, w = tilted
        plain = math.atan2(
            2.0 * (w * z + x * y) / (tilted @ tilted), 1.0 - 2.0 * (y * y + z * z) / (tilted @ tilted)
        )
        assert yaw_of(length * tilted) == pytest.approx(plain)
        assert yaw_of([0.0, 0.0, length * z, length * w]) == pytest.approx(yaw)


def test_readings_are_normalised(tmp_path):
    ranges = np.array([0.0, 0.05, 1.0, 3.5, 4.0, np.inf, -np.inf, np.nan])
    recording = load_recording(write_foreign(tmp_path / "bag", [("/scan", SCAN, 0, laser_scan(0, ranges))]))
    expected = [np.nan, -np.inf, 1.0, np.inf, np.inf, np.inf, -np.inf, np.nan]
    np.testing.assert_array_equal(recording.ranges[0], np.array(expected, dtype=np.float32))


def test_two_clocks_are_joined_by_the_recorder_s(tmp_path):
    wall = 1_700_000_000 * 10**9
    messages = []
    for k in range(10):
        time = wall + k * 10**8
        messages.append(("/odom", ODOMETRY, time, odometry(k * 10**8, 0.1 * k)))
        messages.append(("/scan", SCAN, time, laser_scan(time, np.ones(360))))
    recording = load_recording(write_foreign(tmp_path / "bag", messages))
    np.testing.assert_allclose(recording.T_odom_base.x, 0.1 * np.arange(10))
    assert any("different clocks" in note for note in recording.notes)


def test_ros1_bag(drive, tmp_path):
    """The same drive in ROS 1's own layout."""
    store1 = get_typestore(Stores.ROS1_NOETIC)
    recording = load_recording(drive)
    types = store1.types
    path = tmp_path / "drive.bag"
    with Writer1(path) as writer:
        scan_connection = writer.add_connection("/scan", SCAN, typestore=store1)
        odom_connection = writer.add_connection("/odom", ODOMETRY, typestore=store1)
        for step in range(1, 181):
            sample = observation(step)
            message = odometry(sample.stamp_ns, 0.0)
            message.header = header(sample.stamp_ns, "/odom", types, seq=step)
            x, y, yaw = sample.odometry.T_odom_base.xyt.tolist()
            message.pose.pose.position.x, message.pose.pose.position.y = x, y
            message.pose.pose.orientation.z = math.sin(yaw / 2)
            message.pose.pose.orientation.w = math.cos(yaw / 2)
            raw = store1.serialize_ros1(message, ODOMETRY)
            writer.write(odom_connection, sample.stamp_ns, bytes(raw))
            if sample.scan is not None:
                scan = laser_scan(sample.scan.stamp_ns, sample.scan.ranges)
                scan.header = header(sample.scan.stamp_ns, "/base_scan", types, seq=step)
                raw = store1.serialize_ros1(scan, SCAN)
                writer.write(scan_connection, sample.stamp_ns, bytes(raw))
    same(load_recording(path, T_base_lidar=recording.T_base_lidar), recording)


@pytest.mark.parametrize("mode", [CompressionMode.FILE, CompressionMode.MESSAGE])
@pytest.mark.parametrize("storage", [StoragePlugin.MCAP, StoragePlugin.SQLITE3])
def test_compressed_rosbag2_folders(tmp_path, storage, mode):
    rng = np.random.default_rng(0)
    scans = [laser_scan(k * 10**8, rng.uniform(1, 3, 360)) for k in range(20)]
    writer = Writer2(tmp_path / "bag", version=9, storage_plugin=storage)
    writer.set_compression(mode, CompressionFormat.ZSTD)
    with writer:
        connection = writer.add_connection("/scan", SCAN, typestore=STORE)
        for k, scan in enumerate(scans):
            writer.write(connection, k * 10**8, bytes(STORE.serialize_cdr(scan, SCAN)))
    recording = load_recording(tmp_path / "bag")
    np.testing.assert_array_equal(recording.ranges, [scan.ranges for scan in scans])


def test_a_split_bag_is_read_in_order(drive, tmp_path):
    folder = tmp_path / "bag"
    write_drive(folder, seconds=3)
    (folder / "bag_0.mcap").rename(folder / "bag_10.mcap")
    shutil.copy(drive / "bag_0.mcap", folder / "bag_9.mcap")
    text = (folder / "metadata.yaml").read_text()
    text = text.replace(
        "relative_file_paths:\n  - bag_0.mcap", "relative_file_paths:\n  - bag_9.mcap\n  - bag_10.mcap"
    )
    (folder / "metadata.yaml").write_text(text)
    expected = [*load_recording(drive).stamps_ns, *load_recording(folder / "bag_10.mcap").stamps_ns]
    assert load_recording(folder).stamps_ns.tolist() == expected
    (folder / "metadata.yaml").unlink()
    assert load_recording(folder).stamps_ns.tolist() == expected


def test_topics_of_unknown_types_are_named_and_harmless(drive, tmp_path):
    with BagFolder(tmp_path / "bag", custom={}) as bag:
        sensors = bag.add_topic("/sensor_state", "turtlebot3_msgs/msg/SensorState", "uint8 bumper")
        bag.write(sensors, 0, b"\x00\x01\x00\x00\x01")
        copier = into_mcap(bag)
        for message in open_bag(drive).messages():
            copier.write(message)
    recording = load_recording(tmp_path / "bag")
    same(recording, load_recording(drive))
    note = "topics of unknown types: /sensor_state (turtlebot3_msgs/msg/SensorState); skipped"
    assert recording.notes == (note,)


def test_metadata_that_may_not_be_read_is_one_line_and_nothing_is_tried_beside_it(tmp_path, monkeypatch):
    folder = tmp_path / "bag"
    write_drive(folder, seconds=1)
    read_text = Path.read_text

    def refuse(path, *args, **kwargs):
        if path.name == "metadata.yaml":
            raise PermissionError(13, "Permission denied", str(path))
        return read_text(path, *args, **kwargs)

    monkeypatch.setattr(Path, "read_text", refuse)
    with pytest.raises(InputError, match=r"metadata.yaml: cannot be read \(Permission denied\)$"):
        load_recording(tmp_path)


@pytest.mark.parametrize(("gap_s", "noted"), [(0.4, False), (0.6, True), (1.1, True)])
def test_odometry_that_pauses_is_named(tmp_path, gap_s, noted):
    times = [*range(0, 10**9, 10**8), *range(9 * 10**8 + round(gap_s * 1e9), 4 * 10**9, 10**8)]
    over = transform(0, "base_footprint", "base_scan", (0, 0, 0.2), (0, 0, 0, 1))
    messages = [("/tf_static", TF, 0, tf(over))]
    messages += [("/odom", ODOMETRY, t, odometry(t, t * 1e-9)) for t in times]
    messages += [("/scan", SCAN, t, laser_scan(t, np.full(360, 1.0))) for t in (10**9, 3 * 10**9)]
    recording = load_recording(write_foreign(tmp_path / "bag", messages))
    assert any(f"/odom: 1 gap, the longest {gap_s:.2f} s" in note for note in recording.notes) == noted


def test_every_damaged_message_is_counted_once(tmp_path):
    messages = [
        ("/tf_static", TF, 0, tf(transform(0, "base_footprint", "base_scan", (0, 0, 0.2), (0, 0, 0, 1)))),
        *[("/scan", SCAN, t, laser_scan(t, np.full(360, 1.0))) for t in (10**9, 2 * 10**9)],
    ]
    folder = write_foreign(tmp_path / "bag", messages)
    with Writer2(tmp_path / "damaged", version=9, storage_plugin=StoragePlugin.MCAP) as writer:
        channels = {}
        for topic, msgtype, time, message in messages:
            channels[topic] = channels.get(topic) or writer.add_connection(topic, msgtype, typestore=STORE)
            writer.write(channels[topic], time, bytes(STORE.serialize_cdr(message, msgtype)))
        for topic, count in (("/tf_static", 3), ("/scan", 2)):
            for k in range(count):
                writer.write(channels[topic], 3 * 10**9 + k, b"\0\1\0\0\xff\xff\xff\xff")
    assert not any("damaged" in note for note in load_recording(folder).notes)
    assert {str(finding) for finding in load_recording(tmp_path / "damaged").findings} == {
        "/scan: 2 of 4 messages cannot be decoded; skipped",
        "/tf_static: 3 of 4 messages cannot be decoded; skipped",
        *load_recording(folder).notes,
    }
