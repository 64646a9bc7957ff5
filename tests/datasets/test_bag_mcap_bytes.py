"""MCAP files laid out by hand from the format's own description, one byte wrong at a time."""

import struct
import zlib

import lz4.frame
import pytest
import zstandard

from turtlebag.datasets.bags.mcap_sequential import McapReader
from turtlebag.datasets.bags.topics import Topic
from turtlebag.datasets.errors import InputError

MAGIC = b"\x89MCAP0\r\n"


def text(value):
    return struct.pack("<I", len(value)) + value.encode()


def sized(data):
    return struct.pack("<I", len(data)) + data


def record(opcode, *parts):
    body = b"".join(parts)
    return struct.pack("<BQ", opcode, len(body)) + body


HEADER = record(1, text("ros2"), text("hand"))
SCHEMA = record(3, struct.pack("<H", 4), text("pkg/A"), text("ros2msg"), text("int32 x"))
SAID = ("offered_qos_profiles", "- depth: 1", "k", "v", "topic_type_hash", "h")
METADATA = sized(b"".join(text(part) for part in SAID))
CHANNEL = record(4, struct.pack("<HH", 7, 4), text("/a"), text("cdr"), METADATA)
OTHER = record(4, struct.pack("<HH", 8, 9), text("/b"), text("json"), sized(b""))
NOTE = record(12, text("seed"), sized(text("n") + text("3") + text("m") + text("")))


def message(channel, log, data, publish=0, sequence=5):
    return record(5, struct.pack("<HIQQ", channel, sequence, log, publish), data)


def chunk(records, compression="", *, crc=None, size=None, start=1, end=2, more=b"", packed=None):
    pack = {"": bytes, "zstd": zstandard.ZstdCompressor().compress, "lz4": lz4.frame.compress}
    if packed is None:
        packed = pack.get(compression, bytes)(records)
    head = struct.pack(
        "<QQQI",
        start,
        end,
        len(records) if size is None else size,
        zlib.crc32(records) if crc is None else crc,
    )
    return record(6, head, text(compression), struct.pack("<Q", len(packed)), packed, more)


def whole(parts, *, count=None, crc=None, summary_crc=None, footer=True):
    """A file of these records with its end: data end, schema, channel, statistics, footer."""
    data = MAGIC + b"".join(parts)
    out = data + record(15, struct.pack("<I", zlib.crc32(data) if crc is None else crc))
    at = len(out)
    summary = SCHEMA + CHANNEL
    if count is not None:
        summary += record(11, struct.pack("<QHIIIIQQ", count, 1, 1, 0, 1, 1, 0, 9), sized(b""))
    out += summary
    if not footer:
        return out + MAGIC
    head = struct.pack("<BQQQ", 2, 20, at, 0)
    found = zlib.crc32(summary + head) if summary_crc is None else summary_crc
    return out + head + struct.pack("<I", found) + MAGIC


def read(tmp_path, content, wanted=None, **options):
    path = tmp_path / "x.mcap"
    path.write_bytes(content)
    scan = McapReader(path)
    found = [(channel.name, time, data) for channel, time, data in scan.messages(wanted, **options)]
    return found, scan.state, scan


A, B = ("/a", 11, b"one"), ("/a", 12, b"")
GOOD = [HEADER, NOTE, SCHEMA, CHANNEL, chunk(message(7, 11, b"one") + message(7, 12, b""))]


def test_a_whole_file_gives_its_messages_and_says_what_it_holds(tmp_path):
    index = record(7, struct.pack("<H", 7), sized(bytes(16)))
    found, state, scan = read(tmp_path, whole([*GOOD, index, message(7, 13, b"bare")], count=3))
    assert found == [A, B, ("/a", 13, b"bare")]
    assert (state.problems, state.stopped, state.complete) == ([], False, True)
    assert (state.messages, state.claimed) == (3, 3)
    assert state.introduced.channels[7] == Topic(
        "/a", "pkg/msg/A", "int32 x", "ros2msg", "- depth: 1", "h", "cdr"
    )
    assert state.metadata == {"seed": {"n": "3", "m": ""}}
    assert scan.leading_metadata("seed") == {"n": "3", "m": ""}
    assert scan.leading_metadata("other") == {}
    # what comes after the messages is not among what precedes them
    late = read(tmp_path, whole([HEADER, SCHEMA, CHANNEL, message(7, 1, b""), NOTE], count=1))[2]
    assert late.leading_metadata("seed") == {}


