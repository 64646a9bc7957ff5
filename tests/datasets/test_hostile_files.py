"""Decompression bombs and things that are not files: refused in one line, quickly."""

import bz2
import gzip
import os
import time
import tracemalloc

import numpy as np
import pytest
from rosbags.rosbag2 import CompressionFormat, CompressionMode, Writer
from rosbags.typesys import Stores, get_typestore

from tests.helpers.foreign_bags import laser_scan
from turtlebag.datasets.bags.source import open_bag
from turtlebag.datasets.errors import InputError
from turtlebag.datasets.files import FileBytes, read_unpacked
from turtlebag.pipeline.cli.main import main

LOG = b"FLASER 1 1.0 0 0 0 0 0 0 1.0 host 1.0\n"


@pytest.mark.parametrize("pack", [bz2.compress, gzip.compress])
def test_a_file_that_unpacks_beyond_its_bound_is_refused_soon(tmp_path, pack, capsys):
    bomb = pack(bytes(8 << 20)) * 100
    (tmp_path / "log.clf.bz2").write_bytes(pack(LOG) + bomb)
    started = time.process_time()
    assert main(["bag", "info", str(tmp_path / "log.clf.bz2")]) == 2
    assert time.process_time() - started < 2.0
    said = capsys.readouterr().err
    assert said.count("\n") == 1
    assert "unpacks to more than" in said


def test_a_few_bytes_of_bzip2_do_not_take_the_memory_of_all_they_unpack_to(tmp_path):
    (tmp_path / "a").write_bytes(bz2.compress(bytes(140 << 20)))  # 150 bytes or so
    tracemalloc.start()
    try:
        with pytest.raises(InputError, match="unpacks to more than"):
            read_unpacked(tmp_path / "a")
        assert tracemalloc.get_traced_memory()[1] < 200 << 20
    finally:
        tracemalloc.stop()


@pytest.mark.parametrize("pack", [bz2.compress, gzip.compress])
def test_many_small_streams_take_no_longer_than_one(tmp_path, pack):
    (tmp_path / "a").write_bytes(pack(b"") * 20_000 + pack(LOG))
    started = time.process_time()
    assert read_unpacked(tmp_path / "a") == (LOG, None)
    assert time.process_time() - started < 2.0


@pytest.mark.slow
@pytest.mark.parametrize("pack", [bz2.compress, gzip.compress])
@pytest.mark.parametrize("size", [0, 1, 1 << 16, (1 << 20) + 1, 5_000_000])
def test_what_is_within_bounds_is_unpacked_whole(tmp_path, pack, size):
    content = (LOG * (size // len(LOG) + 1))[: size + 1]
    (tmp_path / "a").write_bytes(pack(content) + pack(b"more"))
    assert read_unpacked(tmp_path / "a") == (content + b"more", None)


@pytest.mark.parametrize("beams", [50_000, 17 << 20])
@pytest.mark.parametrize("mode", [CompressionMode.FILE, CompressionMode.MESSAGE])
def test_compressed_folders_are_bounded_too(tmp_path, mode, beams):
    store = get_typestore(Stores.ROS2_JAZZY)
    writer = Writer(tmp_path / "bag", version=9)
    writer.set_compression(mode, CompressionFormat.ZSTD)
    kind = "sensor_msgs/msg/LaserScan"
    with writer:
        connection = writer.add_connection("/scan", kind, typestore=store)
        for stamp in range(2):
            data = bytes(store.serialize_cdr(laser_scan(stamp, np.ones(beams, np.float32)), kind))
            writer.write(connection, stamp, data)
    if beams == 50_000:
        bag = open_bag(tmp_path / "bag")
        assert [len(message.data) for message in bag.messages()] == [len(data)] * 2
        assert bag.notes == []
    elif mode == CompressionMode.FILE:
        with pytest.raises(InputError, match="unpacks to more than"):
            open_bag(tmp_path / "bag")
    else:
        bag = open_bag(tmp_path / "bag")
        assert list(bag.messages()) == []
        assert "unpacks to more than" in bag.notes[0]


READING = {
    "map": ("map", "IN", "--out", "OUT"),
    "truth": ("map", "log.clf", "--truth", "IN", "--out", "OUT"),
    "info": ("bag", "info", "IN"),
    "doctor": ("bag", "doctor", "IN"),
    "play": ("bag", "play", "IN"),
    "convert": ("bag", "convert", "IN", "--out", "OUT"),
    "plan": ("plan", "--map", "IN", "--start", "0,0,0", "--goal", "1,0,0", "--out", "OUT"),
    "report": ("report", "IN", "--out", "OUT"),
    "compare": ("compare", "IN", "IN"),
    "verify": ("verify", "IN"),
    "record": ("record", "--world", "empty", "--teleop", "IN", "--out", "OUT"),
    "world": ("world", "show", "IN", "--out", "OUT.png"),
    "config": ("map", "log.clf", "--config", "IN", "--out", "OUT"),
    "sweep": ("sweep", "IN", "--out", "OUT"),
}


@pytest.mark.parametrize("verb", READING)
@pytest.mark.parametrize("where", ["x.yaml", "folder"])
def test_pipes_are_refused_and_not_waited_for(tmp_path, monkeypatch, capsys, verb, where):
    monkeypatch.chdir(tmp_path)
    (tmp_path / "log.clf").write_bytes(LOG)
    (tmp_path / "folder" / "bag").mkdir(parents=True)
    for name in ("x.yaml", "folder/manifest.json", "folder/bag/bag_0.mcap"):
        os.mkfifo(tmp_path / name)
    if verb == "record" and where == "folder":
        where = "folder/bag"
    words = [{"IN": where}.get(word, word) for word in READING[verb]]
    assert main(words) == 2
    said = capsys.readouterr().err
    assert said.count("\n") == 1
    assert not (tmp_path / "OUT").exists()


def test_a_pipe_is_not_opened_by_who_reads_without_the_command_line(tmp_path):
    os.mkfifo(tmp_path / "a.mcap")
    for read in (open_bag, read_unpacked, FileBytes):
        with pytest.raises(InputError, match="not a plain file"):
            read(tmp_path / "a.mcap")
