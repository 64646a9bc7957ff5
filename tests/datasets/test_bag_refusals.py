"""Bags that cannot be read for what is asked of them: one line that names the bag and says what is wrong."""

import re
from functools import partial

import numpy as np
import pytest
from rosbags.rosbag2 import StoragePlugin, Writer

from tests.helpers.bag_samples import write_drive
from tests.helpers.foreign_bags import (
    CLOUD,
    ODOMETRY,
    SCAN,
    STORE,
    TF,
    TYPES,
    S,
    header,
    laser_scan,
    odometry,
    tf,
    transform,
    write_foreign,
)
from turtlebag.datasets.bags.convert import require_messages, to_mcap
from turtlebag.datasets.bags.doctor import examine
from turtlebag.datasets.bags.mapping_input import NoScans
from turtlebag.datasets.bags.point_clouds import load_clouds
from turtlebag.datasets.bags.reader import bag_info, read_poses
from turtlebag.datasets.bags.selection import Selection
from turtlebag.datasets.bags.writer import BagWriter
from turtlebag.datasets.errors import InputError
from turtlebag.datasets.recordings import load_recording
from turtlebag.pipeline.stages.command_line import read

NO_CLOUD = TYPES[CLOUD](header(0, "a"), 1, 0, [], False, 0, 0, np.zeros(0, dtype=np.uint8), True)
ODOM = [("/odom", ODOMETRY, k * S, odometry(k * S, 0.5 * k)) for k in range(2)]


def scans(*topics, stamps=(0, S), **changes):
    return [(topic, SCAN, k, laser_scan(k, np.ones(9), **changes)) for topic in topics for k in stamps]


def placed(x):
    """The lidar so far before its robot's centre [m]."""
    return ("/tf_static", TF, 0, tf(transform(0, "base_link", "base_scan", (x, 0, 0), (0, 0, 0, 1))))


BAGS = {
    "odometry": ODOM,
    "lasers": [*ODOM, *scans("/left/scan", "/right/scan")],
    "instant": scans("/scan", stamps=(0, 0, 0, 0, 0)),
    "far": [placed(30.1), *scans("/scan")],
    "clouds": [("/points", CLOUD, 0, NO_CLOUD), ("/other", CLOUD, 0, NO_CLOUD)],
    "damaged clouds": [("/points", CLOUD, 0, NO_CLOUD)],
}
FILES = {
    "empty.mcap": b"",
    "empty.bag": b"",
    "text.txt": b"hello\n",
    "wrong.bag": b"not a bag at all",
    "zeros.mcap": bytes(200),
    "cut.db3": b"SQLite format 3\0" + bytes(50),
    "cut.bag": b"#ROSBAG V2.0\n" + bytes(50),
    "cut.mcap": b"\x89MCAP0\r\n\x01",
    "1.2.bag": b"#ROSRECORD V1.2\n" + bytes(100),
    "1.1.bag": b"#ROSRECORD V1.1\n" + bytes(100),
    "1.0.bag": b"#ROSLOG V1.0\n" + bytes(100),
    "never.bag": b"#ROSBAG V1.2\n" + bytes(100),
    "folder/1.2.bag": b"#ROSRECORD V1.2\n" + bytes(100),
}


def poses_of(topic):
    return lambda path: read_poses(path, topic)


def laser_at(text):
    def load(path):
        asked = read(["map", str(path), "--laser", text])
        return load_recording(path, T_base_lidar=asked.laser.T_base_lidar)

    return load


def without(frame):
    return lambda path: to_mcap(path, path.with_name("copy"), Selection(exclude_frames=(frame,)))


