"""Recorded topics and messages, the topics of our own bags, and rosbag2's metadata about them."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass
from functools import lru_cache
from typing import TYPE_CHECKING, Any, NamedTuple

import yaml

from turtlebag.datasets.yaml_files import DUMPER, plain_values

if TYPE_CHECKING:
    from rosbags.typesys.store import Typestore

METADATA_VERSION = 9
METADATA_FILE = "metadata.yaml"
DATA_FILE = "bag_0.mcap"
"""One name whatever the folder is called: the same run gives the same bytes wherever it is written."""

CUSTOM_RECORD = "custom_data"
"""Metadata record of the mcap file that repeats metadata.yaml's custom data."""

_FOREVER = {"sec": 9223372036, "nsec": 854775807}

SCAN, ODOMETRY, IMU = "sensor_msgs/msg/LaserScan", "nav_msgs/msg/Odometry", "sensor_msgs/msg/Imu"
JOINTS = "sensor_msgs/msg/JointState"
CLOUD, TRANSFORMS = "sensor_msgs/msg/PointCloud2", ("tf2_msgs/msg/TFMessage", "tf/msg/tfMessage")
MAPPED = (SCAN, ODOMETRY, IMU, *TRANSFORMS)
"""Types that mapping reads, apart from point clouds."""

_LIVOX = "livox_to_pointcloud2", CLOUD
_OUSTER = "os_cloud of ouster_ros (its replay launch file)", CLOUD
CONVERTERS = {
    "livox_ros_driver/msg/CustomMsg": _LIVOX,
    "livox_ros_driver2/msg/CustomMsg": _LIVOX,
    "livox_interfaces/msg/CustomMsg": _LIVOX,
    "velodyne_msgs/msg/VelodyneScan": (
        "velodyne_transform_node (ROS 1: cloud_nodelet) of velodyne_pointcloud",
        CLOUD,
    ),
    "ouster_ros/msg/PacketMsg": _OUSTER,
    "ouster_sensor_msgs/msg/PacketMsg": _OUSTER,
    "sensor_msgs/msg/MultiEchoLaserScan": ("laser_proc", SCAN),
}
"""Types of lidar drivers that are not read, the ROS node that converts each, and to what."""


def way_out(types: Mapping[str, Iterable[str]]) -> str:
    """What converts the topics (name: types) of lidars in types that are not read; empty without any."""
    lines = []
    for name, msgtype in sorted((name, msgtype) for name, several in types.items() for msgtype in several):
        if msgtype in CONVERTERS:
            node, made = CONVERTERS[msgtype]
            kind, cloud = (text.replace("/msg/", "/") for text in (msgtype, made))
            way = f"play the bag through the ROS node {node} and record the {cloud} that it publishes"
            lines.append(f"{name} is {kind}, which is not read: {way}")
    return "; ".join(lines)


@dataclass(frozen=True, slots=True)
class Topic:
    """A recorded topic: ROS 2 type name and, where the file has them, definition and quality of service."""

    name: str
    msgtype: str
    definition: str = ""
    definition_format: str = ""
    qos: str = ""
    type_hash: str = ""
    encoding: str = "cdr"


class Message(NamedTuple):
    """One message: its topic, log time [ns] and serialised bytes."""

    topic: Topic
    log_time_ns: int
    data: bytes


Wanted = Callable[[Topic], bool]


def full_type(msgtype: str) -> str:
    """Type name with the middle part that ROS 1 leaves out."""
    parts = msgtype.split("/")
    return f"{parts[0]}/msg/{parts[1]}" if len(parts) == 2 else msgtype


@dataclass(frozen=True, slots=True)
class Publisher:
    """Message type and quality of service of one of our own topics."""

    msgtype: str
    reliability: str = "reliable"
    durability: str = "volatile"
    depth: int = 10

    def qos(self) -> list[dict[str, Any]]:
        """`offered_qos_profiles` as metadata version 9 writes them."""
        return [
            {
                "history": "keep_last",
                "depth": self.depth,
                "reliability": self.reliability,
                "durability": self.durability,
                "deadline": dict(_FOREVER),
                "lifespan": dict(_FOREVER),
                "liveliness": "automatic",
                "liveliness_lease_duration": dict(_FOREVER),
                "avoid_ros_namespace_conventions": False,
            }
        ]


