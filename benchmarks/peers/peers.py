"""Libraries of other people as programs: `peer-NAME BAG OUT` reads a bag and writes `OUT/trajectory.tum`.

A pose is that of the robot's base at each scan, by its header stamp. Nothing of ours is imported: what a
program takes is what its library takes, and the reading of the bag by rosbags.
"""

from __future__ import annotations

import argparse
import math
from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

Pose = np.ndarray
"""A planar transform (3, 3)."""


@dataclass(frozen=True)
class Scan:
    """One scan: its stamp [s], the sensor_msgs/LaserScan, and the odometry pose of the base at the stamp."""

    stamp: float
    message: Any
    T_odom_base: Pose

    @property
    def angles(self) -> np.ndarray:
        """Directions of the beams (n,) [rad]."""
        m = self.message
        return np.asarray(m.angle_min + m.angle_increment * np.arange(len(m.ranges)))

    @property
    def met(self) -> np.ndarray:
        """Which beams (n,) came back."""
        ranges = np.asarray(self.message.ranges)
        return np.isfinite(ranges) & (ranges >= self.message.range_min) & (ranges <= self.message.range_max)

    @property
    def points(self) -> np.ndarray:
        """Where they ended (m, 3), in the lidar's frame [m], z = 0."""
        ranges, angles = np.asarray(self.message.ranges)[self.met], self.angles[self.met]
        return np.stack([ranges * np.cos(angles), ranges * np.sin(angles), 0.0 * ranges], axis=1)


def planar(x: float, y: float, yaw: float) -> Pose:
    """The transform of a position [m] and a heading [rad]."""
    c, s = math.cos(yaw), math.sin(yaw)
    return np.array([[c, -s, x], [s, c, y], [0.0, 0.0, 1.0]])


def xyt(T: np.ndarray) -> tuple[float, float, float]:
    """Position [m] and heading [rad] of a transform, (3, 3) or (4, 4)."""
    return float(T[0, -1]), float(T[1, -1]), math.atan2(T[1, 0], T[0, 0])


def _planar_of(position: Any, q: Any) -> Pose:
    yaw = math.atan2(2.0 * (q.w * q.z + q.x * q.y), 1.0 - 2.0 * (q.y**2 + q.z**2))
    return planar(position.x, position.y, yaw)


def read(bag: Path) -> tuple[Pose, list[Scan]]:
    """The pose of the lidar on the base, and the scans of /scan with the odometry of /odom."""
    from rosbags.highlevel import AnyReader
    from rosbags.typesys import Stores, get_typestore

    scans, odometry = [], []
    static: dict[str, Any] = {}
    with AnyReader([bag], default_typestore=get_typestore(Stores.ROS2_HUMBLE)) as reader:
        wanted = [c for c in reader.connections if c.topic in ("/scan", "/odom", "/tf_static")]
        for connection, _, raw in reader.messages(wanted):
            message: Any = reader.deserialize(raw, connection.msgtype)
            if connection.topic == "/tf_static":
                static |= {one.child_frame_id: one for one in message.transforms}
            elif connection.topic == "/odom":
                pose = _planar_of(message.pose.pose.position, message.pose.pose.orientation)
                odometry.append((_seconds(message), *xyt(pose)))
            else:
                scans.append((_seconds(message), message))
    times, x, y, yaw = np.array(odometry).T
    T_base_lidar, frame = np.eye(3), scans[0][1].header.frame_id
    while frame in static:
        step = static[frame].transform
        T_base_lidar = _planar_of(step.translation, step.rotation) @ T_base_lidar
        frame = static[frame].header.frame_id
    yaw = np.unwrap(yaw)
    return T_base_lidar, [
        Scan(stamp, message, planar(*(float(np.interp(stamp, times, one)) for one in (x, y, yaw))))
        for stamp, message in scans
    ]


def _seconds(message: Any) -> float:
    return float(message.header.stamp.sec + 1e-9 * message.header.stamp.nanosec)


def write(out: Path, T_base_lidar: Pose, stamps: Sequence[float], lidars: Iterable[np.ndarray]) -> None:
    """Write poses of the base, in the frame of the first, of poses of the lidar in any frame."""
    inverse, first = np.linalg.inv(T_base_lidar), None
    out.mkdir(parents=True, exist_ok=True)
    with (out / "trajectory.tum").open("w") as file:
        for stamp, T in zip(stamps, lidars, strict=True):
            T_any_base = planar(*xyt(T)) @ inverse
            first = np.linalg.inv(T_any_base) if first is None else first
            x, y, yaw = xyt(first @ T_any_base)
            turn = f"{math.sin(yaw / 2.0):.9f} {math.cos(yaw / 2.0):.9f}"
            print(f"{stamp:.9f} {x:.6f} {y:.6f} 0 0 0 {turn}", file=file)


def _asked(**numbers: float | None) -> argparse.Namespace:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("bag", type=Path)
    parser.add_argument("out", type=Path)
    for name, default in numbers.items():
        parser.add_argument(f"--{name}", type=float, default=default)
    return parser.parse_args()


def kiss_icp() -> None:
    """KISS-ICP's odometry as it comes, the voxel a hundredth of the range; `--voxel` [m] sets another, and
    its thresholds in proportion. One thread, so that it repeats."""
    from kiss_icp.config import KISSConfig
    from kiss_icp.kiss_icp import KissICP

    args = _asked(voxel=None)
    T_base_lidar, scans = read(args.bag)
    config = KISSConfig()
    config.data.max_range = float(scans[0].message.range_max)
    config.mapping.voxel_size = args.voxel or config.data.max_range / 100.0
    config.registration.max_num_threads = 1
    if args.voxel:
        config.adaptive_threshold.initial_threshold *= args.voxel
        config.adaptive_threshold.min_motion_th *= args.voxel
    kiss, poses = KissICP(config), []
    for scan in scans:
        share = np.flatnonzero(scan.met) / len(scan.message.ranges)
        kiss.register_frame(scan.points, share if scan.message.time_increment else np.zeros(0))
        poses.append(kiss.last_pose.copy())
    write(args.out, T_base_lidar, [scan.stamp for scan in scans], poses)


