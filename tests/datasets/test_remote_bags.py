"""Remote bags: of an mcap only the needed byte ranges, everything else as a whole."""

import shutil
import struct

import fsspec
import numpy as np
import pytest
from fsspec.implementations.memory import MemoryFileSystem
from mcap.opcode import Opcode
from mcap.writer import Writer

from tests.helpers.bag_samples import write_drive
from turtlebag.datasets.bags.mcap_index import HEAD, MAGIC, TAIL
from turtlebag.datasets.bags.mcap_ranges import partial_mcap
from turtlebag.datasets.bags.mcap_sequential import McapReader
from turtlebag.datasets.bags.remote import brought
from turtlebag.datasets.errors import InputError
from turtlebag.datasets.recordings import load_recording

PICTURE = 300_000
DEFINITION = b"# as long as the index of a large file\n" * 7000


@pytest.fixture
def memory():
    """An empty file system in memory; `read` counts the bytes that are asked of it."""
    files = fsspec.filesystem("memory")
    files.store.clear()
    files.pseudo_dirs[:] = [""]
    yield files
    files.store.clear()


@pytest.fixture
def read(monkeypatch):
    """Every range that is read of a file in memory."""
    ranges = []
    cat_file = MemoryFileSystem.cat_file

    def counted(files, path, start=None, end=None, **kwargs):
        content = cat_file(files, path, start=start, end=end, **kwargs)
        ranges.append(len(content))
        return content

    monkeypatch.setattr(MemoryFileSystem, "cat_file", counted)
    return ranges


def with_pictures(folder, *, pictures=20):
    """A drive's mcap with a camera's chunks among those of the lidar; its path."""
    write_drive(folder / "drive", seconds=4.0)
    path = folder / "seen.mcap"
    rng = np.random.default_rng(1)
    channels = {}
    with path.open("wb") as file:
        writer = Writer(file)
        writer.start("ros2")
        for count, (channel, time, data) in enumerate(McapReader(folder / "drive/bag_0.mcap").messages()):
            if channel.name not in channels:
                schema = writer.register_schema(channel.msgtype, "ros2msg", channel.definition.encode())
                qos = {"offered_qos_profiles": channel.qos, "topic_type_hash": channel.type_hash}
                channels[channel.name] = writer.register_channel(channel.name, "cdr", schema, qos)
            writer.add_message(channels[channel.name], time, data, time)
            if count == 0:
                schema = writer.register_schema("sensor_msgs/msg/Image", "ros2msg", DEFINITION)
                camera = writer.register_channel("/camera", "cdr", schema)
            if count % 40 == 0 and count // 40 < pictures:
                writer.flush()
                writer.add_message(camera, time, rng.bytes(PICTURE), time)
                writer.flush()
        writer.finish()
    return path


def test_an_mcap_comes_by_ranges_and_maps_as_the_whole_one(tmp_path, memory, read):
    path = with_pictures(tmp_path)
    assert len(DEFINITION) > TAIL
    memory.put_file(str(path), "/bags/seen.mcap")
    here = brought("memory://bags/seen.mcap", tmp_path / "here")
    assert sum(read) < path.stat().st_size / 4
    assert here.stat().st_size < path.stat().st_size / 4
    part, whole = load_recording(here), load_recording(path)
    assert part.notes == whole.notes
    for name in ("stamps_ns", "ranges"):
        assert np.array_equal(getattr(part, name), getattr(whole, name), equal_nan=True)
    assert np.array_equal(part.T_odom_base.xyt, whole.T_odom_base.xyt)


def backwards(content):
    """The file with the chunks of its index in reverse order, and without a checksum of the index."""
    footer = len(content) - len(MAGIC) - 20
    (start,) = struct.unpack_from("<Q", content, footer)
    at, chunks, others = start, [], []
    while at < footer - HEAD.size:
        opcode, size = HEAD.unpack_from(content, at)
        (chunks if opcode == Opcode.CHUNK_INDEX else others).append(content[at : at + HEAD.size + size])
        at += HEAD.size + size
    assert len(chunks) > 2
    index = b"".join([*others, *reversed(chunks)])
    return content[:start] + index + content[footer - HEAD.size : footer + 16] + bytes(4) + MAGIC


def test_the_pieces_come_in_the_file_s_order_whatever_that_of_the_index(tmp_path):
    content = with_pictures(tmp_path, pictures=2).read_bytes()

    def pieces(content):
        return b"".join(partial_mcap(lambda start, end: content[start:end], len(content), list))

    assert pieces(backwards(content)) == pieces(content)


@pytest.mark.parametrize("at", [-1, -40, -2000])
def test_an_mcap_with_a_damaged_index_comes_whole(tmp_path, memory, at):
    content = bytearray(with_pictures(tmp_path, pictures=2).read_bytes())
    content[at] ^= 1
    memory.pipe_file("/bags/bad.mcap", bytes(content))
    assert brought("memory://bags/bad.mcap", tmp_path / "here").read_bytes() == bytes(content)


@pytest.mark.parametrize("folder", ["drive", "drive/bag"])
def test_a_folder_comes_with_its_metadata_and_storage_files(tmp_path, memory, folder):
    write_drive(tmp_path / "drive/bag", seconds=1.0)
    (tmp_path / "drive/bag/notes.txt").write_text("not of the bag")
    memory.put(str(tmp_path / folder), "/runs/drive", recursive=True)
    here = brought("memory://runs/drive", tmp_path / "here")
    assert {path.name for path in here.iterdir()} == {"bag_0.mcap", "metadata.yaml"}
    assert len(load_recording(here)) == len(load_recording(tmp_path / "drive"))


def test_other_files_come_whole_and_what_is_here_stays_where_it_is(tmp_path, memory):
    memory.pipe_file("/logs/a.clf", b"a log")
    assert brought("memory://logs/a.clf", tmp_path / "here").read_bytes() == b"a log"
    (tmp_path / "b.clf").write_text("a log")
    assert brought(str(tmp_path / "b.clf"), tmp_path / "here") == tmp_path / "b.clf"
    with pytest.raises(InputError, match=r"memory://logs/c\.clf: no such file"):
        brought("memory://logs/c.clf", tmp_path / "here")
    shutil.rmtree(tmp_path / "here")


def test_point_clouds_come_only_where_nothing_else_is_mapped(tmp_path, memory):
    for kinds in (["LaserScan", "PointCloud2"], ["PointCloud2"]):
        with memory.open(f"/{len(kinds)}.mcap", "wb") as file:
            writer = Writer(file, chunk_size=1)
            writer.start("ros2")
            for number, kind in enumerate(kinds):
                schema = writer.register_schema(f"sensor_msgs/msg/{kind}", "ros2msg", b"")
                writer.add_message(writer.register_channel(f"/{kind}", "cdr", schema), number, b"0", number)
            writer.finish()

    def topics(name, *asked):
        return [
            c.name for c, _, _ in McapReader(brought(f"memory://{name}", tmp_path / "here", asked)).messages()
        ]

    assert topics("2.mcap") == ["/LaserScan"]
    assert topics("2.mcap", "/PointCloud2") == ["/LaserScan", "/PointCloud2"]
    assert topics("1.mcap") == ["/PointCloud2"]
