"""Point-to-point ICP (Besl and McKay 1992) as a front end: each scan on the points of the last key scans."""

import numpy as np

from turtlebag.datasets.se2 import compose
from turtlebag.pipeline.slam.front_end import Placed

KEYS, GATES_M, SIGMA_M, LEAST = 8, np.geomspace(0.6, 0.1, 15), 0.02, 20
"""Key scans matched with; how far off a partner may be, round by round; a point's error; fewest partners."""


class PointIcp:
    """Begins at the pose that the odometry expects, or a steady motion without one."""

    def __init__(self, course):
        self._course = course
        self._keys, self._map = 0, (np.zeros((0, 2)), np.zeros((0, 2)))

    def step(self, points, odometry_step, wait_s):
        """As in `turtlebag.pipeline.slam.front_end.FrontEnd`."""
        course = self._course
        expected = compose(course.pose, course.velocity if odometry_step is None else odometry_step)
        known, normals = self._last_key_scans()
        pose = expected
        for gate in GATES_M:
            seen = moved(pose, points)
            partner, off = nearest(seen, known)
            near = off < gate
            if near.sum() < LEAST:
                return Placed(expected, np.zeros((3, 3)), 0.0)
            pose = compose(rigid(seen[near], known[partner[near]]), pose)
        rmse = float(np.sqrt(np.mean(off[near] ** 2)))
        information = along_normals(pose, points[near], normals[partner[near]])
        return Placed(pose, information, float(near.mean()), rmse)

    def _last_key_scans(self):
        """Their points and normals (n, 2) in the frame of the track; none where there is no surface."""
        course = self._course
        if self._keys != len(course.keys):
            self._keys, clouds, parts = len(course.keys), course.clouds, []
            for key, pose in zip(course.keys[-KEYS:], course.key_poses[-KEYS:], strict=True):
                rows = slice(clouds.starts[key], clouds.starts[key + 1])
                normals = moved([0, 0, pose[2]], clouds.normals[rows]) * clouds.line_ok[rows, None]
                parts.append((moved(pose, clouds.points[rows]), normals))
            self._map = tuple(np.concatenate(part) for part in zip(*parts, strict=True))
        return self._map


def moved(pose, points):
    c, s = np.cos(pose[2]), np.sin(pose[2])
    return points @ np.array([[c, s], [-s, c]]) + pose[:2]


def nearest(points, known):
    off = (points[:, :1] - known[:, 0]) ** 2 + (points[:, 1:] - known[:, 1]) ** 2
    return off.argmin(axis=1), np.sqrt(off.min(axis=1))


def rigid(points, targets):
    """The motion (3,) that brings points nearest to targets, in the frame of both."""
    a, b = points - points.mean(axis=0), targets - targets.mean(axis=0)
    yaw = np.arctan2(np.sum(a[:, 0] * b[:, 1] - a[:, 1] * b[:, 0]), np.sum(a * b))
    return np.array([*(targets.mean(axis=0) - moved([0, 0, yaw], points.mean(axis=0))), yaw])


def along_normals(pose, points, normals):
    """What the points saw (3, 3) in the frame of the base: their place across the surfaces alone."""
    across = moved([0, 0, -pose[2]], normals)
    turn = points[:, 0] * across[:, 1] - points[:, 1] * across[:, 0]
    return np.column_stack([across, turn]).T @ np.column_stack([across, turn]) / SIGMA_M**2