@pytest.mark.parametrize("compression", ["", "zstd", "lz4"])
def test_chunks_bring_their_own_topics_and_only_what_is_wanted_is_given(tmp_path, compression):
    inside = (
        SCHEMA + CHANNEL + message(7, 11, b"one") + OTHER + message(8, 20, b"x" * 300) + message(7, 12, b"")
    )
    content = whole([HEADER, chunk(inside, compression)], count=3)
    found, state, _ = read(tmp_path, content)
    assert found == [A, ("/b", 20, b"x" * 300), B]
    assert state.introduced.channels[8].msgtype == ""
    found, state, _ = read(tmp_path, content, lambda channel: channel.name == "/b")
    assert found == [("/b", 20, b"x" * 300)]
    assert (state.messages, state.problems) == (3, [])


CHANGED = "the file's checksum does not match: something outside the messages changed"
INSIDE = message(7, 11, b"one")


@pytest.mark.parametrize(
    ("bad", "says"),
    [
        (chunk(INSIDE, crc=1), "the checksum of a chunk does not match"),
        (chunk(INSIDE, size=len(INSIDE) + 1, crc=0), "a chunk has the wrong size"),
        (chunk(INSIDE, "zstd", size=len(INSIDE) + 1, crc=0), "a chunk has the wrong size"),
        (chunk(INSIDE, "lz4", size=len(INSIDE) - 1, crc=0), "a chunk has the wrong size"),
        (chunk(INSIDE, start=3), "a chunk with an invalid header"),
        (chunk(INSIDE, size=(64 << 20) + 1), "a chunk with an invalid header"),
        (chunk(INSIDE, "zstd", packed=b"rubbish"), "a chunk"),
        (chunk(INSIDE, "lz4", packed=b"rubbish"), "a chunk cannot be unpacked"),
        (chunk(INSIDE, "snappy"), "unknown compression 'snappy'"),
        (chunk(INSIDE, more=b"\0"), "a record is longer than its content"),
        (record(6, bytes(27)), "a record ends too early"),
        (record(6, bytes(28)), "a record ends too early"),
        (record(6, bytes(28), text("zstd"), b"\xff" * 8, b"x"), "a record ends too early"),
        (chunk(message(9, 1, b"")), "a message of an unknown topic"),
        (chunk(INSIDE[:-1]), "a message of an unknown topic, or too long"),
        (chunk(record(5, bytes(21)) + bytes(40)), "a message of an unknown topic"),
        (chunk(INSIDE + b"\x05" * 8), "a chunk ends inside a record"),
        (chunk(INSIDE + record(12, text("a"), sized(b""))), "an unexpected record in a chunk"),
        (chunk(INSIDE + record(4, bytes(99))[:-1]), "an unexpected record in a chunk"),
        (record(3, struct.pack("<H", 4), text("pkg/A"), text("x")), "a record ends too early"),
        (
            record(4, struct.pack("<HH", 7, 4), text("/a"), text("c"), sized(text("k"))),
            "a record ends too early",
        ),
        (record(1, text("ros2")), "a record ends too early"),
        (record(1, text("ros2"), text("x"), b"y"), "a record is longer than its content"),
        (record(12, sized(b"\xff\xfe"), sized(b"")), "a text is not UTF-8"),
        (record(0, b"abc"), "unknown record type 0"),
        (record(16, b"abc"), "unknown record type 16"),
        (record(127, b"abc"), "unknown record type 127"),
        (record(2, bytes(20)), "the end comes before the end of the data"),
    ],
)
def test_damage_is_named_by_its_place_and_stepped_over_to_the_next_chunk(tmp_path, bad, says):
    before = [HEADER, NOTE, SCHEMA, CHANNEL, message(7, 9, b"first")]
    last = chunk(message(7, 99, b"last"), "zstd")
    content = whole([*before, bad, last], crc=0)
    at = len(MAGIC) + sum(map(len, before))
    found, state, _ = read(tmp_path, content)
    assert found[0] == ("/a", 9, b"first")
    assert ("/a", 99, b"last") not in found
    assert state.problems[0].startswith(f"damaged at byte {at} of {len(content)}: {says}")
    assert state.stopped
    over, state, _ = read(tmp_path, content, step_over=True)
    assert over[-1] == ("/a", 99, b"last")
    assert state.problems[0].startswith(f"damaged at byte {at} of {len(content)}: {says}")
    assert not state.stopped


