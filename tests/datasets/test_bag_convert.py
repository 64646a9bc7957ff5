"""Conversions keep every message."""

import bz2
from pathlib import Path

import numpy as np
import pytest
from rosbags.highlevel import AnyReader
from rosbags.rosbag1 import Writer as Writer1

from tests.helpers.ros1_bags import to_ros1_bag
from turtlebag.datasets.bags.convert import carmen_to_mcap, to_mcap, to_sqlite3
from turtlebag.datasets.bags.copying import into_mcap
from turtlebag.datasets.bags.folder import BagFolder
from turtlebag.datasets.bags.source import open_bag
from turtlebag.datasets.recordings import load_recording

RADISH = Path(__file__).parents[3] / "shared" / "data" / "radish"


def contents(path):
    """Every message, ordered by what a reader can rely on."""
    return sorted((m.topic.name, m.log_time_ns, m.topic.msgtype, m.data) for m in open_bag(path).messages())


@pytest.mark.slow
def test_ros1_and_back_keeps_every_byte(drive, tmp_path):
    to_ros1_bag(drive, tmp_path / "a.bag")
    count, notes = to_mcap(tmp_path / "a.bag", tmp_path / "back")
    expected = contents(drive)
    assert (count, notes) == (len(expected), [])
    assert contents(tmp_path / "back") == expected


@pytest.mark.slow
def test_sqlite3_and_back_keeps_every_byte(drive, tmp_path):
    to_sqlite3(drive, tmp_path / "a")
    to_mcap(tmp_path / "a", tmp_path / "back")
    assert contents(tmp_path / "a") == contents(drive) == contents(tmp_path / "back")


@pytest.mark.slow
def test_others_read_the_converted_bag(drive, tmp_path):
    to_sqlite3(drive, tmp_path / "a")
    with AnyReader([tmp_path / "a"]) as reader:
        assert reader.message_count == len(contents(drive))
        scans = [c for c in reader.connections if c.topic == "/scan"]
        _, _, raw = next(reader.messages(scans))
        scan = reader.deserialize(raw, scans[0].msgtype)
    np.testing.assert_array_equal(scan.ranges, load_recording(drive).ranges[0])


def test_latching_and_quality_of_service_survive(drive, tmp_path):
    to_mcap(drive, tmp_path / "copy")
    a, b = ((folder / "metadata.yaml").read_text() for folder in (drive, tmp_path / "copy"))
    assert a == b
    assert "seed: '7'" in b
    to_sqlite3(drive, tmp_path / "a")
    assert open_bag(tmp_path / "a").custom_data() == {"seed": "7"}


@pytest.mark.slow
def test_recordings_of_all_kinds_are_the_same(drive, tmp_path):
    to_ros1_bag(drive, tmp_path / "a.bag")
    to_sqlite3(drive, tmp_path / "a")
    packed = tmp_path / "a.bag.bz2"
    packed.write_bytes(bz2.compress((tmp_path / "a.bag").read_bytes()))
    expected = load_recording(drive)
    for path in (tmp_path / "a.bag", tmp_path / "a", packed):
        recording = load_recording(path)
        np.testing.assert_array_equal(recording.ranges, expected.ranges)
        np.testing.assert_array_equal(recording.T_odom_base.xyt, expected.T_odom_base.xyt)
        np.testing.assert_array_equal(recording.T_base_lidar.xyt, expected.T_base_lidar.xyt)
        assert recording.stamps_ns.tolist() == expected.stamps_ns.tolist()


@pytest.mark.slow
@pytest.mark.skipif(not RADISH.is_dir(), reason="the public logs are not beside the repository")
def test_a_carmen_log_is_the_same_recording_as_a_bag(tmp_path):
    log = load_recording(RADISH / "fr079.clf.bz2")
    carmen_to_mcap(log, tmp_path / "bag")
    bag = load_recording(tmp_path / "bag")
    np.testing.assert_array_equal(bag.ranges, log.ranges)
    assert bag.stamps_ns.tolist() == log.stamps_ns.tolist()
    np.testing.assert_allclose(bag.T_odom_base.xyt, log.T_odom_base.xyt, atol=1e-12)
    np.testing.assert_allclose(bag.T_base_lidar.xyt, log.T_base_lidar.xyt)
    np.testing.assert_allclose(bag.lidar.angles, log.lidar.angles, atol=1e-6)


@pytest.mark.slow
@pytest.mark.parametrize("convert", [to_mcap, to_sqlite3])
def test_the_files_of_a_split_bag_share_their_topics(drive, tmp_path, convert):
    folder = tmp_path / "bag"
    folder.mkdir()
    for index in range(2):
        (folder / f"bag_{index}.mcap").write_bytes((drive / "bag_0.mcap").read_bytes())
    count, _ = convert(folder, tmp_path / "out")
    assert count == 2 * len(contents(drive))
    with AnyReader([tmp_path / "out"]) as reader:
        names = [connection.topic for connection in reader.connections]
        assert len(names) == len(set(names))
        assert reader.message_count == count


def defined(text):
    """A message definition of ROS 1."""
    return {"msgdef": text, "md5sum": "0" * 32}


def test_what_cannot_be_translated_is_left_out_and_named(tmp_path):
    with Writer1(tmp_path / "a.bag") as writer:
        good = writer.add_connection("/good", "std_msgs/msg/UInt8", **defined("uint8 data\n"))
        short = writer.add_connection("/short", "std_msgs/msg/UInt32", **defined("uint32 data\n"))
        strange = writer.add_connection("/strange", "my_msgs/msg/Strange", **defined("Missing x\n"))
        for connection, data in ((good, b"\1"), (short, b"\1"), (strange, b"")):
            writer.write(connection, 10**9, data)
    for convert in (to_mcap, to_sqlite3):
        count, notes = convert(tmp_path / "a.bag", tmp_path / convert.__name__)
        assert count == 1
        assert "/short: 1 damaged messages left out" in notes
        assert any("skipped /strange" in note for note in notes)


def test_sqlite3_holds_cdr_alone(drive, tmp_path):
    with BagFolder(tmp_path / "bag", custom={}) as bag:
        copier = into_mcap(bag)
        for message in open_bag(drive).messages():
            copier.write(message)
        json = bag.add_topic("/json", "Thing", "{}", form="jsonschema", encoding="json")
        bag.write(json, 3, b"{}")
    count, notes = to_sqlite3(tmp_path / "bag", tmp_path / "a")
    assert count == len(contents(drive))
    assert [note for note in notes if "/json" in note]
