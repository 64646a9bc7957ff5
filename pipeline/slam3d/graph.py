"""The pose graph in space: constraints between key clouds, optimised by GTSAM."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

import gtsam
import numpy as np

from turtlebag.datasets import se3
from turtlebag.datasets.se2 import Array
from turtlebag.pipeline.slam.factors import Constraint, noise, solved

# Keeps information matrices positive definite without saying anything.
FLOOR = 1e-4 * np.eye(6)
G2O_ORDER = np.array([3, 4, 5, 0, 1, 2])
"""g2o writes translation before rotation."""


def optimise(T_map_keys: Array, constraints: Sequence[Constraint], iterations: int = 30) -> Array:
    """Least squares poses (n, 4, 4) with the first one held; Levenberg-Marquardt."""
    graph, values = gtsam.NonlinearFactorGraph(), gtsam.Values()
    fixed = gtsam.noiseModel.Isotropic.Sigma(6, 1e-6)
    graph.add(gtsam.PriorFactorPose3(0, gtsam.Pose3(T_map_keys[0]), fixed))
    for c in constraints:
        graph.add(gtsam.BetweenFactorPose3(c.i, c.j, gtsam.Pose3(c.T_i_j), noise(c, FLOOR)))
    for k, T in enumerate(T_map_keys):
        values.insert(k, gtsam.Pose3(T))
    result = solved(graph, values, iterations, 1e-6)
    return np.array([result.atPose3(k).matrix() for k in range(len(T_map_keys))])


def residuals(T_map_keys: Array, constraints: Sequence[Constraint]) -> Array:
    """What is left of each constraint at the given poses, (n, 6): rotation [rad] and translation [m]."""
    if not constraints:
        return np.zeros((0, 6))
    i, j = np.array([c.i for c in constraints]), np.array([c.j for c in constraints])
    found = se3.inverse(T_map_keys[i]) @ T_map_keys[j]
    return se3.log(se3.inverse(np.array([c.T_i_j for c in constraints])) @ found)


def write_g2o(path: Path, T_map_keys: Array, constraints: Sequence[Constraint]) -> None:
    """The graph as g2o text (VERTEX_SE3:QUAT, EDGE_SE3:QUAT), without kernels."""
    lines = [f"VERTEX_SE3:QUAT {k} {_pose_text(T)}" for k, T in enumerate(T_map_keys)]
    rows, columns = np.triu_indices(6)
    for c in constraints:
        h = c.information[np.ix_(G2O_ORDER, G2O_ORDER)][rows, columns]
        upper = " ".join(f"{value:.9g}" for value in h.tolist())
        lines.append(f"EDGE_SE3:QUAT {c.i} {c.j} {_pose_text(c.T_i_j)} {upper}")
    path.write_text("\n".join(lines) + "\n")


def _pose_text(T: Array) -> str:
    values = [*T[:3, 3].tolist(), *se3.quaternions(T).tolist()]
    return " ".join(f"{value:.9f}" for value in values)
