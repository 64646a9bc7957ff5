"""Input files as bytes: what is read of them, and where their bounds are to the byte."""

import bz2
import gzip
import os
import zipfile
import zlib
from contextlib import nullcontext

import numpy as np
import pytest
import zstandard

from turtlebag.datasets.errors import InputError
from turtlebag.datasets.files import (
    FileBytes,
    Unpacked,
    bound_of,
    chunk_bound,
    opened_plain,
    read_unpacked,
    read_whole,
    require_bounded_zip,
    require_same,
    signatures,
    unchanged,
    unpack_zstd,
    unpack_zstd_file,
)

DATA = np.random.default_rng(1).integers(0, 256, 5000).astype(np.uint8).tobytes()


@pytest.fixture
def path(tmp_path):
    file = tmp_path / "file"
    file.write_bytes(DATA)
    return file


WINDOWS = pytest.mark.parametrize("piece", [64, 1 << 20])
"""Smaller than the file, and larger."""


@WINDOWS
def test_the_bytes_of_a_file_are_those_of_a_bytes_object(path, piece):
    data, rng = FileBytes(path, piece), np.random.default_rng(2)
    assert len(data) == len(DATA)
    for a, b in rng.integers(-6000, 6000, (300, 2)).tolist():
        assert data[a:b] == DATA[a:b]
    assert (data[:7], data[-7:], data[:]) == (DATA[:7], DATA[-7:], DATA)
    for stop in (0, 1, 64, 128, 129, 5000):
        assert data.crc32(stop) == zlib.crc32(DATA[:stop])


@WINDOWS
def test_a_part_is_found_where_it_begins_first_also_across_windows(path, piece):
    data = FileBytes(path, piece)
    for at in (0, 60, 62, 63, 64, 65, 127, 4990):
        part = DATA[at : at + 10]
        assert data.find(part, 0) == at
        assert data.find(part, at) == at
        assert data.find(part, at + 1) == DATA.find(part, at + 1)
    assert data.find(b"\0" * 40, 0) == -1
    assert data.find(DATA[:1], 5000) == -1


def test_a_file_that_is_cut_replaced_or_written_to_is_an_input_error(path):
    for change in (
        lambda: path.write_bytes(DATA[:100]),
        lambda: path.unlink(),
        lambda: (path.with_name("new").write_bytes(DATA), path.with_name("new").replace(path)),
    ):
        path.write_bytes(DATA)
        with pytest.raises(InputError, match="changed while it was read"), unchanged(path):
            change()
    path.write_bytes(DATA)
    data = FileBytes(path)
    path.write_bytes(DATA[:100])
    with pytest.raises(InputError, match="changed while it was read"):
        data[50:200]


def test_what_is_no_plain_file_is_refused_and_its_descriptor_closed(tmp_path, path):
    fifo, empty = tmp_path / "fifo", tmp_path / "empty"
    os.mkfifo(fifo)
    empty.touch()
    before = len(os.listdir("/proc/self/fd"))
    for _ in range(5):
        with pytest.raises(InputError, match="is not a plain file"):
            opened_plain(fifo)
    assert len(os.listdir("/proc/self/fd")) == before
    with pytest.raises(InputError, match="cannot be read"):
        opened_plain(tmp_path / "none")
    with pytest.raises(InputError, match="is empty"):
        FileBytes(empty)
    with opened_plain(path) as file:
        assert file.read(3) == DATA[:3]
    assert read_whole(path) == DATA


def test_signatures_are_of_plain_files_below_a_folder(tmp_path):
    (tmp_path / "deep").mkdir()
    for name in ("a", "deep/b"):
        (tmp_path / name).write_bytes(b"123")
    (tmp_path / "nowhere").symlink_to(tmp_path / "missing")
    found = signatures(tmp_path)
    assert {str(p.relative_to(tmp_path)) for p in found} == {"a", "deep/b"}
    status = (tmp_path / "a").stat()
    wanted = (status.st_dev, status.st_ino, 3, status.st_mtime_ns)
    assert found[tmp_path / "a"] == wanted
    assert signatures(tmp_path / "a") == {tmp_path / "a": wanted}
    assert len(signatures(tmp_path, most=2)) == 2
    (tmp_path / "c").touch()
    with pytest.raises(InputError, match="more than 2 files"):
        signatures(tmp_path, most=2)
    (tmp_path / "c").unlink()
    os.mkfifo(tmp_path / "pipe")
    with pytest.raises(InputError, match="pipe: is a pipe or a device"):
        signatures(tmp_path)


