"""MCAP files as the official writer makes them, in all its ways, and ours as it would."""

import struct

import pytest
from mcap.writer import CompressionType, Writer

from tests.helpers.bag_samples import write_drive
from turtlebag.datasets.bags.convert import to_mcap
from turtlebag.datasets.bags.mcap import MAGIC, MESSAGE, McapWriter
from turtlebag.datasets.bags.mcap_scan import McapScan
from turtlebag.datasets.bags.source import open_bag
from turtlebag.datasets.errors import InputError
from turtlebag.datasets.recordings import load_recording


@pytest.fixture(scope="module")
def drive(tmp_path_factory):
    folder = tmp_path_factory.mktemp("drive") / "bag"
    write_drive(folder, seconds=3)
    return folder


def rewritten(drive, path, **options):
    """The drive in the official writer's hand, with things in it that are not ours."""
    with path.open("wb") as file:
        writer = Writer(file, **options)
        writer.start("ros2", "other")
        json_schema = writer.register_schema("Thing", "jsonschema", b"{}")
        other = writer.register_channel("/thing", "json", json_schema)
        channels = {}
        for count, message in enumerate(open_bag(drive).messages()):
            topic = message.topic
            if topic.name not in channels:
                schema = writer.register_schema(topic.msgtype, "ros2msg", topic.definition.encode())
                channels[topic.name] = writer.register_channel(topic.name, "cdr", schema)
            writer.add_message(channels[topic.name], message.log_time_ns, message.data, message.log_time_ns)
            if count == 100:
                writer.add_attachment(0, 0, "note.txt", "text/plain", b"hello")
                writer.add_metadata("who", {"name": "somebody"})
                writer.add_message(other, message.log_time_ns, b"{}", message.log_time_ns)
        writer.finish()
    return path


@pytest.mark.slow
@pytest.mark.parametrize("chunking", [True, False])
@pytest.mark.parametrize("compression", [CompressionType.NONE, CompressionType.LZ4, CompressionType.ZSTD])
def test_files_of_the_official_writer(drive, tmp_path, chunking, compression):
    options = {"use_chunking": chunking, "compression": compression, "chunk_size": 50_000}
    path = rewritten(drive, tmp_path / "a.mcap", enable_data_crcs=True, **options)
    bag = open_bag(path)
    found = [(m.topic.name, m.log_time_ns, m.data) for m in bag.messages()]
    expected = [(m.topic.name, m.log_time_ns, m.data) for m in open_bag(drive).messages()]
    assert [message for message in found if message[0] != "/thing"] == expected
    assert bag.notes == []
    assert load_recording(path).stamps_ns.tolist() == load_recording(drive).stamps_ns.tolist()
    to_mcap(path, tmp_path / "copy")
    copied = [(m.topic.name, m.data, m.topic.encoding) for m in open_bag(tmp_path / "copy").messages()]
    assert ("/thing", b"{}", "json") in copied
    assert len(copied) == len(found)


def test_metadata_and_state_of_a_whole_file(drive, tmp_path):
    scan = McapScan(rewritten(drive, tmp_path / "a.mcap"))
    count = sum(1 for _ in scan.messages())
    assert scan.state.complete
    assert scan.state.claimed == scan.state.messages == count
    assert scan.state.metadata == {"who": {"name": "somebody"}}


def test_messages_may_be_empty_and_times_unordered(tmp_path):
    writer = McapWriter(tmp_path / "a.mcap")
    channel = writer.add_channel("/a", writer.add_schema("std_msgs/msg/Empty", ""), {})
    times = [5_000_000_000, 1, 2**62, 7]
    for time in times:
        writer.write(channel, time, b"")
    writer.close()
    scan = McapScan(tmp_path / "a.mcap")
    assert [time for _, time, _ in scan.messages()] == times
    assert scan.state.problems == []
    assert writer.span_ns == (1, 2**62)


def test_a_bag_without_messages_is_whole(tmp_path):
    McapWriter(tmp_path / "a.mcap").close()
    scan = McapScan(tmp_path / "a.mcap")
    assert list(scan.messages()) == []
    assert scan.state.complete
    assert scan.state.problems == []
    with pytest.raises(InputError, match="no /scan"):
        load_recording(tmp_path / "a.mcap")


def test_unknown_compression_is_refused(tmp_path):
    with pytest.raises(ValueError, match="compression"):
        McapWriter(tmp_path / "a.mcap", compression="lz5")


def test_a_message_shorter_than_its_own_head_is_damage(tmp_path):
    path = tmp_path / "a.mcap"
    path.write_bytes(MAGIC + struct.pack("<BQ", MESSAGE, 4) + b"\0\0\0\0")
    scan = McapScan(path)
    assert list(scan.messages()) == []
    assert scan.state.problems[0].startswith("damaged at byte 8")
