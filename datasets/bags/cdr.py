"""Serialise ROS 2 messages (CDR, little endian): templates in which only the changing bytes are patched."""

from __future__ import annotations

import struct
from collections.abc import Sequence
from math import cos, sin

import numpy as np

from turtlebag.datasets.se2 import SE2, Array

_STAMP = struct.Struct("<iI")
_POSE = struct.Struct("<2d24x2d")  # x, y; z, qx, qy stay 0; qz, qw
_TWIST = struct.Struct("<d32xd")  # vx; vy, vz, wx, wy stay 0; wz


class Template:
    """A message laid out field by field; named places are patched later.

    Alignment counts from after the 4-byte encapsulation header, as CDR has it.
    """

    def __init__(self) -> None:
        self.data = bytearray(b"\x00\x01\x00\x00")
        self.places: dict[str, int] = {}

    def align(self, size: int) -> None:
        """Pad so that the next field starts at a multiple of `size`."""
        self.data += bytes(-(len(self.data) - 4) % size)

    def field(self, code: str, *values: float, name: str = "") -> Template:
        """Append values of one struct type; `name` remembers the place of the first."""
        item = struct.Struct("<" + code)
        self.align(item.size)
        if name:
            self.places[name] = len(self.data)
        for value in values:
            self.data += item.pack(value)
        return self

    def string(self, text: str) -> Template:
        """Append a string."""
        data = text.encode() + b"\0"
        self.field("I", len(data))
        self.data += data
        return self

    def header(self, frame: str, name: str = "stamp") -> Template:
        """Append a std_msgs/Header; its stamp is the place `name`."""
        return self.field("i", 0, name=name).field("I", 0).string(frame)

    def pose(self, name: str = "pose") -> Template:
        """Append a geometry_msgs/Pose or Transform, identity."""
        return self.field("d", 0, 0, 0, 0, 0, 0, 1, name=name)

    def patch_stamp(self, stamp_ns: int, name: str = "stamp") -> None:
        """Set a stamp."""
        _STAMP.pack_into(self.data, self.places[name], *divmod(stamp_ns, 1_000_000_000))

    def patch_pose(self, x: float, y: float, yaw: float, name: str = "pose") -> None:
        """Set a planar pose."""
        half = 0.5 * yaw
        _POSE.pack_into(self.data, self.places[name], x, y, sin(half), cos(half))

    def patch_twist(self, v: float, w: float) -> None:
        """Set the planar twist at the place `twist`."""
        _TWIST.pack_into(self.data, self.places["twist"], v, w)

    def patch_doubles(self, name: str, values: Sequence[float]) -> None:
        """Set consecutive doubles."""
        struct.pack_into(f"<{len(values)}d", self.data, self.places[name], *values)


def diagonal(values: Sequence[float]) -> list[float]:
    """Row-major square matrix with the given diagonal."""
    return np.diag(np.asarray(values, dtype=np.float64)).ravel().tolist()


def odometry(frame: str, child: str, pose_variances: Sequence[float]) -> Template:
    """nav_msgs/Odometry with the places stamp, pose and twist."""
    template = Template().header(frame).string(child).pose()
    template.field("d", *diagonal(pose_variances))
    return template.field("d", *[0.0] * 6, name="twist").field("d", *[0.0] * 36)


def transform(parent: str, child: str) -> Template:
    """tf2_msgs/TFMessage with one transform: stamp and pose."""
    return Template().field("I", 1).header(parent).string(child).pose()


def transforms(stamp_ns: int, links: Sequence[tuple[str, str, tuple[float, float, float], float]]) -> bytes:
    """tf2_msgs/TFMessage with (parent, child, (x, y, z), yaw) each."""
    template = Template().field("I", len(links))
    for parent, child, xyz, yaw in links:
        template.header(parent).string(child).pose()
        template.patch_stamp(stamp_ns)
        template.patch_pose(xyz[0], xyz[1], yaw)
        struct.pack_into("<d", template.data, template.places["pose"] + 16, xyz[2])
    return bytes(template.data)


def joint_state(frame: str, names: Sequence[str]) -> Template:
    """sensor_msgs/JointState: stamp, position, velocity."""
    template = Template().header(frame).field("I", len(names))
    for name in names:
        template.string(name)
    template.field("I", len(names)).field("d", *[0.0] * len(names), name="position")
    template.field("I", len(names)).field("d", *[0.0] * len(names), name="velocity")
    return template.field("I", 0)


