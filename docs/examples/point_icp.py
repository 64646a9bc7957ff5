"""Point-to-point ICP (Besl and McKay 1992) as a front end: aligns each scan with the last key scans."""

import numpy as np
from scipy.spatial import cKDTree

from turtlebag.datasets.se2 import compose
from turtlebag.pipeline.slam.odometry.front_end import Placed

KEYS, CELL_M, SIGMA_M, LEAST = 8, 0.04, 0.02, 20
"""Number of key scans to match, cell size of their map (one point each), a point's error, fewest pairs."""
GATES_M = np.geomspace(0.6, 0.1, 12)
"""Largest distance of a pair, by round."""


class PointIcp:
    """Starts from the odometry and from constant velocity; the better fit wins."""

    def __init__(self, tracker):
        self._tracker = tracker
        self._keys, self._map = 0, None

    def step(self, points, odometry_step, wait_s):
        """As in `turtlebag.pipeline.slam.odometry.front_end.FrontEnd`."""
        steps = [self._tracker.velocity] if odometry_step is None else [odometry_step, self._tracker.velocity]
        tries = [self._placed(points, compose(self._tracker.pose, step)) for step in steps]
        return max(tries, key=lambda placed: placed.overlap)

    def _placed(self, points, start):
        tree, normals = self._last_key_scans()
        pose = start
        for gate in GATES_M:
            seen = _moved(pose, points)
            off, partner = tree.query(seen)
            near = off < gate
            if near.sum() < LEAST:
                return Placed(start, np.zeros((3, 3)), 0.0)
            pose = compose(_rigid(seen[near], tree.data[partner[near]]), pose)
        information = _along_normals(pose, points[near], normals[partner[near]])
        return Placed(pose, information, float(near.mean()), float(np.sqrt(np.mean(off[near] ** 2))))

    def _last_key_scans(self):
        """Their points as a k-d tree, and the normals there (n, 2), zero where there is no surface."""
        tracker, clouds, parts = self._tracker, self._tracker.clouds, []
        if self._keys != len(tracker.keys):
            self._keys = len(tracker.keys)
            for key, pose in zip(*tracker.last_keys(KEYS), strict=True):
                rows = slice(clouds.starts[key], clouds.starts[key + 1])
                normals = _moved([0, 0, pose[2]], clouds.normals[rows]) * clouds.line_ok[rows, None]
                parts.append(np.hstack([_moved(pose, clouds.points[rows]), normals]))
            rows = np.concatenate(parts)
            first = np.unique(np.round(rows[:, :2] / CELL_M), axis=0, return_index=True)[1]
            self._map = cKDTree(rows[first, :2]), rows[first, 2:]
        return self._map


def _moved(pose, points):
    c, s = np.cos(pose[2]), np.sin(pose[2])
    return points @ np.array([[c, s], [-s, c]]) + pose[:2]


def _rigid(points, targets):
    """The rigid motion (3,) that best fits points to targets, in their common frame."""
    a, b = points - points.mean(axis=0), targets - targets.mean(axis=0)
    yaw = np.arctan2(np.sum(a[:, 0] * b[:, 1] - a[:, 1] * b[:, 0]), np.sum(a * b))
    return np.array([*(targets.mean(axis=0) - _moved([0, 0, yaw], points.mean(axis=0))), yaw])


def _along_normals(pose, points, normals):
    """Information (3, 3) of the points in the base frame: across the surfaces only."""
    across = _moved([0, 0, -pose[2]], normals)
    rows = np.column_stack([across, points[:, 0] * across[:, 1] - points[:, 1] * across[:, 0]])
    return rows.T @ rows / SIGMA_M**2