ANY = (load_recording, bag_info, examine)
REINDEX = "...`rosbag reindex` converts it..."
OLD = "...only a ROS release of its time..."
REFUSED = [
    *((load_recording, name, "...") for name in ("missing", "nothing", *list(FILES)[2:8])),
    *((load_recording, name, f"...{name}: the file is empty") for name in ("empty.mcap", "empty.bag")),
    *((reader, "1.2.bag", f"...1.2.bag: a ROS 1 bag of version 1.2, {REINDEX}") for reader in ANY),
    *((reader, "1.1.bag", f"...1.1.bag: a ROS 1 bag of version 1.1, {OLD}") for reader in ANY),
    *((reader, "1.0.bag", f"...1.0.bag: a ROS 1 bag of version 1.0, {OLD}") for reader in ANY),
    *((reader, "never.bag", "...never.bag: damaged bag, its first bytes...") for reader in ANY),
    (load_recording, "folder", "...1.2.bag: a ROS 1 bag of version 1.2..."),
    (load_recording, "odometry", "...no /scan ...its topics: /odom..."),
    (load_recording, "lasers", "...choose one with --topic: /left/scan, /right/scan"),
    (partial(load_recording, topic="/x"), "lasers", "...--topic /x is not in this bag..."),
    (
        partial(load_recording, topic="/odom"),
        "lasers",
        "...--topic /odom is of type nav_msgs/...Odometry...",
    ),
    (load_recording, "instant", "...without times no map can be made..."),
    (load_recording, "far", "...30.1 m from 'base_link'..."),
    (laser_at("-32,0,0"), "far", "--laser -32,0,0: 32 m from the robot's centre; X and Y are metres"),
    (laser_at("0,0,0,down"), "far", "--laser 0,0,0,down: expected..."),
    (laser_at("0,0,upside-down"), "far", "--laser 0,0,upside-down: expected..."),
    (laser_at("upside-down"), "far", "--laser upside-down: expected..."),
    (laser_at("0,0,0,upside-down,upside-down"), "far", "--laser 0,0,0,upside-down,upside-down: expected..."),
    (poses_of("/x"), "odometry", "...no /x in this bag; its topics: /odom"),
    (poses_of("/cmd_vel"), "drive", "...holds no poses (its type is geometry_msgs/msg/Twist..."),
    (load_clouds, "drive", "...no point cloud topic ...it has: none"),
    (partial(load_clouds, topic="/points"), "drive", "...no /points ..."),
    (load_clouds, "damaged clouds", "...no point cloud could be decoded..."),
    (load_clouds, "clouds", "...several point cloud topics; choose one with --topic: /points, /other"),
    (
        partial(load_clouds, topic="/x"),
        "clouds",
        "...no /x (sensor_msgs/PointCloud2) ...; it has: /points, /other",
    ),
    (
        without("camera"),
        "odometry",
        "--exclude-frame camera: no such child frame; ...none",
    ),
    (
        partial(require_messages, count=0, notes=[]),
        "drive",
        "...could be converted (the bag is empty)",
    ),
    (partial(BagWriter, custom={}), "drive", "...already..."),
]
"""Who reads, what, and the line; an ellipsis stands for anything."""


@pytest.fixture(scope="module")
def place(tmp_path_factory):
    """A folder of bags, by the names that the table has for them."""
    folder = tmp_path_factory.mktemp("refused")
    for name in ("nothing", "folder"):
        (folder / name).mkdir()
    for name, content in FILES.items():
        (folder / name).write_bytes(content)
    for name, messages in BAGS.items():
        write_foreign(folder / name, messages)
    write_drive(folder / "drive", seconds=1)
    return folder


@pytest.mark.parametrize(("reader", "name", "said"), REFUSED, ids=range(len(REFUSED)))
def test_a_bag_that_cannot_be_read_is_one_line(place, reader, name, said):
    with pytest.raises(InputError) as error:
        reader(place / name)
    assert re.fullmatch(".*".join(map(re.escape, said.split("..."))), str(error.value)), error.value
    assert said != "..." or name in str(error.value)


def test_a_topic_of_two_types_without_a_scan_has_clouds_to_map(tmp_path):
    with Writer(tmp_path / "bag", version=9, storage_plugin=StoragePlugin.MCAP) as writer:
        writer.add_connection("/scan", SCAN, typestore=STORE)
        cloud = writer.add_connection("/scan", CLOUD, typestore=STORE)
        writer.write(cloud, 1, bytes(STORE.serialize_cdr(NO_CLOUD, CLOUD)))
    with pytest.raises(NoScans, match=r"no /scan .* messages in this bag") as error:
        load_recording(tmp_path / "bag")
    assert error.value.clouds == ["/scan"]
