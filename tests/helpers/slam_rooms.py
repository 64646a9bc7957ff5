"""Exact scans of rooms made of line segments, for the mapping tests."""

import math

import numpy as np

from tests.helpers.exact_rays import rectangle, scans_of
from turtlebag.datasets.se2 import SE2
from turtlebag.datasets.types import LidarSpec, Recording
from turtlebag.pipeline.slam.odometry.track import TrackingConfig
from turtlebag.pipeline.slam.odometry.tracker import track_log
from turtlebag.pipeline.slam.odometry.wheels import Wheels
from turtlebag.pipeline.slam.scans.scans import Scans

SICK = LidarSpec(180, -math.pi / 2, math.pi / 180.0, 0.05, 30.0)
LDS = LidarSpec(360, 0.0, math.pi / 180.0, 0.12, 8.0)
ROOM = np.vstack([rectangle(0, 0, 8, 6), rectangle(3, 2, 3.5, 4), rectangle(6, 0, 6.4, 1.5)])
CORRIDOR = np.array([[-100.0, -1.0, 100.0, -1.0], [-100.0, 1.0, 100.0, 1.0]])


def random_poses(n, seed, std=2.0):
    """Poses (n, 3): positions of this standard deviation [m], headings uniform."""
    rng = np.random.default_rng(seed)
    return np.column_stack([rng.normal(0.0, std, (n, 2)), rng.uniform(-3.0, 3.0, n)])


def recording(walls, poses, lidar=LDS, *, noise=0.01, odometry=None, seed=0):
    """A log of instantaneous scans at poses (n, 3), 5 Hz."""
    rng = np.random.default_rng(seed)
    exact = scans_of(walls, poses, lidar)
    ranges = (exact + rng.normal(0.0, noise, exact.shape)).astype(np.float32)
    stamps = (np.arange(len(poses)) * 200_000_000 + 10**9).astype(np.int64)
    T_odom_base = None if odometry is None else SE2.from_array(odometry)
    return Recording("test", stamps, ranges, lidar, SE2.identity(), T_odom_base)


def around_the_room(n=160, *, laps=1):
    """Poses (n, 3) on an oval round the pillar of ROOM, facing along it, starting at angle 0."""
    t = np.linspace(0.0, 2.0 * math.pi * laps, n)
    x, y = 3.25 + 1.9 * np.cos(t), 3.0 + 2.2 * np.sin(t)
    return np.stack([x, y, np.unwrap(np.arctan2(2.2 * np.cos(t), -1.9 * np.sin(t)))], axis=1)


def drifted(poses, *, scale=1.03, bias=0.004, seed=1):
    """Odometry (n, 3) of true poses: 3 % too long, turning `bias` radians a step, and noisy."""
    rng = np.random.default_rng(seed)
    T = SE2.from_array(poses)
    steps = T.steps()
    steps[:, :2] *= scale + 0.02 * rng.normal(size=(len(steps), 1))
    steps[:, 2] += bias + 0.002 * rng.normal(size=len(steps))
    out = [poses[0]]
    for step in steps:
        out.append((SE2(out[-1]) @ SE2(step)).xyt)
    return np.array(out)


def dead_reckoning(log):
    """The track that the odometry of a log draws, as it is."""
    return track_log(Scans.of(log, 30.0), TrackingConfig(calibration=False), Wheels)
