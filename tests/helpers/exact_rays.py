"""What a lidar measures between walls, exactly and without the simulator."""

import numpy as np

from turtlebag.datasets.se2 import SE2, Array
from turtlebag.datasets.types import LidarSpec


def rectangle(x0: float, y0: float, x1: float, y1: float) -> Array:
    """Four walls, (4, 4) as (xa, ya, xb, yb)."""
    return np.array([[x0, y0, x1, y0], [x1, y0, x1, y1], [x1, y1, x0, y1], [x0, y1, x0, y0]], dtype=float)


def ranges_to(walls: Array, T_room_lidar: SE2, angles: Array, range_max: float) -> Array:
    """Range of each beam to walls (m, 4), from one pose or one a beam; inf beyond range_max."""
    yaw = T_room_lidar.yaw + angles
    d = np.stack([np.cos(yaw), np.sin(yaw)], axis=-1)
    o = np.broadcast_to(T_room_lidar.xy, d.shape)
    a, e = walls[:, :2], walls[:, 2:] - walls[:, :2]
    w = a[None] - o[:, None]
    cross = d[:, None, 0] * e[None, :, 1] - d[:, None, 1] * e[None, :, 0]
    with np.errstate(divide="ignore", invalid="ignore"):
        t = (w[..., 0] * e[None, :, 1] - w[..., 1] * e[None, :, 0]) / cross
        u = (w[..., 0] * d[:, None, 1] - w[..., 1] * d[:, None, 0]) / cross
    nearest = np.where((t > 0.0) & (u >= 0.0) & (u <= 1.0), t, np.inf).min(axis=1)
    return np.where(nearest <= range_max, nearest, np.inf)


def scans_of(walls: Array, poses: Array, lidar: LidarSpec) -> Array:
    """Ranges (n, beams) from poses (n, 3), all beams of a scan at once."""
    return np.array([ranges_to(walls, SE2(pose), lidar.angles, lidar.range_max) for pose in poses])
