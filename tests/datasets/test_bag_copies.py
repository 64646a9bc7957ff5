"""Decoded clouds, and copies of bags: what is counted, kept and named."""

import math
import struct

import numpy as np
import pytest

from tests.helpers.foreign_bags import CLOUD, STORE, TF, TYPES, S, header, write_foreign
from turtlebag.datasets.bags.convert import carmen_to_mcap
from turtlebag.datasets.bags.copying import Copier, Untranslatable, completed, is_latched
from turtlebag.datasets.bags.decode import BadMessage, Cursor
from turtlebag.datasets.bags.mapping_input import read_for_mapping
from turtlebag.datasets.bags.point_clouds import decode_cloud, load_clouds
from turtlebag.datasets.bags.reader import bag_info
from turtlebag.datasets.bags.source import open_bag
from turtlebag.datasets.bags.topics import Message, Topic
from turtlebag.datasets.se2 import SE2
from turtlebag.datasets.types import LidarSpec, Recording


def cloud_bytes(fields, step, rows, width, pad=0, short=0, big=False, stamp=5 * S):
    types = TYPES["sensor_msgs/msg/PointField"]
    data = np.frombuffer(rows[: len(rows) - short], dtype=np.uint8)
    message = TYPES[CLOUD](
        header(stamp, "lidar"), len(rows) // (width * step + pad), width,
        [types(name, offset, kind, 1) for name, offset, kind in fields], big, step, width * step + pad,
        data, False,
    )  # fmt: skip
    return bytes(STORE.serialize_cdr(message, CLOUD))


@pytest.mark.parametrize(
    ("values", "kind", "seconds"),
    [
        ([0.0, 0.1], 7, [0.0, 0.1]), ([0, 10**8], 6, [0.0, 0.1]), ([0, 10**8], 5, [0.0, 0.1]),
        ([1.7e9, 1.7e9 + 0.1], 8, [0.0, 0.1]), ([1.7e18, 1.7e18 + 1e8], 8, [0.0, 0.1]),
        ([0.0, 2.0], 7, [0.0, 2.0]),
        ([0.0, 2.1], 7, None), ([0.0, math.nan], 7, None), ([-2.1, 0.0], 7, None), ([], 7, []),
    ],
)  # fmt: skip
def test_the_times_of_points_are_told_by_their_size(values, kind, seconds):
    layout = [("xyz", "<f4", 3), ("t", {5: "<i4", 6: "<u4", 7: "<f4", 8: "<f8"}[kind])]
    seen = [((1.0, 2.0, 3.0), value) for value in values]
    points = np.array([*seen, ((0.0, 0.0, 0.0), 0)], dtype=layout)  # the last one saw nothing
    fields = [("x", 0, 7), ("y", 4, 7), ("z", 8, 7), ("t", 12, kind)]
    data = cloud_bytes(fields, points.itemsize, points.tobytes(), len(points), stamp=1_700_000_000 * S)
    times = decode_cloud(Cursor(data))[2].times
    assert (None if times is None else times.tolist()) == (seconds and pytest.approx(seconds, abs=1e-6))


XYZ = [("x", 0, 7), ("y", 4, 7), ("z", 8, 7)]


def test_clouds_of_any_layout_are_taken_apart_and_impossible_ones_refused():
    points = np.array([[1, 2, 3], [0, 0, 0], [4, np.nan, 6], [7, 8, 9]], dtype=np.float32)
    plain = cloud_bytes(XYZ, 12, points.astype("<f4").tobytes(), 4)
    for data in (plain, cloud_bytes(XYZ, 12, points.astype(">f4").tobytes(), 4, big=True)):
        stamp, frame, cloud = decode_cloud(Cursor(data))
        assert (stamp, frame, cloud.times) == (5 * S, "lidar", None)
        np.testing.assert_array_equal(cloud.points, points[[0, 3]])
    mixed = b"".join(struct.pack("<hxxdfI", k, 2.0 * k, 3.0 * k, k * 10**7) for k in (1, 2))
    fields = [("x", 0, 3), ("y", 4, 8), ("z", 12, 7), ("t", 16, 6)]
    padded = mixed[:20] + b"pad!" + mixed[20:] + b"pad!"
    _, _, cloud = decode_cloud(Cursor(cloud_bytes(fields, 20, padded, 1, pad=4)))
    np.testing.assert_array_equal(cloud.points, [[1, 2, 3], [2, 4, 6]])
    np.testing.assert_allclose(cloud.times, [0.01, 0.02])
    both = cloud_bytes([*XYZ, ("time", 12, 7), ("t", 16, 7)], 20, np.arange(5, dtype="<f4").tobytes(), 1)
    assert decode_cloud(Cursor(both))[2].times is None
    both = cloud_bytes([*XYZ, ("t", 12, 7), ("time", 16, 6)], 20, np.full(5, 0.5, "<f4").tobytes(), 1)
    assert decode_cloud(Cursor(both))[2].times.tolist() == [0.5]
    for bad in (
        cloud_bytes(XYZ[:2], 12, bytes(48), 4),
        cloud_bytes(XYZ, 12, bytes(48), 4, short=1),
        cloud_bytes([*XYZ[:2], ("z", 9, 7)], 12, bytes(48), 4),
        cloud_bytes([*XYZ[:2], ("z", 8, 9)], 12, bytes(48), 4),
        cloud_bytes([*XYZ, ("time", 10, 7)], 12, bytes(48), 4),
        cloud_bytes(XYZ, 12, bytes(44), 4, pad=-1),
    ):  # fmt: skip
        with pytest.raises(BadMessage):
            decode_cloud(Cursor(bad))


