"""Small synthetic bags for the tests."""

import math

import numpy as np

from turtlebag.datasets.bags.writer import BagWriter
from turtlebag.datasets.grid import OccupancyGrid
from turtlebag.datasets.se2 import SE2
from turtlebag.datasets.types import Cloud, Imu, Joints, LidarSpec, Observation, Odometry, Scan, Twist

LIDAR = LidarSpec(360, 0.0, math.radians(1.0), 0.12, 3.5, time_increment=1 / 1800, scan_time=0.2)
LINKS = [
    ("base_footprint", "base_link", (0.0, 0.0, 0.01), 0.0),
    ("base_link", "base_scan", (-0.032, 0.0, 0.172), 0.0),
]


def stamp(step: int) -> int:
    return round(step * 1e9 / 30)


def pose(step: int) -> SE2:
    t = step / 30.0
    return SE2.from_xyt(0.2 * t, math.sin(0.1 * t), 0.1 * t)


def observation(step: int) -> Observation:
    """What a robot on a gentle curve sees; a scan each sixth step."""
    rng = np.random.default_rng(step)
    scan = None
    if step and step % 6 == 0:
        ranges = rng.uniform(0.2, 3.4, 360).astype(np.float32)
        ranges[::7], ranges[3] = np.inf, np.nan
        scan = Scan(stamp(step - 6), ranges, LIDAR)
    imu = tuple(
        Imu(stamp(step - 1) + k * 10**7, rng.normal(size=3), rng.normal(size=3)) for k in (1, 2, 3) if step
    )
    odometry = Odometry(stamp(step), pose(step), Twist(0.2, 0.1))
    joints = Joints(stamp(step), (step * 0.1, step * 0.2), (3.0, 6.0))
    return Observation(stamp(step), odometry, joints, scan, imu)


def write_drive(
    folder, *, seconds: float, navigation: bool = False, truth: bool = True, seed: str = "7"
) -> int:
    """A recorded drive; returns the number of scans."""
    scans = 0
    with BagWriter(folder, custom={"seed": seed}) as writer:
        writer.static_transforms(0, LINKS)
        if navigation:
            cells = np.array([[0, 100, -1], [0, 0, 0]], dtype=np.int8)
            writer.map(0, OccupancyGrid(cells, 0.05, SE2.from_xyt(-1.0, -2.0, 0.0)))
        for step in range(1, round(30 * seconds) + 1):
            writer.command(stamp(step - 1), Twist(0.2, 0.1))
            sample = observation(step)
            scans += sample.scan is not None
            writer.observation(sample)
            if truth:
                writer.truth(stamp(step), pose(step), Twist(0.2, 0.1))
            if navigation and step % 30 == 0:
                batch = SE2.from_array([[0.0, 0.0, 0.0], [1.0, 0.5, 1.0], [2.0, 1.0, -3.0]])
                covariance = np.array([[0.1, 0.01, 0.0], [0.01, 0.2, 0.02], [0.0, 0.02, 0.3]])
                writer.amcl_pose(stamp(step), pose(step), covariance)
                writer.map_to_odom(stamp(step), SE2.from_xyt(0.1, 0.0, 0.0))
                writer.particles(stamp(step), batch)
                writer.plan(stamp(step), batch)
                writer.goal(stamp(step), pose(step))
                writer.owner(stamp(step), "teleop")
                points = np.linspace(-1.0, 1.0, 30).reshape(10, 3)
                writer.cloud(
                    stamp(step), stamp(step - 6), Cloud(points, np.linspace(0.0, 0.1, 10)), "base_scan"
                )
    return scans