HEIGHTS_M = (0.0, 0.1, 0.2)


def small_gicp() -> None:
    """GICP of each scan on a map of Gaussian voxels, from constant velocity.

    A planar scan is stacked at three heights, or its normals would all be vertical. `--voxel` of the map and
    `--sampling` of the scan [m].
    """
    import small_gicp as gicp

    args = _asked(voxel=1.0, sampling=0.25)
    T_base_lidar, scans = read(args.bag)
    voxels, T, step = gicp.GaussianVoxelMap(args.voxel), np.eye(4), np.eye(4)
    poses: list[np.ndarray] = []
    for scan in scans:
        stacked = np.concatenate([scan.points + np.array([0.0, 0.0, z]) for z in HEIGHTS_M])
        cloud, _ = gicp.preprocess_points(stacked, downsampling_resolution=args.sampling)
        if poses:
            found = gicp.align(voxels, cloud, T @ step, max_correspondence_distance=args.voxel)
            flat = np.eye(4)
            flat[:2, :2], flat[:2, 3] = (
                planar(*xyt(found.T_target_source))[:2, :2],
                found.T_target_source[:2, 3],
            )
            step, T = np.linalg.inv(T) @ flat, flat
        voxels.insert(cloud, T)
        poses.append(T)
    write(args.out, T_base_lidar, [scan.stamp for scan in scans], poses)


def yag_slam() -> None:
    """Karto's matcher and graph by yag-slam, with its default configurations, from the odometry.

    A scan is matched after `--travel` [m] or `--turn` [rad], Karto's defaults; between them the odometry goes
    on. `--resolution` of the matcher's grid [m].
    """
    from yag_slam.graph_slam import GraphSlam
    from yag_slam.helpers import default_config, default_config_loop
    from yag_slam.models import LocalizedRangeScan
    from yag_slam.scan_matching import Scan2DMatcherCpp

    args = _asked(travel=0.2, turn=math.radians(10.0), resolution=default_config["resolution"])
    T_base_lidar, scans = read(args.bag)
    matchers = (
        Scan2DMatcherCpp({**default_config, "resolution": args.resolution}),
        Scan2DMatcherCpp(default_config_loop, loop=True),
    )
    slam = GraphSlam(*matchers)
    keys: list[tuple[Any, Pose]] = []
    key_of: list[int] = []
    for scan in scans:
        T_odom_lidar = scan.T_odom_base @ T_base_lidar
        if keys:
            x, y, yaw = xyt(np.linalg.inv(keys[-1][1]) @ T_odom_lidar)
        if not keys or math.hypot(x, y) >= args.travel or abs(yaw) >= args.turn:
            m, ranges = scan.message, np.where(scan.met, scan.message.ranges, 0.0).tolist()
            angles = float(scan.angles[0]), float(scan.angles[-1]), float(m.angle_increment)
            limits = float(m.range_min), float(m.range_max), float(m.range_max)
            given = LocalizedRangeScan(ranges, *angles, *limits, *xyt(T_odom_lidar))
            slam.process_scan(given)
            keys.append((given, T_odom_lidar))
        key_of.append(len(keys) - 1)
    poses = []
    for scan, key in zip(scans, key_of, strict=True):
        given, T_odom_key = keys[key]
        corrected = given.corrected_pose
        T_map_key = planar(corrected.x, corrected.y, corrected.euler[-1])
        poses.append(T_map_key @ np.linalg.inv(T_odom_key) @ scan.T_odom_base @ T_base_lidar)
    write(args.out, T_base_lidar, [scan.stamp for scan in scans], poses)


ARENA = """
world: {height: 6, width: 6, offset: [-3, -3], step_time: 0.0333333333, sample_time: 0.2}
robot:
  - kinematics: {name: diff}
    shape: {name: circle, radius: 0.1}
    state: [-2.0, -0.5, 0.0]
    sensors: [{name: lidar2d, range_min: 0.12, range_max: 3.5, angle_range: 6.2831853, number: 360}]
obstacle:
  - shape: {name: linestring, vertices: [[2.93, 0], [1.47, 2.54], [-1.47, 2.54], [-2.93, 0], [-1.47, -2.54],
                                         [1.47, -2.54], [2.93, 0]]}
    state: [0, 0, 0]
"""
PILLARS = [(x, y) for x in (-1.1, 0.0, 1.1) for y in (-1.1, 0.0, 1.1)]


def ir_sim() -> None:
    """IR-SIM for `--seconds`: a robot that turns among the walls and pillars of our arena, its lidar of
    360 beams at 5 Hz and its wheels at 30 Hz as ours. Nothing is recorded."""
    import irsim
    import yaml

    parser = argparse.ArgumentParser(description=ir_sim.__doc__)
    parser.add_argument("out", type=Path)
    parser.add_argument("--seconds", type=float, default=200.0)
    args = parser.parse_args()
    args.out.mkdir(parents=True, exist_ok=True)
    world = yaml.safe_load(ARENA)
    world["obstacle"] += [{"shape": {"name": "circle", "radius": 0.15}, "state": [*at]} for at in PILLARS]
    (args.out / "arena.yaml").write_text(yaml.safe_dump(world))
    env = irsim.make(str(args.out / "arena.yaml"), display=False, log_level="ERROR")
    for _ in range(round(30 * args.seconds)):
        env.step(np.array([[0.0], [0.6]]))
    env.end(0)
