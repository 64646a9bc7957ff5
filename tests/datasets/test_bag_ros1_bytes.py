"""ROS 1 bags laid out by hand from the format's own description, one byte wrong at a time."""

import bz2
import struct

import lz4.frame
import pytest

from turtlebag.datasets.bags.ros1_sequential import Ros1Reader
from turtlebag.datasets.bags.topics import Topic


def sized(data):
    return struct.pack("<I", len(data)) + data


def field(name, value):
    return sized(name.encode() + b"=" + value)


def ros1(data, **fields):
    packed = {k: v if isinstance(v, bytes) else struct.pack("<I", v) for k, v in fields.items()}
    return sized(b"".join(field(k, v) for k, v in packed.items())) + sized(data)


def connection(number, topic="/a", latching=b"0"):
    inner = field("type", b"pkg/A") + field("message_definition", b"int32 x") + field("latching", latching)
    return ros1(inner, op=b"\x07", conn=number, topic=topic.encode())


def said(number, seconds, nanoseconds, data):
    return ros1(data, op=b"\x02", conn=number, time=struct.pack("<II", seconds, nanoseconds))


def ros1_chunk(records, compression="none", size=None, packed=None):
    pack = {"none": bytes, "bz2": bz2.compress, "lz4": lz4.frame.compress}
    packed = pack.get(compression, bytes)(records) if packed is None else packed
    size = len(records) if size is None else size
    return ros1(packed, op=b"\x05", compression=compression.encode(), size=size)


START = b"#ROSBAG V2.0\n"


def ros1_head(index, chunks):
    return ros1(b" " * 30, op=b"\x03", index_pos=struct.pack("<Q", index), conn_count=1, chunk_count=chunks)


def ros1_read(tmp_path, parts, wanted=None, **options):
    path = tmp_path / "x.bag"
    path.write_bytes(START + b"".join(parts))
    scan = Ros1Reader(path)
    return [(c.name, time, data) for c, time, data in scan.messages(wanted, **options)], scan.state


TWO = connection(1) + said(1, 3, 5, b"one") + connection(2, "/b", b"1") + said(2, 4, 0, b"")


@pytest.mark.parametrize("compression", ["none", "bz2", "lz4"])
def test_a_ros1_bag_gives_its_messages(tmp_path, compression):
    parts = [
        ros1_head(9, 2),
        ros1_chunk(TWO, compression),
        ros1(b"i", op=b"\x04", ver=1),
        connection(2, "/z"),
    ]
    parts += [ros1_chunk(said(1, 5, 6, b"x" * 200), compression), ros1(b"c", op=b"\x06", ver=1)]
    expected = [("/a", 3 * 10**9 + 5, b"one"), ("/b", 4 * 10**9, b""), ("/a", 5 * 10**9 + 6, b"x" * 200)]
    found, state = ros1_read(tmp_path, parts)
    assert found == expected
    assert (state.problems, state.indexed, state.chunks, state.claimed_chunks) == ([], True, 2, 2)
    one, two = state.connections[1], state.connections[2]
    assert one == Topic("/a", "pkg/msg/A", "int32 x", "ros1msg", encoding="ros1")
    assert (two.name, "durability: transient_local" in two.qos) == ("/b", True)
    assert ros1_read(tmp_path, parts, lambda c: c.name == "/b")[0] == expected[1:2]
    for index, chunks, says in ((0, 2, "no index"), (9, 3, "3 chunks were written, 2 could be read")):
        assert says in ros1_read(tmp_path, [ros1_head(index, chunks), *parts[1:]])[1].problems[0]


def stating(record, size):
    """The record with another length of its data in front of them."""
    at = 4 + struct.unpack_from("<I", record)[0]
    return record[:at] + struct.pack("<I", size) + record[at + 4 :]


@pytest.mark.parametrize(("operation", "entry"), [(b"\x04", 12), (b"\x06", 8)])
@pytest.mark.parametrize("states", [0, 20, 40, 1 << 30])
def test_the_length_that_an_index_record_states_is_not_believed(tmp_path, operation, entry, states):
    """Writers of 2010 state a wrong one, and rosbag goes by the number of entries."""
    index = stating(ros1(bytes(2 * entry), op=operation, ver=1, conn=1, count=2), states)
    parts = [ros1_head(9, 2), ros1_chunk(TWO), index, ros1_chunk(said(1, 5, 6, b"x")), index]
    found, state = ros1_read(tmp_path, parts)
    assert [data for _, _, data in found] == [b"one", b"", b"x"]
    assert state.problems == []


