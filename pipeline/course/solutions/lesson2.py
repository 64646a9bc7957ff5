"""Lesson 2 solved: point-to-line ICP."""

from __future__ import annotations

import numpy as np
from scipy.spatial import cKDTree

from turtlebag.datasets.se2 import SE2, Array

LINE_POINTS = 6


class ScanMatcher:
    """Pairs each point with the line through its nearest ones, and solves for the motion."""

    def match(self, points_a: Array, points_b: Array, guess: Array) -> Array:
        """`T_a_b` (3,), by Gauss-Newton over pairs that come nearer."""
        tree, T = cKDTree(points_a), SE2.from_array(guess)
        normals = self._normals(points_a, tree)
        for reach in np.geomspace(0.5, 0.08, 40):
            moved = T @ points_b
            distance, nearest = tree.query(moved)
            near = distance < reach
            normal = normals[nearest[near]]
            turned = moved[near] - T.xy
            residual = np.sum(normal * (moved[near] - points_a[nearest[near]]), axis=1)
            lever = normal[:, 1] * turned[:, 0] - normal[:, 0] * turned[:, 1]
            J = np.column_stack([normal, lever])
            weight = 1.0 / (1.0 + (residual / 0.05) ** 2)
            step = np.linalg.solve(J.T @ (weight[:, None] * J) + 1e-6 * np.eye(3), -J.T @ (weight * residual))
            T = SE2.from_array(T.xyt + step)
        return T.xyt

    def _normals(self, points: Array, tree: cKDTree) -> Array:
        """The direction of least spread around each point, (n, 2)."""
        around = points[tree.query(points, LINE_POINTS)[1]]
        centred = around - around.mean(axis=1, keepdims=True)
        return np.linalg.eigh(np.swapaxes(centred, 1, 2) @ centred)[1][:, :, 0]
