"""What the end of a written MCAP file says of it, held against the bytes it speaks of."""

import struct
import zlib

import pytest
from mcap.reader import make_reader

from turtlebag.datasets.bags import mcap
from turtlebag.datasets.bags.mcap import McapWriter
from turtlebag.datasets.bags.mcap_scan import McapScan


def written(path, compression, close=True):
    """Two topics, times that go back, metadata amid the messages, several chunks."""
    writer = McapWriter(path, compression=compression)
    schema = writer.add_schema("pkg/A", "int32 x")
    one = writer.add_channel("/a", schema, {"k": "v", "l": ""})
    told = []
    for k in range(12):
        told.append((one, 10**9 + k * 3 * 10**8, bytes([k]) * k))
        writer.write(*told[-1])
        if k == 4:
            writer.add_metadata("seed", {"n": "3"})
            two = writer.add_channel("/b", writer.add_schema("pkg/B", "", "ros2idl"), {}, "json")
        if k > 4:
            told.append((two, 10**9 - k, b"xy"))
            writer.write(*told[-1])
    writer.add_metadata("last", {})
    assert writer.counts == [12, 7]
    writer.close() if close else writer.abort()
    return writer, told


@pytest.mark.parametrize("compression", ["", "zstd"])
def test_the_index_points_at_every_chunk_message_and_note(tmp_path, compression):
    path = tmp_path / "a.mcap"
    writer, told = written(path, compression)
    data = path.read_bytes()
    with path.open("rb") as file:
        reader = make_reader(file, validate_crcs=True)
        summary = reader.get_summary()
        header = reader.get_header()
        notes = [(note.name, note.metadata) for note in reader.iter_metadata()]
        ordered = [(c.id, m.log_time, m.data) for _, c, m in reader.iter_messages(log_time_order=True)]
    assert (header.profile, header.library) == ("ros2", "turtlebag")
    assert notes == [("seed", {"n": "3"}), ("last", {})]
    assert sorted(ordered) == sorted(told)
    assert [time for _, time, _ in ordered] == sorted(time for _, time, _ in told)
    found = summary.statistics
    assert (found.message_count, found.schema_count, found.channel_count) == (19, 2, 2)
    assert (found.attachment_count, found.metadata_count) == (0, 2)
    assert found.channel_message_counts == {1: 12, 2: 7}
    times = [time for _, time, _ in told]
    assert (found.message_start_time, found.message_end_time) == (min(times), max(times)) == writer.span_ns
    assert found.chunk_count == len(summary.chunk_indexes) > 2
    assert {
        k: (c.topic, c.schema_id, c.message_encoding, c.metadata) for k, c in summary.channels.items()
    } == {
        1: ("/a", 1, "cdr", {"k": "v", "l": ""}),
        2: ("/b", 2, "json", {}),
    }
    assert [(s.name, s.encoding, s.data) for s in summary.schemas.values()] == [
        ("pkg/A", "ros2msg", b"int32 x"),
        ("pkg/B", "ros2idl", b""),
    ]
    assert [note.name for note in summary.metadata_indexes] == ["seed", "last"]
    for note in summary.metadata_indexes:
        opcode, size = struct.unpack_from("<BQ", data, note.offset)
        assert (opcode, size + 9) == (mcap.METADATA, note.length)
    seen = []
    for chunk in summary.chunk_indexes:
        at = chunk.chunk_start_offset
        opcode, size, start, end, unpacked, crc = struct.unpack_from("<BQQQQI", data, at)
        assert (opcode, size + 9) == (mcap.CHUNK, chunk.chunk_length)
        assert (start, end, unpacked) == (
            chunk.message_start_time,
            chunk.message_end_time,
            chunk.uncompressed_size,
        )
        assert chunk.compression == compression
        records = data[at + chunk.chunk_length - chunk.compressed_size : at + chunk.chunk_length]
        if compression:
            records = mcap.zstandard.ZstdDecompressor().decompress(records)
        assert (len(records), zlib.crc32(records)) == (unpacked, crc)
        inside, place = [], at + chunk.chunk_length
        for channel, offset in chunk.message_index_offsets.items():
            assert offset == place
            opcode, size, number, length = struct.unpack_from("<BQHI", data, offset)
            assert (opcode, number, length) == (mcap.MESSAGE_INDEX, channel, size - 6)
            for k in range(length // 16):
                time, where = struct.unpack_from("<QQ", data, offset + 15 + 16 * k)
                code, body, told_by, sequence, log, publish = struct.unpack_from("<BQHIQQ", records, where)
                assert (code, told_by, log, publish) == (mcap.MESSAGE, channel, time, time)
                content = records[where + 31 : where + 9 + body]
                inside.append((channel, time, content))
                assert sequence == [t for c, *t in told if c == channel].index([time, content])
            place += 9 + size
        assert place == at + chunk.chunk_length + chunk.message_index_length
        assert (min(t for _, t, _ in inside), max(t for _, t, _ in inside)) == (start, end)
        seen += inside
    assert sorted(seen) == sorted(told)


def test_the_summary_is_found_by_groups_and_both_checksums_hold(tmp_path):
    path = tmp_path / "a.mcap"
    written(path, "zstd")
    data = path.read_bytes()
    footer = len(data) - len(mcap.MAGIC) - 29
    opcode, size, start, offsets, crc = struct.unpack_from("<BQQQI", data, footer)
    assert (opcode, size, crc) == (mcap.FOOTER, 20, zlib.crc32(data[start : footer + 25]))
    code, size, whole = struct.unpack_from("<BQI", data, start - 13)
    assert (code, size, whole) == (mcap.DATA_END, 4, zlib.crc32(data[: start - 13]))
    groups, at = [], offsets
    while at < footer:
        code, size, kind, first, length = struct.unpack_from("<BQBQQ", data, at)
        assert (code, size) == (mcap.SUMMARY_OFFSET, 17)
        groups.append((kind, first, length))
        at += 26
    assert [kind for kind, _, _ in groups] == [3, 4, 11, 8, 13]
    place = start
    for kind, first, length in groups:
        assert first == place
        place += length
        while first < place:
            code, size = struct.unpack_from("<BQ", data, first)
            assert code == kind
            first += 9 + size
    assert place == offsets


def test_a_chunk_is_closed_when_it_is_full_or_spans_a_second(tmp_path):
    for name, writes, chunks in (
        ("size", [(k, bytes(mcap.CHUNK_BYTES // 4 - 31)) for k in range(9)], 3),
        ("time", [(k * 10**8, b"") for k in range(25)], 3),
        ("back", [(10**10, b""), (10**10 - 10**9, b""), (10**10, b"")], 2),
        ("near", [(10**10, b""), (10**10 - 10**9 + 1, b""), (10**10, b"")], 1),
    ):
        path = tmp_path / name
        writer = McapWriter(path)
        channel = writer.add_channel("/a", writer.add_schema("A", ""), {})
        for time, data in writes:
            writer.write(channel, time, data)
        writer.close()
        with path.open("rb") as file:
            assert len(make_reader(file).get_summary().chunk_indexes) == chunks


def test_an_aborted_file_holds_its_messages_and_no_end(tmp_path):
    path = tmp_path / "a.mcap"
    _, told = written(path, "zstd", close=False)
    scan = McapScan(path)
    found = [(time, data) for _, time, data in scan.messages()]
    assert found == [(time, data) for _, time, data in told]
    assert not scan.state.complete
    assert "without its index" in scan.state.problems[0]
    with pytest.raises(FileExistsError):
        McapWriter(path)
    with pytest.raises(ValueError, match="must be '' or 'zstd', not 'lz4'"):
        McapWriter(tmp_path / "b", compression="lz4")
    empty = McapWriter(tmp_path / "c")
    assert empty.span_ns == (0, 0)
    empty.close()
    with (tmp_path / "c").open("rb") as file:
        summary = make_reader(file).get_summary()
    assert (summary.statistics.message_count, summary.statistics.chunk_count) == (0, 0)