def imu(frame: str, gyro_variance: float, acceleration_variance: float) -> Template:
    """sensor_msgs/Imu without orientation: stamp, angular, linear."""
    template = Template().header(frame).field("d", 0, 0, 0, 1).field("d", -1, *[0] * 8)
    template.field("d", 0, 0, 0, name="angular").field("d", *diagonal([gyro_variance] * 3))
    return template.field("d", 0, 0, 0, name="linear").field("d", *diagonal([acceleration_variance] * 3))


def laser_scan(frame: str, values: Sequence[float], n_beams: int) -> Template:
    """sensor_msgs/LaserScan: stamp, ranges; `values` from angle_min to range_max as in the message."""
    template = Template().header(frame).field("f", *values)
    return template.field("I", n_beams).field("f", *[0.0] * n_beams, name="ranges").field("I", 0)


def twist() -> Template:
    """geometry_msgs/Twist."""
    return Template().field("d", *[0.0] * 6, name="twist")


def pose_stamped(frame: str) -> Template:
    """geometry_msgs/PoseStamped: stamp, pose."""
    return Template().header(frame).pose()


def pose_with_covariance(frame: str) -> Template:
    """geometry_msgs/PoseWithCovarianceStamped: stamp, pose, covariance."""
    return Template().header(frame).pose().field("d", *[0.0] * 36, name="covariance")


def planar_covariance(covariance: Array) -> list[float]:
    """(3, 3) covariance of x, y, yaw as ROS's row-major 6x6."""
    full = np.zeros((6, 6))
    full[np.ix_((0, 1, 5), (0, 1, 5))] = covariance
    return full.ravel().tolist()


def pose_array(frame: str, stamp_ns: int, poses: SE2) -> bytes:
    """geometry_msgs/PoseArray of planar poses (n,)."""
    template = Template().header(frame).field("I", len(poses.xyt))
    template.patch_stamp(stamp_ns)
    if len(poses.xyt):
        template.align(8)
    rows = np.zeros((len(poses.xyt), 7))
    rows[:, :2] = poses.xy
    rows[:, 5], rows[:, 6] = np.sin(0.5 * poses.yaw), np.cos(0.5 * poses.yaw)
    return bytes(template.data) + rows.astype("<f8").tobytes()


def path(frame: str, stamp_ns: int, poses: SE2) -> bytes:
    """nav_msgs/Path of planar poses (n,)."""
    template = Template().header(frame)
    template.patch_stamp(stamp_ns)
    template.field("I", len(poses.xyt))
    for x, y, yaw in poses.xyt.tolist():
        template.header(frame).pose()
        template.patch_stamp(stamp_ns)
        template.patch_pose(x, y, yaw)
    return bytes(template.data)


def occupancy_grid(frame: str, stamp_ns: int, cells: np.ndarray, resolution: float, origin: Array) -> bytes:
    """nav_msgs/OccupancyGrid from (rows, cols) int8 cells and the grid's origin (x, y, yaw)."""
    template = Template().header(frame)
    template.patch_stamp(stamp_ns)
    template.field("i", 0, name="load").field("I", 0).field("f", resolution)
    template.patch_stamp(stamp_ns, "load")
    template.field("I", cells.shape[1], cells.shape[0]).pose()
    x, y, yaw = origin.tolist()
    template.patch_pose(x, y, yaw)
    template.field("I", cells.size)
    return bytes(template.data) + np.ascontiguousarray(cells, dtype=np.int8).tobytes()


def point_cloud(frame: str, stamp_ns: int, points: Array, times: Array | None = None) -> bytes:
    """sensor_msgs/PointCloud2 of points (n, 3) and, where given, times after the stamp (n,) [s]."""
    names = ("x", "y", "z") if times is None else ("x", "y", "z", "time")
    table = points if times is None else np.column_stack([points, times])
    template = Template().header(frame).field("I", 1, len(points), len(names))
    template.patch_stamp(stamp_ns)
    for index, name in enumerate(names):
        template.string(name).field("I", 4 * index).field("B", 7).field("I", 1)
    step = 4 * len(names)
    template.field("B", 0).field("I", step, step * len(points), step * len(points))
    return bytes(template.data) + np.ascontiguousarray(table, dtype="<f4").tobytes() + b"\x01"