def test_an_index_record_with_a_damaged_count_is_stepped_over_by_its_length(tmp_path):
    for count in (3, 1 << 31):
        index = ros1(bytes(24), op=b"\x04", ver=1, conn=1, count=count)
        found, state = ros1_read(tmp_path, [ros1_head(9, 2), ros1_chunk(TWO), index, ros1_chunk(TWO)])
        assert (len(found), state.problems) == (4, [])


@pytest.mark.parametrize(
    ("bad", "says"),
    [
        (ros1(b"", op=b"\x08"), "unknown kind of record"),
        (ros1(b"", op=b"\x01"), "unknown kind of record"),
        (ros1(b"", op=b"\x02\x02"), "unknown kind of record"),
        (ros1(b"", conn=3), "unknown kind of record"),
        (sized(sized(b"op")) + sized(b""), "a header field without a value"),
        (sized(sized(b"op=\x03") + b"\1\0\0") + sized(b""), "a header is truncated"),
        (sized(struct.pack("<I", 9) + b"op=\x03") + sized(b""), "a header field without a value"),
        (struct.pack("<I", 1 << 25) + bytes(50), "the file ends inside a record, or its length is wrong"),
        (ros1(b"", op=b"\x07", conn=3, topic=b"/c"), "no type in a header"),
        (ros1(b"", op=b"\x07", topic=b"/c"), "no conn in a header"),
        (ros1(b"", op=b"\x07", conn=b"\1\0\0", topic=b"/c"), "no conn in a header"),
        (ros1_chunk(said(9, 1, 1, b"")), "a message of an unknown topic"),
        (ros1_chunk(said(1, 1, 1, b"abc")[:-1]), "a chunk ends inside a record"),
        (ros1_chunk(TWO, "bz2", size=len(TWO) + 1), "a chunk has the wrong size"),
        (ros1_chunk(TWO, "bz2", size=len(TWO) - 1), "a chunk has the wrong size"),
        (ros1_chunk(TWO, "lz4", size=(64 << 20) + 1), "a chunk has an impossible size"),
        (ros1_chunk(TWO, "bz2", packed=b"rubbish"), "a chunk cannot be unpacked"),
        (ros1_chunk(TWO, "snappy"), "unknown compression 'snappy'"),
        (ros1(b"", op=b"\x05", size=1), "no compression in a header"),
    ],
)
def test_damage_of_a_ros1_bag_is_named_and_stepped_over(tmp_path, bad, says):
    before = [ros1_head(9, 2), ros1_chunk(connection(1) + said(1, 1, 0, b"first"))]
    parts = [*before, bad, ros1_chunk(said(1, 9, 0, b"last"), "bz2")]
    at, end = len(START) + sum(map(len, before)), len(START) + sum(map(len, parts))
    found, state = ros1_read(tmp_path, parts)
    assert found[0] == ("/a", 10**9, b"first")
    assert ("/a", 9 * 10**9, b"last") not in found
    assert state.problems[0].startswith(f"damaged at byte {at} of {end}: {says}")
    assert state.stopped
    over, state = ros1_read(tmp_path, parts, step_over=True)
    assert over[-1] == ("/a", 9 * 10**9, b"last")
    assert not state.stopped


def test_a_ros1_bag_that_is_cut_gives_what_is_there(tmp_path):
    parts = [ros1_head(9, 1), ros1_chunk(TWO)]
    cut = len(said(2, 4, 0, b""))
    for missing, kept, says in (
        (1, 1, "the file ends inside a record"),
        (cut, 1, "the file ends inside a chunk"),
    ):
        data = b"".join(parts)[:-missing]
        found, state = ros1_read(tmp_path, [data])
        assert found == [("/a", 3 * 10**9 + 5, b"one")][:kept]
        assert says in state.problems[0]
    packed = b"".join([ros1_head(9, 1), ros1_chunk(TWO, "bz2")])
    assert "ends inside a compressed chunk" in ros1_read(tmp_path, [packed[:-1]])[1].problems[0]
    head = ros1_head(9, 1)
    for missing in (3, 31, 33, len(head) - 3):
        state = ros1_read(tmp_path, [head[:-missing]])[1]
        assert "the file ends inside a record" in state.problems[0]
