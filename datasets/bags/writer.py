"""Record observations, commands and ground truth to a rosbag2 folder with one MCAP file."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping, Sequence
from pathlib import Path
from typing import TypeVarTuple

import numpy as np

from turtlebag.datasets.bags import cdr
from turtlebag.datasets.bags.folder import BagFolder
from turtlebag.datasets.bags.topics import TOPICS, definition, metadata_text
from turtlebag.datasets.grid import OccupancyGrid
from turtlebag.datasets.se2 import SE2, Array
from turtlebag.datasets.types import Cloud, Observation, Odometry, Scan, Twist

Fields = TypeVarTuple("Fields")
_POSE_COVARIANCE = np.diag([1e-5, 1e-5, 1e12, 1e12, 1e12, 1e-3]).ravel()
"""Diagonal that the TurtleBot3's odometry publishes: z, roll and pitch are not measured."""
_GYRO_COVARIANCE, _ACCELERATION_COVARIANCE = 4e-8 * np.eye(3).ravel(), 2.89e-4 * np.eye(3).ravel()
_IMU = cdr.imu("imu_link", _GYRO_COVARIANCE, _ACCELERATION_COVARIANCE)
_JOINTS = cdr.joint_state("base_link", ("wheel_left_joint", "wheel_right_joint"))
_ODOMETRY = cdr.odometry("odom", "base_footprint", _POSE_COVARIANCE)
_TRUTH = cdr.odometry("world", "base_footprint", cdr.NO_COVARIANCE)
_ODOM_TO_BASE, _MAP_TO_ODOM = cdr.transform("odom", "base_footprint"), cdr.transform("map", "odom")
_TWIST = cdr.twist()


class BagWriter(BagFolder):
    """Writes a bag of our topics; a context manager.

    A chunk reaches the operating system after each second of recording at the latest, so a kill
    loses less than two. metadata.yaml and the file's index are written by `close` only.
    """

    lidars: Sequence[str] = ("",)
    """The ends of the lidars' topics and frames, by their number."""

    def __init__(self, folder: Path, *, custom: Mapping[str, str], lidars: Iterable[str] = ("",)) -> None:
        super().__init__(folder, custom=custom)
        self._channel_of: dict[str, int] = {}
        self.lidars = tuple(lidars)

    def static_transforms(
        self, stamp_ns: int, links: Sequence[tuple[str, str, tuple[float, float, float], float]]
    ) -> None:
        """/tf_static: (parent, child, (x, y, z) [m], yaw [rad]) of each link."""
        self._write("/tf_static", stamp_ns, cdr.transforms, stamp_ns, links)

    def observation(self, observation: Observation) -> None:
        """/imu, /odom, /tf, /joint_states and, when a sweep was completed, /scan."""
        for sample in observation.imu:
            self._write("/imu", sample.stamp_ns, _IMU, sample)
        self.odometry(observation.odometry)
        self._write("/joint_states", observation.joints.stamp_ns, _JOINTS, observation.joints)
        if observation.scan is not None:
            self.scan(observation.stamp_ns, observation.scan)

    def odometry(self, odometry: Odometry) -> None:
        """/odom and its transform on /tf."""
        stamp, T = odometry.stamp_ns, odometry.T_odom_base
        self._write("/odom", stamp, _ODOMETRY, stamp, T, odometry.twist)
        self._write("/tf", stamp, _ODOM_TO_BASE, stamp, T)

    def truth(self, stamp_ns: int, T_world_base: SE2, twist: Twist) -> None:
        """/ground_truth/odom, in the frame world; never in /tf."""
        self._write("/ground_truth/odom", stamp_ns, _TRUTH, stamp_ns, T_world_base, twist)

    def command(self, stamp_ns: int, twist: Twist) -> None:
        """/cmd_vel; a Twist has no header, its time is the log time."""
        self._write("/cmd_vel", stamp_ns, _TWIST, twist)

    def owner(self, stamp_ns: int, owner: str) -> None:
        """/cmd_vel_owner: the source of the commands from now on."""
        self._write("/cmd_vel_owner", stamp_ns, cdr.string, owner)

    def map(self, stamp_ns: int, grid: OccupancyGrid) -> None:
        """/map."""
        fields = "map", stamp_ns, grid.cells, grid.resolution, grid.T_map_grid.xyt
        self._write("/map", stamp_ns, cdr.occupancy_grid, *fields)

    def amcl_pose(self, stamp_ns: int, T_map_base: SE2, covariance: Array) -> None:
        """/amcl_pose with the (3, 3) covariance of x, y, yaw."""
        self._write("/amcl_pose", stamp_ns, cdr.pose_with_covariance, "map", stamp_ns, T_map_base, covariance)

    def map_to_odom(self, stamp_ns: int, T_map_odom: SE2) -> None:
        """The localiser's transform, on /tf."""
        self._write("/tf", stamp_ns, _MAP_TO_ODOM, stamp_ns, T_map_odom)

    def particles(self, stamp_ns: int, T_map_base: SE2) -> None:
        """/particlecloud from a batch of poses (n,)."""
        self._write("/particlecloud", stamp_ns, cdr.pose_array, "map", stamp_ns, T_map_base)

    def plan(self, stamp_ns: int, T_map_base: SE2) -> None:
        """/plan from a batch of poses (n,)."""
        self._write("/plan", stamp_ns, cdr.path, "map", stamp_ns, T_map_base)

    def goal(self, stamp_ns: int, T_map_goal: SE2) -> None:
        """/goal_pose."""
        self._write("/goal_pose", stamp_ns, cdr.pose_stamped, "map", stamp_ns, T_map_goal)

    def scan(self, log_time_ns: int, scan: Scan) -> None:
        """/scan, or that of another lidar; its header has the stamp of the first beam, the log time is when
        it was complete."""
        name = self.lidars[scan.sensor]
        self._write(f"/scan{name}", log_time_ns, cdr.laser_scan, f"base_scan{name}", scan)

    def cloud(self, log_time_ns: int, stamp_ns: int, cloud: Cloud, frame: str) -> None:
        """/points: a 3D scan in the given lidar frame, its stamp that of the first point."""
        self._write("/points", log_time_ns, cdr.point_cloud, frame, stamp_ns, cloud.points, cloud.times)

    def _write(
        self, topic: str, log_time_ns: int, make: Callable[[*Fields], bytes] | cdr.Layout, *fields: *Fields
    ) -> None:
        """A message that `make` serialises, or of a layout."""
        channel = self._channel_of.get(topic)
        if channel is None:
            kind = TOPICS["/scan" if topic.startswith("/scan") else topic]
            text, type_hash = definition(kind.msgtype)
            qos = metadata_text(kind.qos())
            channel = self.add_topic(topic, kind.msgtype, text, qos=qos, type_hash=type_hash)
            self._channel_of[topic] = channel
        if isinstance(make, cdr.Layout):
            self.write_row(channel, log_time_ns, make, make.row(*fields))
        else:
            self.write(channel, log_time_ns, make(*fields))
