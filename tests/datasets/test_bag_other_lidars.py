"""Lidars whose drivers record types of their own: the type is named, and the ROS node that converts it."""

import pytest
from rosbags.rosbag2 import StoragePlugin, Writer

from turtlebag.datasets.bags.doctor import examine
from turtlebag.datasets.bags.point_clouds import load_clouds
from turtlebag.datasets.errors import InputError
from turtlebag.datasets.recordings import load_recording
from turtlebag.pipeline.cli.main import main

LIDARS = [
    ("/livox/lidar", "livox_ros_driver2/msg/CustomMsg", "livox_to_pointcloud2", "PointCloud2"),
    ("/livox/lidar", "livox_ros_driver/msg/CustomMsg", "livox_to_pointcloud2", "PointCloud2"),
    ("/velodyne_packets", "velodyne_msgs/msg/VelodyneScan", "velodyne_transform_node", "PointCloud2"),
    ("/ouster/lidar_packets", "ouster_sensor_msgs/msg/PacketMsg", "os_cloud", "PointCloud2"),
    ("/horizontal_laser_2d", "sensor_msgs/msg/MultiEchoLaserScan", "laser_proc", "LaserScan"),
]


def recorded(folder, topic, msgtype):
    """A bag that holds one message of such a topic; its bytes are never read."""
    with Writer(folder, version=9, storage_plugin=StoragePlugin.MCAP) as writer:
        connection = writer.add_connection(topic, msgtype, msgdef="uint8 x\n", rihs01="RIHS01_" + "0" * 64)
        writer.write(connection, 10**9, b"\0\1\0\0\5")
    return folder


@pytest.mark.parametrize(("topic", "msgtype", "node", "made"), LIDARS)
def test_the_type_and_the_way_out_are_one_line(tmp_path, capsys, topic, msgtype, node, made):
    bag = recorded(tmp_path / "bag", topic, msgtype)
    kind = msgtype.replace("/msg", "")
    says = f"{topic} is {kind}, which is not read: play the bag through the ROS node {node}"
    for options in ([], ["--topic", topic]):
        assert main(["map", str(bag), "--out", str(tmp_path / "map"), *options]) == 2
        said = capsys.readouterr().err
        assert said.count("\n") == 1
        assert says in said
        assert f"record the sensor_msgs/{made} that it publishes" in said
    (finding,) = (finding for finding in examine(bag) if finding.kind == "no scans")
    assert says in finding.remedy


@pytest.mark.parametrize("read", [load_recording, load_clouds])
def test_readers_say_so_too(tmp_path, read):
    bag = recorded(tmp_path / "bag", *LIDARS[0][:2])
    with pytest.raises(InputError, match=r"/lidar is livox_ros_driver2/CustomMsg, .*livox_to_pointcloud2"):
        read(bag)
