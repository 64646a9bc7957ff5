"""ROS 1 bags read front to back: as rosbags reads them, and as far as possible when truncated."""

import struct

import pytest
from rosbags.rosbag1 import Reader, Writer

from tests.helpers.bag_samples import write_drive
from tests.helpers.ros1_bags import to_ros1_bag
from turtlebag.datasets.bags.doctor import examine
from turtlebag.datasets.bags.recover import recover
from turtlebag.datasets.bags.source import open_bag
from turtlebag.datasets.recordings import load_recording


@pytest.fixture(scope="module")
def plain(tmp_path_factory):
    folder = tmp_path_factory.mktemp("ros1")
    write_drive(folder / "bag", seconds=12, navigation=True)
    to_ros1_bag(folder / "bag", folder / "a.bag")
    return folder / "a.bag"


def contents(path, **options):
    return [(m.topic.name, m.log_time_ns, m.data) for m in open_bag(path).messages(**options)]


def compressed(plain, path, compression):
    writer = Writer(path)
    if compression:
        writer.set_compression(compression)
    writer.chunk_threshold = 100_000
    with Reader(plain) as reader, writer:
        connections = {
            c.id: writer.add_connection(
                c.topic, c.msgtype, msgdef=c.msgdef.data, md5sum=c.digest, latching=c.ext.latching
            )
            for c in reader.connections
        }
        for connection, time, data in reader.messages():
            writer.write(connections[connection.id], time, data)
    return path


FORMATS = [None, *Writer.CompressionFormat]


def test_the_doctor_finds_nothing_wrong_with_a_good_one(plain):
    assert examine(plain) == []


@pytest.mark.slow
@pytest.mark.parametrize("compression", FORMATS)
def test_the_same_messages_as_rosbags_reads(plain, tmp_path, compression):
    path = compressed(plain, tmp_path / "b.bag", compression)
    with Reader(path) as reader:
        expected = [(c.topic, time, bytes(data)) for c, time, data in reader.messages()]
    assert sorted(contents(path)) == sorted(expected)
    assert open_bag(path).notes == []


@pytest.mark.slow
def test_a_cut_bag_gives_what_is_there_and_says_so(plain, tmp_path):
    path = compressed(plain, tmp_path / "b.bag", None)
    whole, content = contents(path), path.read_bytes()
    for share in (0.3, 0.6, 0.9):
        path.write_bytes(content[: int(share * len(content))])
        bag = open_bag(path)
        got = [(m.topic.name, m.log_time_ns, m.data) for m in bag.messages()]
        assert got == whole[: len(got)]
        assert len(got) > (share - 0.1) * len(whole)
        assert "b.bag: damaged at byte" in bag.notes[0]
    assert load_recording(path).ranges.shape[1] == 360
    assert "damaged file" in {finding.kind for finding in examine(path)}


@pytest.mark.slow
def test_an_active_bag_without_an_index_is_read_and_recovered(plain, tmp_path):
    content = bytearray(plain.read_bytes())
    place = content.index(b"index_pos=") + len(b"index_pos=")
    (end,) = struct.unpack_from("<Q", content, place)
    content[place : place + 8] = bytes(8)
    path = tmp_path / "run.bag.active"
    path.write_bytes(content[:end])
    bag = open_bag(path)
    assert [(m.topic.name, m.log_time_ns, m.data) for m in bag.messages()] == contents(plain)
    assert "no index" in bag.notes[0]
    recover(path, tmp_path / "saved")
    a, b = load_recording(plain), load_recording(tmp_path / "saved")
    assert a.stamps_ns.tolist() == b.stamps_ns.tolist()


@pytest.mark.slow
@pytest.mark.parametrize("compression", FORMATS)
def test_recovery_steps_over_a_damaged_chunk(plain, tmp_path, compression):
    path = compressed(plain, tmp_path / "b.bag", compression)
    whole, content = contents(path), bytearray(path.read_bytes())
    third = [place for place in range(len(content)) if content.startswith(b"compression=", place)][2]
    content[third + 1] ^= 0xFF
    path.write_bytes(content)
    saved = contents(path, step_over=True)
    assert len(contents(path)) < len(saved) < len(whole)
    assert set(saved) <= set(whole)
    assert saved[-1] == whole[-1]


def test_the_span_of_a_recovered_bag_is_that_of_the_messages_in_it(tmp_path):
    path = tmp_path / "b.bag"
    with Writer(path) as writer:
        known, other = (
            writer.add_connection(name, "std_msgs/msg/UInt8", msgdef="uint8 data\n", md5sum="0" * 32)
            for name in ("/known", "/other")
        )
        for stamp in (5, 6):
            writer.write(known, stamp * 10**9, b"\x01")
        writer.write(other, 9 * 10**9, b"")
    saved = recover(path, tmp_path / "saved")
    assert (saved.messages, saved.start_ns, saved.end_ns) == (2, 5 * 10**9, 6 * 10**9)
    assert "/other: 1 damaged messages left out" in saved.notes