def test_the_file_that_changed_is_named(tmp_path):
    for name in ("a", "b"):
        (tmp_path / name).write_text("1")
    before = signatures(tmp_path)
    require_same(tmp_path, before)
    with pytest.raises(InputError, match="/b: changed"), unchanged(tmp_path):
        (tmp_path / "b").write_text("22")
    with unchanged(tmp_path):
        pass
    gone = tmp_path / "gone"
    require_same(gone, {})
    with pytest.raises(InputError, match="/a: changed"):
        require_same(gone, {tmp_path / "a": before[tmp_path / "a"]})


def test_bounds_are_ratios_between_what_is_harmless_and_what_fits():
    assert [bound_of(n) for n in (0, 671088, 671089, 1 << 30)] == [64 << 20, 64 << 20, 67108900, 2 << 30]
    assert [chunk_bound(n) for n in (0, 67108, 67109, 1 << 30)] == [64 << 20, 64 << 20, 67109000, 1 << 30]


def test_the_chunks_of_a_file_are_bounded_together(path):
    for packed, whole in ((10, 1 << 30), (2_000_000, 2_000_000_000)):
        count = Unpacked(path, packed)
        count.add(whole - 5)
        count.add(5)
        with pytest.raises(InputError, match="more than 1000 times"):
            count.add(1)


@pytest.mark.parametrize("pack", [gzip.compress, bz2.compress])
def test_packed_files_are_read_up_to_the_damage_stream_after_stream(tmp_path, pack):
    content = bytes(range(256)) * 40
    path = tmp_path / "log.gz"
    path.write_bytes(pack(content))
    assert read_unpacked(path) == (content, None)
    path.write_bytes(pack(content) + pack(b"more") + b"\0" * 9)
    assert read_unpacked(path) == (content + b"more", None)
    path.write_bytes(pack(content) + pack(content)[:-6])
    found, problem = read_unpacked(path)
    assert "ends early" in problem
    assert (content + content).startswith(found)
    assert len(found) >= len(content)
    whole = pack(DATA * 60)
    path.write_bytes(whole + pack(b"x")[:3] + b"\xff" * 90)
    found, problem = read_unpacked(path)
    assert "damaged" in problem or "ends early" in problem
    assert found[: 60 * len(DATA)] == DATA * 60
    path.write_bytes(pack(content)[:4] + b"\xff" * 30)
    with pytest.raises(InputError, match="nothing could be unpacked"):
        read_unpacked(path)
    path.write_bytes(DATA)
    assert read_unpacked(path) == (DATA, None)


@pytest.mark.slow
@pytest.mark.parametrize("pack", [gzip.compress, bz2.compress])
def test_what_unpacks_beyond_its_bound_is_refused_and_what_just_fits_is_not(tmp_path, pack):
    path, eighth = tmp_path / "log.gz", pack(bytes(8 << 20))
    path.write_bytes(eighth * 8)
    assert len(read_unpacked(path)[0]) == 64 << 20
    path.write_bytes(eighth * 8 + pack(b"0"))
    with pytest.raises(InputError, match="more than 64 MiB"):
        read_unpacked(path)


@pytest.mark.parametrize("more", [0, 1])
def test_zip_files_are_bounded_by_the_sum_of_their_members(tmp_path, more):
    path = tmp_path / "a.npz"
    with zipfile.ZipFile(path, "w", zipfile.ZIP_DEFLATED, compresslevel=1) as archive:
        archive.writestr("a", bytes(40 << 20))
        archive.writestr("b", bytes((24 << 20) + more))
    with pytest.raises(InputError, match="unpacks to more than 64 MiB") if more else nullcontext():
        require_bounded_zip(path)


def test_zstd_is_unpacked_within_its_bound():
    content = bytes(200_000)
    packed = zstandard.ZstdCompressor().compress(content)
    assert unpack_zstd(packed, 200_000) == content
    with pytest.raises(ValueError, match="more than 199999 bytes"):
        unpack_zstd(packed, 199_999)
    for damaged in (b"\0" + packed[1:], packed[:-5], packed[:5], b""):
        with pytest.raises(ValueError, match="damaged zstd"):
            unpack_zstd(damaged, 10**6)


def test_a_zstd_file_is_unpacked_within_its_bound(tmp_path):
    source, target = tmp_path / "a.zst", tmp_path / "a"
    content = bytes(64 << 20)
    packed = zstandard.ZstdCompressor(level=1).compress(content)
    source.write_bytes(packed)
    unpack_zstd_file(source, target)
    assert target.read_bytes() == content
    source.write_bytes(zstandard.ZstdCompressor(level=1).compress(content + b"0"))
    with pytest.raises(InputError, match="unpacks to more than"):
        unpack_zstd_file(source, target)
    source.write_bytes(b"\0" + packed[1:])
    with pytest.raises(InputError, match="damaged zstd"):
        unpack_zstd_file(source, target)
