"""Point-to-point ICP (Besl and McKay 1992) as a front end: each scan on the points of the last key scans."""

import numpy as np

from turtlebag.datasets.se2 import compose
from turtlebag.pipeline.slam.front_end import Placed

KEYS, CELL_M, SIGMA_M, LEAST = 8, 0.04, 0.02, 20
"""Key scans matched with, a point a cell of their map, a point's error, and the fewest partners."""
GATES_M = np.geomspace(0.6, 0.1, 12)
"""How far off a partner may be, round by round."""


class PointIcp:
    """Begins where the odometry expects the scan, or a steady motion without one."""

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
            seen = _moved(pose, points)
            partner, off = _nearest(seen, known)
            near = off < gate
            if near.sum() < LEAST:
                return Placed(expected, np.zeros((3, 3)), 0.0)
            pose = compose(_rigid(seen[near], known[partner[near]]), pose)
        rmse = float(np.sqrt(np.mean(off[near] ** 2)))
        information = _along_normals(pose, points[near], normals[partner[near]])
        return Placed(pose, information, float(near.mean()), rmse)

    def _last_key_scans(self):
        """Their points and normals (n, 2) in the frame of the track; no normal where there is no surface."""
        course, clouds, parts = self._course, self._course.clouds, []
        if self._keys != len(course.keys):
            self._keys = len(course.keys)
            for key, pose in zip(course.keys[-KEYS:], course.key_poses[-KEYS:], strict=True):
                rows = slice(clouds.starts[key], clouds.starts[key + 1])
                normals = _moved([0, 0, pose[2]], clouds.normals[rows]) * clouds.line_ok[rows, None]
                parts.append(np.hstack([_moved(pose, clouds.points[rows]), normals]))
            rows = np.concatenate(parts)
            first = np.unique(np.round(rows[:, :2] / CELL_M), axis=0, return_index=True)[1]
            self._map = rows[first, :2], rows[first, 2:]
        return self._map


def _moved(pose, points):
    c, s = np.cos(pose[2]), np.sin(pose[2])
    return points @ np.array([[c, s], [-s, c]]) + pose[:2]


def _nearest(points, known):
    off = (points[:, :1] - known[:, 0]) ** 2 + (points[:, 1:] - known[:, 1]) ** 2
    return off.argmin(axis=1), np.sqrt(off.min(axis=1))


def _rigid(points, targets):
    """The motion (3,) that brings points nearest to targets, in the frame of both."""
    a, b = points - points.mean(axis=0), targets - targets.mean(axis=0)
    yaw = np.arctan2(np.sum(a[:, 0] * b[:, 1] - a[:, 1] * b[:, 0]), np.sum(a * b))
    return np.array([*(targets.mean(axis=0) - _moved([0, 0, yaw], points.mean(axis=0))), yaw])


def _along_normals(pose, points, normals):
    """What the points saw (3, 3), in the frame of the base: where the surfaces are, across them."""
    across = _moved([0, 0, -pose[2]], normals)
    rows = np.column_stack([across, points[:, 0] * across[:, 1] - points[:, 1] * across[:, 0]])
    return rows.T @ rows / SIGMA_M**2
