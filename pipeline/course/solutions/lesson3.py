"""Lesson 3 solved: Gauss-Newton over all poses."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from turtlebag.datasets.se2 import SE2, Array
from turtlebag.pipeline.slam.graph.constraints import Constraint


class BackEnd:
    """Linearise, solve, move; the first pose is held."""

    def optimise(self, T_map_keys: SE2, constraints: Sequence[Constraint], iterations: int = 30) -> SE2:
        """The poses (n,) of least cost."""
        poses, n = T_map_keys, 3 * len(T_map_keys)
        for _ in range(iterations):
            H, b = 1e-9 * np.eye(n), np.zeros(n)
            H[:3, :3] += 1e9 * np.eye(3)
            for c in constraints:
                self._add(H, b, poses, c)
            step = np.linalg.solve(H, -b).reshape(-1, 3)
            poses = poses @ SE2.from_array(step)
            if np.abs(step).max() < 1e-6:
                break
        return poses

    def _add(self, H: Array, b: Array, poses: SE2, c: Constraint) -> None:
        """One constraint; both poses move in their own frames."""
        T_j_i = (poses[c.j].inverse() @ poses[c.i]).xyt
        e = (SE2.from_array(c.T_i_j).inverse() @ SE2.from_array(T_j_i).inverse()).xyt
        x, y, yaw = T_j_i
        A = -np.array([[np.cos(yaw), -np.sin(yaw), y], [np.sin(yaw), np.cos(yaw), -x], [0.0, 0.0, 1.0]])
        squared = float(e @ c.information @ e)
        weight = c.information / (1.0 + squared / c.cauchy**2) if c.cauchy else c.information
        blocks = ((slice(3 * c.i, 3 * c.i + 3), A), (slice(3 * c.j, 3 * c.j + 3), np.eye(3)))
        for rows, J in blocks:
            b[rows] += J.T @ weight @ e
            for columns, K in blocks:
                H[rows, columns] += J.T @ weight @ K
