"""Our messages in CDR, little endian. Stamps are nanoseconds, poses planar.

Those that come by the hundred a second are packed here, as rosbags serialises them; it does the others.
"""

from __future__ import annotations

import struct
from collections.abc import Sequence
from functools import cache
from math import cos, sin
from typing import Any

import numpy as np
from numpy.typing import NDArray

from turtlebag.datasets.bags.topics import typestore
from turtlebag.datasets.se2 import SE2, Array
from turtlebag.datasets.types import Imu, Joints, Scan, Twist

NO_COVARIANCE = np.zeros(36)
# What every message begins with, and the layouts of numbers.
_FRONT = b"\x00\x01\x00\x00"
_STAMP, _LIDAR = struct.Struct("<iI"), struct.Struct("<7fI")
_DOUBLES = [struct.Struct(f"<{n}d").pack for n in range(14)]
_UNKNOWN_ORIENTATION = _DOUBLES[13](0.0, 0.0, 0.0, 1.0, -1.0, *[0.0] * 8)


def _make(kind: str, *fields: Any) -> Any:
    return typestore().types[kind](*fields)


def _bytes(kind: str, *fields: Any) -> bytes:
    return bytes(typestore().serialize_cdr(_make(kind, *fields), kind))


def _stamp(stamp_ns: int) -> Any:
    return _make("builtin_interfaces/msg/Time", *divmod(stamp_ns, 1_000_000_000))


def _header(stamp_ns: int, frame: str) -> Any:
    return _make("std_msgs/msg/Header", _stamp(stamp_ns), frame)


def _vector(x: float, y: float, z: float, kind: str = "Vector3") -> Any:
    return _make(f"geometry_msgs/msg/{kind}", x, y, z)


def _turn(yaw: float) -> Any:
    return _make("geometry_msgs/msg/Quaternion", 0.0, 0.0, sin(0.5 * yaw), cos(0.5 * yaw))


def _pose(x: float, y: float, yaw: float) -> Any:
    return _make("geometry_msgs/msg/Pose", _vector(x, y, 0.0, "Point"), _turn(yaw))


def _with_covariance(kind: str, value: Any, covariance: Array) -> Any:
    return _make(f"geometry_msgs/msg/{kind}WithCovariance", value, covariance)


def odometry(frame: str, child: str, stamp_ns: int, T: SE2, velocity: Twist, covariance: Array) -> bytes:
    """nav_msgs/Odometry; `covariance` (36,) of the pose."""
    x, y, yaw = T.xyt.tolist()
    pose = _DOUBLES[7](x, y, 0.0, 0.0, 0.0, sin(0.5 * yaw), cos(0.5 * yaw))
    front = _FRONT + _seconds(stamp_ns) + _constant(8, frame, child)
    return front + pose + covariance.tobytes() + _twist(velocity) + NO_COVARIANCE.tobytes()


def transforms(stamp_ns: int, links: Sequence[tuple[str, str, tuple[float, float, float], float]]) -> bytes:
    """tf2_msgs/TFMessage with (parent, child, (x, y, z), yaw) each."""
    body = len(links).to_bytes(4, "little")
    for parent, child, xyz, yaw in links:
        body += _seconds(stamp_ns) + _constant(len(body) + 8, parent, child)
        body += _DOUBLES[7](*xyz, 0.0, 0.0, sin(0.5 * yaw), cos(0.5 * yaw))
    return _FRONT + body


def joint_state(frame: str, names: Sequence[str], joints: Joints) -> bytes:
    """sensor_msgs/JointState."""
    n = len(names)
    front = _FRONT + _seconds(joints.stamp_ns) + _constant(8, frame, n, *names, n)
    return front + _DOUBLES[n](*joints.position) + _constant(0, n) + _DOUBLES[n](*joints.velocity) + bytes(4)


def imu(frame: str, sample: Imu, gyro_covariance: Array, acceleration_covariance: Array) -> bytes:
    """sensor_msgs/Imu without orientation; covariances (9,)."""
    front = _FRONT + _seconds(sample.stamp_ns) + _constant(8, frame) + _UNKNOWN_ORIENTATION
    gyro = sample.angular_velocity.tobytes() + gyro_covariance.tobytes()
    return front + gyro + sample.linear_acceleration.tobytes() + acceleration_covariance.tobytes()


def laser_scan(frame: str, scan: Scan) -> bytes:
    """sensor_msgs/LaserScan; its stamp is that of the first beam."""
    lidar = scan.lidar
    last = lidar.angle_min + (lidar.n_beams - 1) * lidar.angle_increment
    angles = lidar.angle_min, last, lidar.angle_increment
    limits = lidar.time_increment, lidar.scan_time, lidar.range_min, lidar.range_max
    front = _FRONT + _seconds(scan.stamp_ns) + _constant(8, frame, to=4)
    ranges = scan.ranges.astype("<f4")
    return front + _LIDAR.pack(*angles, *limits, len(ranges)) + ranges.tobytes() + bytes(4)


