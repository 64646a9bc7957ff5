"""Logs of a robot with two lidars that take turns, each with a mounting of its own."""

import math
from dataclasses import replace

import numpy as np

from tests.helpers.exact_rays import scans_of
from tests.helpers.slam_rooms import ROOM
from turtlebag.datasets.lidars import together
from turtlebag.datasets.se2 import SE2
from turtlebag.datasets.types import LidarSpec, MountedLidar, Recording

HALF = LidarSpec(181, -math.pi / 2, math.pi / 180.0, 0.12, 8.0)
WIDE = LidarSpec(271, -0.75 * math.pi, math.pi / 180.0, 0.12, 8.0)
REAR = SE2.from_xyt(-0.2, 0.05, math.pi)


def two_lidars(poses, *, front=HALF, rear=HALF, odometry=None, noise=0.01, wait_s=0.1, seed=0):
    """Scans at poses (n, 3), by turns of a lidar in front and one at the rear, `wait_s` after it."""
    rng = np.random.default_rng(seed)
    T = SE2.from_array(np.asarray(poses))
    lidars = MountedLidar(front, SE2.from_xyt(0.1, 0.0, 0.0), "/scan"), MountedLidar(rear, REAR, "/scan_rear")
    parts = []
    for number, lidar in enumerate(lidars):
        rows = np.arange(number, len(poses), 2)
        exact = scans_of(ROOM, (T[rows] @ lidar.T_base_lidar).xyt, lidar.spec)
        ranges = (exact + rng.normal(0.0, noise, exact.shape)).astype(np.float32)
        stamps = (rows // 2 * 200_000_000 + round(number * wait_s * 1e9) + 10**9).astype(np.int64)
        part = Recording("test", stamps, ranges, lidar.spec, lidar.T_base_lidar, topic=lidar.topic)
        parts.append(part)
    order = np.argsort(np.concatenate([np.arange(0, len(poses), 2), np.arange(1, len(poses), 2)]))
    T_odom_base = None if odometry is None else SE2.from_array(odometry)
    return replace(together(parts, order), T_odom_base=T_odom_base)
