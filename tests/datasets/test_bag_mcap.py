"""MCAP files of the official writer with all its options, and ours."""

import pytest
import yaml
from mcap.opcode import Opcode
from mcap.reader import make_reader
from mcap.writer import CompressionType, Writer

from turtlebag.datasets.bags.convert import to_mcap
from turtlebag.datasets.bags.folder import CHUNK_BYTES, BagFolder
from turtlebag.datasets.bags.mcap_index import HEAD, MAGIC
from turtlebag.datasets.bags.mcap_sequential import McapReader
from turtlebag.datasets.bags.source import open_bag
from turtlebag.datasets.errors import InputError
from turtlebag.datasets.recordings import load_recording


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
    scan = McapReader(rewritten(drive, tmp_path / "a.mcap"))
    count = sum(1 for _ in scan.messages())
    assert scan.state.complete
    assert scan.state.claimed == scan.state.messages == count
    assert scan.state.metadata == {"who": {"name": "somebody"}}


def test_messages_may_be_empty_and_times_unordered(tmp_path):
    times = [5_000_000_000, 1, 2**62, 7]
    with BagFolder(tmp_path / "a", custom={}) as bag:
        channel = bag.add_topic("/a", "std_msgs/msg/Empty", "")
        for time in times:
            bag.write(channel, time, b"")
        for never in (-1, 2**64):
            with pytest.raises(ValueError, match="not a valid message time"):
                bag.write(channel, never, b"")
    scan = McapReader(tmp_path / "a" / "bag_0.mcap")
    assert [time for _, time, _ in scan.messages()] == times
    assert scan.state.problems == []
    information = yaml.safe_load((tmp_path / "a/metadata.yaml").read_text())["rosbag2_bagfile_information"]
    assert information["starting_time"] == {"nanoseconds_since_epoch": 1}
    assert information["duration"] == {"nanoseconds": 2**62 - 1}


def test_a_bag_without_messages_is_whole(tmp_path):
    BagFolder(tmp_path / "a", custom={}).close()
    scan = McapReader(tmp_path / "a" / "bag_0.mcap")
    assert list(scan.messages()) == []
    assert scan.state.complete
    assert scan.state.problems == []


def chunks_of(path):
    with path.open("rb") as file:
        return len(make_reader(file).get_summary().chunk_indexes)


@pytest.mark.parametrize(
    ("writes", "chunks"),
    [
        pytest.param([(k, bytes(CHUNK_BYTES // 4)) for k in range(9)], 3, id="full"),
        pytest.param([(k * 10**8, b"") for k in range(25)], 3, id="a second"),
        pytest.param([(10**10, b""), (10**10 - 10**9, b""), (10**10, b"")], 2, id="a second back"),
        pytest.param([(10**10, b""), (10**10 - 10**9 + 1, b""), (10**10, b"")], 1, id="less than that"),
    ],
)
def test_a_chunk_is_closed_when_it_is_full_or_spans_a_second(tmp_path, writes, chunks):
    with BagFolder(tmp_path / "a", custom={}) as bag:
        channel = bag.add_topic("/a", "A", "")
        for time, data in writes:
            bag.write(channel, time, data)
    assert chunks_of(tmp_path / "a" / "bag_0.mcap") == chunks


def test_what_an_error_leaves_is_a_whole_bag_of_what_was_written(tmp_path):
    told = [(k * 10**8, bytes([k])) for k in range(25)]
    with pytest.raises(RuntimeError), BagFolder(tmp_path / "a", custom={"seed": "3"}) as bag:  # noqa: PT012
        channel = bag.add_topic("/a", "A", "")
        for time, data in told:
            bag.write(channel, time, data)
        raise RuntimeError
    scan = McapReader(tmp_path / "a" / "bag_0.mcap")
    assert [(time, data) for _, time, data in scan.messages()] == told
    assert scan.state.complete
    assert scan.state.problems == []
    assert (tmp_path / "a" / "metadata.yaml").is_file()
    with pytest.raises(InputError, match="already holds a bag"):
        BagFolder(tmp_path / "a", custom={})


def test_a_message_shorter_than_its_own_head_is_damage(tmp_path):
    path = tmp_path / "a.mcap"
    path.write_bytes(MAGIC + HEAD.pack(Opcode.MESSAGE, 4) + b"\0\0\0\0")
    scan = McapReader(path)
    assert list(scan.messages()) == []
    assert scan.state.problems[0].startswith("damaged at byte 8")