def twist(velocity: Twist) -> bytes:
    """geometry_msgs/Twist."""
    return _FRONT + _twist(velocity)


def _twist(velocity: Twist) -> bytes:
    return _DOUBLES[6](velocity.v, 0.0, 0.0, 0.0, 0.0, velocity.w)


def _seconds(stamp_ns: int) -> bytes:
    return _STAMP.pack(*divmod(stamp_ns, 1_000_000_000))


@cache
def _constant(at: int, *parts: str | int, to: int = 8) -> bytes:
    """Texts and counts as they stand from byte `at` of a message's body on, up to values of `to` bytes."""
    body = bytes(at)
    for part in parts:
        body += bytes(-len(body) % 4)
        text = part.encode() + b"\0" if isinstance(part, str) else b""
        body += (part if isinstance(part, int) else len(text)).to_bytes(4, "little") + text
    return (body + bytes(-len(body) % to))[at:]


def string(text: str) -> bytes:
    """std_msgs/String."""
    return _bytes("std_msgs/msg/String", text)


def pose_stamped(frame: str, stamp_ns: int, T: SE2) -> bytes:
    """geometry_msgs/PoseStamped."""
    return _bytes("geometry_msgs/msg/PoseStamped", _header(stamp_ns, frame), _pose(*T.xyt.tolist()))


def pose_with_covariance(frame: str, stamp_ns: int, T: SE2, covariance: Array) -> bytes:
    """geometry_msgs/PoseWithCovarianceStamped; `covariance` (3, 3) of x, y, yaw."""
    pose = _with_covariance("Pose", _pose(*T.xyt.tolist()), planar_covariance(covariance))
    return _bytes("geometry_msgs/msg/PoseWithCovarianceStamped", _header(stamp_ns, frame), pose)


def planar_covariance(covariance: Array) -> Array:
    """(3, 3) covariance of x, y, yaw as ROS's row-major 6x6, (36,)."""
    full = np.zeros((6, 6))
    full[np.ix_((0, 1, 5), (0, 1, 5))] = covariance
    return full.ravel()


def pose_array(frame: str, stamp_ns: int, poses: SE2) -> bytes:
    """geometry_msgs/PoseArray of planar poses (n,), of which there are thousands: put together here."""
    begun = _bytes("geometry_msgs/msg/PoseArray", _header(stamp_ns, frame), [])
    rows = np.zeros((len(poses.xyt), 7))
    rows[:, :2] = poses.xy
    rows[:, 5], rows[:, 6] = np.sin(0.5 * poses.yaw), np.cos(0.5 * poses.yaw)
    # the number of poses stands last; the first one begins at a multiple of 8 after the 4 bytes of the front
    padding = bytes(-(len(begun) - 4) % 8 if len(rows) else 0)
    return begun[:-4] + len(rows).to_bytes(4, "little") + padding + rows.astype("<f8").tobytes()


def path(frame: str, stamp_ns: int, poses: SE2) -> bytes:
    """nav_msgs/Path of planar poses (n,)."""
    header = _header(stamp_ns, frame)
    stops = [_make("geometry_msgs/msg/PoseStamped", header, _pose(*row)) for row in poses.xyt.tolist()]
    return _bytes("nav_msgs/msg/Path", header, stops)


def occupancy_grid(
    frame: str, stamp_ns: int, cells: NDArray[np.int8], resolution: float, origin: Array
) -> bytes:
    """nav_msgs/OccupancyGrid from (rows, cols) cells and the grid's origin (x, y, yaw)."""
    rows, columns = cells.shape
    corner = _pose(*origin.tolist())
    about = _make("nav_msgs/msg/MapMetaData", _stamp(stamp_ns), resolution, columns, rows, corner)
    return _bytes("nav_msgs/msg/OccupancyGrid", _header(stamp_ns, frame), about, cells.ravel())


def point_cloud(frame: str, stamp_ns: int, points: Array, times: Array | None = None) -> bytes:
    """sensor_msgs/PointCloud2 of points (n, 3) and, where given, times after the stamp (n,) [s]."""
    names = ("x", "y", "z") if times is None else ("x", "y", "z", "time")
    table = points if times is None else np.column_stack([points, times])
    fields = [_make("sensor_msgs/msg/PointField", name, 4 * k, 7, 1) for k, name in enumerate(names)]
    data, step = np.frombuffer(table.astype("<f4").tobytes(), dtype=np.uint8), 4 * len(names)
    layout = False, step, step * len(points), data, True
    header = _header(stamp_ns, frame)
    return _bytes("sensor_msgs/msg/PointCloud2", header, 1, len(points), fields, *layout)
