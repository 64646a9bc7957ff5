"""Record observations, commands and ground truth to a rosbag2 folder with one MCAP file."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path

from turtlebag.datasets.bags import cdr
from turtlebag.datasets.bags.folder import BagFolder
from turtlebag.datasets.bags.topics import TOPICS, definition, metadata_text
from turtlebag.datasets.grid import OccupancyGrid
from turtlebag.datasets.se2 import SE2, Array
from turtlebag.datasets.types import Cloud, Imu, LidarSpec, Observation, Odometry, Scan, Twist

_POSE_VARIANCES = (1e-5, 1e-5, 1e12, 1e12, 1e12, 1e-3)
"""Diagonal that the TurtleBot3's odometry publishes: z, roll and pitch are not measured."""
_TRUTH_VARIANCES = (0.0,) * 6
_WHEELS = ("wheel_left_joint", "wheel_right_joint")
_GYRO_VARIANCE, _ACCELERATION_VARIANCE = 4e-8, 2.89e-4


class BagWriter(BagFolder):
    """Writes a bag of our topics; a context manager.

    A chunk reaches the operating system after each second of recording at the latest, so a kill
    loses less than two. metadata.yaml and the file's index are written by `close` only; Ctrl-C
    closes properly, any other error leaves the bag visibly unfinished, for `bag recover`.
    """

    def __init__(self, folder: Path, *, custom: Mapping[str, str]) -> None:
        super().__init__(folder, custom=custom)
        self._channels: dict[str, int] = {}
        self._odom = cdr.odometry("odom", "base_footprint", _POSE_VARIANCES)
        self._truth = cdr.odometry("world", "base_footprint", _TRUTH_VARIANCES)
        self._tf_odom = cdr.transform("odom", "base_footprint")
        self._tf_map = cdr.transform("map", "odom")
        self._joints = cdr.joint_state("base_link", _WHEELS)
        self._imu = cdr.imu("imu_link", _GYRO_VARIANCE, _ACCELERATION_VARIANCE)
        self._twist = cdr.twist()
        self._amcl = cdr.pose_with_covariance("map")
        self._goal = cdr.pose_stamped("map")
        self._scans: dict[LidarSpec, cdr.Template] = {}

    def static_transforms(
        self, stamp_ns: int, links: Sequence[tuple[str, str, tuple[float, float, float], float]]
    ) -> None:
        """/tf_static: (parent, child, (x, y, z) [m], yaw [rad]) of each link."""
        self._write("/tf_static", stamp_ns, cdr.transforms(stamp_ns, links))

    def observation(self, observation: Observation) -> None:
        """/imu, /odom, /tf, /joint_states and, when a sweep was completed, /scan."""
        for sample in observation.imu:
            self._imu_sample(sample)
        self.odometry(observation.odometry)
        self._joints.patch_doubles("position", observation.joints.position)
        self._joints.patch_doubles("velocity", observation.joints.velocity)
        self._patched("/joint_states", self._joints, observation.joints.stamp_ns)
        if observation.scan is not None:
            self.scan(observation.stamp_ns, observation.scan)

    def odometry(self, odometry: Odometry) -> None:
        """/odom and its transform on /tf."""
        self._odom.patch_twist(odometry.twist.v, odometry.twist.w)
        self._patched("/odom", self._odom, odometry.stamp_ns, odometry.T_odom_base)
        self._patched("/tf", self._tf_odom, odometry.stamp_ns, odometry.T_odom_base)

    def truth(self, stamp_ns: int, T_world_base: SE2, twist: Twist) -> None:
        """/ground_truth/odom, in the frame world; never in /tf."""
        self._truth.patch_twist(twist.v, twist.w)
        self._patched("/ground_truth/odom", self._truth, stamp_ns, T_world_base)

    def command(self, stamp_ns: int, twist: Twist) -> None:
        """/cmd_vel; a Twist has no header, its time is the log time."""
        self._twist.patch_twist(twist.v, twist.w)
        self._write("/cmd_vel", stamp_ns, bytes(self._twist.data))

    def owner(self, stamp_ns: int, owner: str) -> None:
        """/cmd_vel_owner: the source of the commands from now on."""
        self._write("/cmd_vel_owner", stamp_ns, bytes(cdr.Template().string(owner).data))

    def map(self, stamp_ns: int, grid: OccupancyGrid) -> None:
        """/map."""
        data = cdr.occupancy_grid("map", stamp_ns, grid.cells, grid.resolution, grid.T_map_grid.xyt)
        self._write("/map", stamp_ns, data)

    def amcl_pose(self, stamp_ns: int, T_map_base: SE2, covariance: Array) -> None:
        """/amcl_pose with the (3, 3) covariance of x, y, yaw."""
        self._amcl.patch_doubles("covariance", cdr.planar_covariance(covariance))
        self._patched("/amcl_pose", self._amcl, stamp_ns, T_map_base)

    def map_to_odom(self, stamp_ns: int, T_map_odom: SE2) -> None:
        """The localiser's transform, on /tf."""
        self._patched("/tf", self._tf_map, stamp_ns, T_map_odom)

    def particles(self, stamp_ns: int, T_map_base: SE2) -> None:
        """/particlecloud from a batch of poses (n,)."""
        self._write("/particlecloud", stamp_ns, cdr.pose_array("map", stamp_ns, T_map_base))

    def plan(self, stamp_ns: int, T_map_base: SE2) -> None:
        """/plan from a batch of poses (n,)."""
        self._write("/plan", stamp_ns, cdr.path("map", stamp_ns, T_map_base))

    def goal(self, stamp_ns: int, T_map_goal: SE2) -> None:
        """/goal_pose."""
        self._patched("/goal_pose", self._goal, stamp_ns, T_map_goal)

    def _imu_sample(self, sample: Imu) -> None:
        self._imu.patch_doubles("angular", sample.angular_velocity.tolist())
        self._imu.patch_doubles("linear", sample.linear_acceleration.tolist())
        self._patched("/imu", self._imu, sample.stamp_ns)

    def scan(self, log_time_ns: int, scan: Scan) -> None:
        """/scan; its header has the stamp of the first beam, the log time is when it was complete."""
        template = self._scans.get(scan.lidar)
        if template is None:
            lidar = scan.lidar
            last = lidar.angle_min + (lidar.n_beams - 1) * lidar.angle_increment
            template = self._scans[lidar] = cdr.laser_scan(
                "base_scan",
                (
                    lidar.angle_min,
                    last,
                    lidar.angle_increment,
                    lidar.time_increment,
                    lidar.scan_time,
                    lidar.range_min,
                    lidar.range_max,
                ),
                lidar.n_beams,
            )
        template.patch_stamp(scan.stamp_ns)
        start = template.places["ranges"]
        template.data[start : start + 4 * scan.lidar.n_beams] = scan.ranges.astype("<f4").tobytes()
        self._write("/scan", log_time_ns, bytes(template.data))

    def cloud(self, log_time_ns: int, stamp_ns: int, cloud: Cloud, frame: str) -> None:
        """/points: a 3D scan in the given lidar frame, its stamp that of the first point."""
        self._write("/points", log_time_ns, cdr.point_cloud(frame, stamp_ns, cloud.points, cloud.times))

    def _patched(self, topic: str, template: cdr.Template, stamp_ns: int, T: SE2 | None = None) -> None:
        """Write what the template holds with this stamp and, if given, this pose."""
        template.patch_stamp(stamp_ns)
        if T is not None:
            template.patch_pose(*T.xyt.tolist())
        self._write(topic, stamp_ns, bytes(template.data))

    def _write(self, topic: str, log_time_ns: int, data: bytes) -> None:
        channel = self._channels.get(topic)
        if channel is None:
            channel = self._channels[topic] = self._register(topic)
        self.write(channel, log_time_ns, data)

    def _register(self, topic: str) -> int:
        kind = TOPICS[topic]
        text, type_hash = definition(kind.msgtype)
        return self.add_topic(topic, kind.msgtype, text, qos=metadata_text(kind.qos()), type_hash=type_hash)