@pytest.mark.slow
def test_a_bag_of_which_every_chunk_is_large_is_not_read_to_its_end(tmp_path):
    large = chunk(message(7, 1, bytes(60 << 20)), "zstd", crc=0)
    with pytest.raises(InputError, match="chunks unpack to more than 1000 times"):
        read(tmp_path, whole([HEADER, SCHEMA, CHANNEL, *[large] * 18]), lambda channel: False)


def test_records_of_other_kinds_are_passed_by(tmp_path):
    others = [record(9, b"attachment"), record(8, bytes(60)), record(0x80, b"private"), record(0xFF, b"")]
    assert read(tmp_path, whole([*GOOD, *others], count=2))[1].problems == []


def test_a_file_that_is_cut_off_says_so_after_what_it_holds(tmp_path):
    content = MAGIC + b"".join(GOOD)
    found, state, _ = read(tmp_path, content)
    assert found == [A, B]
    assert state.problems[0].startswith(f"the file ends without its index, after {len(content)} bytes")
    for cut in (1, len(GOOD[-1]) - 8, len(GOOD[-1]) - 9):
        found, state, _ = read(tmp_path, content[:-cut])
        assert found == []
        assert f"damaged at byte {len(content) - len(GOOD[-1])}" in state.problems[0]
        assert "the file ends inside a record" in state.problems[0]
        assert state.stopped


@pytest.mark.parametrize(
    ("options", "says"),
    [
        ({"count": 3}, ["3 messages were written, 2 could be read"]),
        (
            {"count": 2, "crc": 5},
            ["the file's checksum does not match: something outside the messages changed"],
        ),
        ({"count": 2, "crc": 0}, []),
        ({"count": 2, "summary_crc": 5}, ["the index at the end of the file is damaged"]),
        ({"count": 2, "summary_crc": 0}, []),
        ({"footer": False}, ["the index at the end of the file is damaged"]),
        ({}, []),
    ],
)
def test_the_end_of_a_file_is_compared_with_what_was_read(tmp_path, options, says):
    found, state, _ = read(tmp_path, whole(GOOD, **options))
    assert found == [A, B]
    assert state.problems == says
    assert state.complete == (says != ["the index at the end of the file is damaged"])
    state = read(tmp_path, whole(GOOD, **options)[:-1] + b"x")[1]
    assert not state.complete


def test_topics_of_a_damaged_chunk_are_known_from_the_end_of_the_file(tmp_path):
    bad = chunk(SCHEMA + CHANNEL + message(7, 1, b""), crc=1)
    for options, known in (({}, True), ({"summary_crc": 5}, False), ({"summary_crc": 0}, True)):
        content = whole([HEADER, bad, chunk(message(7, 99, b"last"))], crc=0, **options)
        found, state, _ = read(tmp_path, content, step_over=True)
        assert found == ([("/a", 99, b"last")] if known else [])
        assert (7 in state.introduced.channels) == known
        assert read(tmp_path, content)[0] == []
    with pytest.raises(InputError, match="not an MCAP file"):
        read(tmp_path, b"\0" + content[1:])