def test_the_clouds_of_a_bag_and_how_many_of_them_are_damaged(tmp_path):
    good = STORE.deserialize_cdr(cloud_bytes(XYZ, 12, np.ones(12, "<f4").tobytes(), 4), CLOUD)
    bad = STORE.deserialize_cdr(cloud_bytes(XYZ[:2], 12, bytes(48), 4), CLOUD)
    messages = [("/points", CLOUD, k * S, bad if k in (2, 5, 6) else good) for k in range(8)]
    found = load_clouds(write_foreign(tmp_path / "a", messages))
    assert len(found.stamps_ns) == len(list(found.clouds)) == 5
    assert "/points: 3 of 8 messages cannot be decoded; skipped" in found.notes
    assert not found.mounted
    two = [*messages, ("/other", CLOUD, 9 * S, good)]
    path = write_foreign(tmp_path / "b", two)
    assert len(load_clouds(path, "/other").stamps_ns) == 1


def test_a_copier_counts_what_it_copies_and_names_what_it_cannot(tmp_path):
    written = []

    def register(topic):
        if topic.name == "/bad":
            raise Untranslatable("/bad: why")

        def write(message):
            if message.data == b"broken":
                raise ValueError
            written.append((topic.name, message.data))

        return write

    copier = Copier(register)
    for name, data in (
        ("/a", b"1"),
        ("/bad", b"2"),
        ("/a", b"broken"),
        ("/b", b"3"),
        ("/a", b"broken"),
        ("/a", b"4"),
    ):
        copier.write(Message(Topic(name, "pkg/msg/T"), 0, data))
    assert written == [("/a", b"1"), ("/b", b"3"), ("/a", b"4")]
    assert copier.count == 3
    assert copier.notes() == ["skipped /bad: why", "/a: 2 damaged messages left out"]
    assert is_latched(Topic("/tf_static", TF))
    assert is_latched(Topic("/map", "x", qos="durability: transient_local"))
    assert not is_latched(Topic("/tf", TF, qos="durability: volatile"))
    told = Topic("/x", "pkg/msg/T", "int32 x")
    assert completed(told) is told
    assert completed(Topic("/x", "pkg/msg/T")).definition == ""
    standard = completed(Topic("/x", TF))
    assert standard.definition.startswith("geometry_msgs/TransformStamped[] transforms")
    assert standard.type_hash.startswith("RIHS01_")
    assert completed(Topic("/x", TF, type_hash="mine")).type_hash == "mine"


@pytest.mark.parametrize("odometry_too", [True, False])
def test_a_carmen_recording_becomes_a_bag_with_so_many_messages(tmp_path, odometry_too):
    poses = SE2(np.array([[0.0, 0.0, 0.0], [1.0, 0.5, 0.2], [2.0, 1.0, 0.4]]))
    lidar = LidarSpec(4, -1.0, 0.5, 0.0, 30.0)
    recording = Recording(
        "/far/away.clf", np.array([3, 4, 5]) * S, np.arange(12, dtype=np.float32).reshape(3, 4) + 1.0, lidar,
        SE2.from_xyt(0.2, 0.1, 0.3), poses if odometry_too else None, notes=("a note",),
    )  # fmt: skip
    count, notes = carmen_to_mcap(recording, tmp_path / "bag")
    assert (count, notes) == (10 if odometry_too else 4, ["a note"])
    info = bag_info(tmp_path / "bag")
    assert info.count == count
    assert info.custom["source"] == "away.clf"
    back = read_for_mapping(open_bag(tmp_path / "bag"))
    np.testing.assert_array_equal(back.ranges, recording.ranges)
    np.testing.assert_allclose(back.T_base_lidar.xyt, [0.2, 0.1, 0.3])
    if odometry_too:
        np.testing.assert_allclose(back.T_odom_base.xyt, poses.xyt, atol=1e-12)