TOPICS: dict[str, Publisher] = {
    "/scan": Publisher("sensor_msgs/msg/LaserScan", reliability="best_effort", depth=5),
    "/imu": Publisher("sensor_msgs/msg/Imu", reliability="best_effort", depth=5),
    "/odom": Publisher("nav_msgs/msg/Odometry"),
    "/joint_states": Publisher("sensor_msgs/msg/JointState"),
    "/tf": Publisher("tf2_msgs/msg/TFMessage", depth=100),
    "/tf_static": Publisher("tf2_msgs/msg/TFMessage", durability="transient_local", depth=1),
    "/cmd_vel": Publisher("geometry_msgs/msg/Twist"),
    "/cmd_vel_owner": Publisher("std_msgs/msg/String", durability="transient_local", depth=1),
    "/map": Publisher("nav_msgs/msg/OccupancyGrid", durability="transient_local", depth=1),
    "/amcl_pose": Publisher("geometry_msgs/msg/PoseWithCovarianceStamped"),
    "/particlecloud": Publisher("geometry_msgs/msg/PoseArray"),
    "/plan": Publisher("nav_msgs/msg/Path"),
    "/goal_pose": Publisher("geometry_msgs/msg/PoseStamped"),
    "/points": Publisher("sensor_msgs/msg/PointCloud2", reliability="best_effort", depth=5),
    "/ground_truth/odom": Publisher("nav_msgs/msg/Odometry"),
}


@lru_cache(maxsize=1)
def typestore() -> Typestore:
    """Message definitions of ROS 2 Jazzy."""
    from rosbags.typesys import Stores, get_typestore

    return get_typestore(Stores.ROS2_JAZZY)


@lru_cache(maxsize=64)
def definition(msgtype: str) -> tuple[str, str]:
    """Full text of a message definition and its RIHS01 hash."""
    store = typestore()
    text, _ = store.generate_msgdef(msgtype, ros_version=2)
    return text, store.hash_rihs01(msgtype)


def qos_profiles(qos: str) -> list[dict[str, Any]]:
    """Qualities of service from the YAML that a bag records of a topic, maybe empty; yaml.YAMLError or
    ValueError when it holds anything else."""
    profiles = plain_values(qos) or []
    if not (isinstance(profiles, list) and all(isinstance(one, dict) for one in profiles)):
        raise ValueError("not a list of profiles")
    return profiles


def bag_metadata(
    topics: Sequence[tuple[str, str, str, str]],
    counts: Sequence[int],
    span_ns: tuple[int, int],
    custom: Mapping[str, str],
) -> dict[str, Any]:
    """rosbag2's description of a one-file bag, the content of metadata.yaml.

    `topics` are (name, type, quality of service as YAML, hash of the type), `counts` their messages.
    """
    start, duration = span_ns[0], span_ns[1] - span_ns[0]
    total = sum(counts)
    return {
        "version": METADATA_VERSION,
        "storage_identifier": "mcap",
        "duration": {"nanoseconds": duration},
        "starting_time": {"nanoseconds_since_epoch": start},
        "message_count": total,
        "topics_with_message_count": [
            {
                "topic_metadata": {
                    "name": name,
                    "type": msgtype,
                    "serialization_format": "cdr",
                    "offered_qos_profiles": qos_profiles(qos),
                    "type_description_hash": type_hash,
                },
                "message_count": count,
            }
            for (name, msgtype, qos, type_hash), count in zip(topics, counts, strict=True)
        ],
        "compression_format": "",
        "compression_mode": "",
        "relative_file_paths": [DATA_FILE],
        "files": [
            {
                "path": DATA_FILE,
                "starting_time": {"nanoseconds_since_epoch": start},
                "duration": {"nanoseconds": duration},
                "message_count": total,
            }
        ],
        "custom_data": dict(custom) or None,
        "ros_distro": "jazzy",
    }


class _PlainDumper(DUMPER):
    """No anchors: rosbag2 reads them, people do not."""

    def ignore_aliases(self, data: Any) -> bool:
        return True


def metadata_text(value: Any) -> str:
    """YAML as rosbag2 writes it: block style, order kept."""
    return yaml.dump(value, Dumper=_PlainDumper, sort_keys=False, default_flow_style=False)
