"""Bags as other recorders write them, made with rosbags."""

import math

import numpy as np
from rosbags.rosbag2 import StoragePlugin
from rosbags.rosbag2 import Writer as Writer2
from rosbags.typesys import Stores, get_typestore

from turtlebag.datasets.bags import cdr
from turtlebag.datasets.se2 import SE2
from turtlebag.datasets.types import Twist

STORE = get_typestore(Stores.ROS2_JAZZY)
TYPES = STORE.types
S = 10**9
SCAN, TF, ODOMETRY = "sensor_msgs/msg/LaserScan", "tf2_msgs/msg/TFMessage", "nav_msgs/msg/Odometry"
TWIST, ARRAY = "geometry_msgs/msg/Twist", "geometry_msgs/msg/PoseArray"
CLOUD, FIELD = "sensor_msgs/msg/PointCloud2", "sensor_msgs/msg/PointField"
LASER = ("base_footprint", "base_scan", (0.3, 0.0, 0.2), (0, 0, 0, 1))
"""Parent, child, position [m] and quaternion of a lidar's link."""


def header(stamp_ns, frame, types=TYPES, **extra):
    time = types["builtin_interfaces/msg/Time"](*divmod(stamp_ns, 10**9))
    return types["std_msgs/msg/Header"](stamp=time, frame_id=frame, **extra)


def laser_scan(stamp_ns, ranges, frame="base_scan", **changes):
    n = len(ranges)
    values = {
        "angle_min": 0.0,
        "angle_max": math.radians(n - 1),
        "angle_increment": math.radians(1.0),
        "time_increment": 0.0,
        "scan_time": 0.2,
        "range_min": 0.12,
        "range_max": 3.5,
    }
    return TYPES["sensor_msgs/msg/LaserScan"](
        header=header(stamp_ns, frame),
        ranges=np.asarray(ranges, dtype=np.float32),
        intensities=np.zeros(0, dtype=np.float32),
        **{**values, **changes},
    )


def transform(stamp_ns, parent, child, xyz, quaternion):
    vector = TYPES["geometry_msgs/msg/Vector3"](*xyz)
    rotation = TYPES["geometry_msgs/msg/Quaternion"](*quaternion)
    return TYPES["geometry_msgs/msg/TransformStamped"](
        header(stamp_ns, parent), child, TYPES["geometry_msgs/msg/Transform"](vector, rotation)
    )


def write_foreign(folder, messages, storage=StoragePlugin.MCAP):
    """`messages`: (topic, type, log time, message)."""
    with Writer2(folder, version=9, storage_plugin=storage) as writer:
        connections = {}
        for topic, msgtype, time, message in messages:
            if topic not in connections:
                connections[topic] = writer.add_connection(topic, msgtype, typestore=STORE)
            writer.write(connections[topic], time, bytes(STORE.serialize_cdr(message, msgtype)))
    return folder


def tf(*transforms):
    return TYPES[TF](list(transforms))


def odometry(stamp_ns, x, frame="odom", child="base_footprint"):
    layout = cdr.odometry(frame, child, cdr.NO_COVARIANCE)
    (data,) = layout.messages([layout.row(stamp_ns, SE2.from_xyt(x, 0.0, 0.0), Twist())])
    return STORE.deserialize_cdr(data, ODOMETRY)
