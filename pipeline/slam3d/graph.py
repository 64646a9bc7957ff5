"""The pose graph in space: constraints between key clouds, optimised by GTSAM."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Literal

import gtsam
import numpy as np

from datasets import se3
from datasets.se2 import Array

Kind = Literal["step", "odometry", "loop", "pair"]
# Keeps information matrices positive definite without saying anything.
FLOOR = 1e-4 * np.eye(6)
G2O_ORDER = np.array([3, 4, 5, 0, 1, 2])
"""g2o writes translation before rotation."""


@dataclass(frozen=True, eq=False)
class Constraint3d:
    """`T_i_j` (4, 4), key j seen from key i, with information (6, 6), rotation first, in the frame of j.

    `soft` is the width of the Cauchy kernel in standard deviations, 0 for none.
    """

    i: int
    j: int
    T_i_j: Array
    information: Array
    kind: Kind
    soft: float = 0.0


def optimise(T_map_keys: Array, constraints: Sequence[Constraint3d], iterations: int = 30) -> Array:
    """Least squares poses (n, 4, 4) with the first one held; Levenberg-Marquardt."""
    graph, values = gtsam.NonlinearFactorGraph(), gtsam.Values()
    fixed = gtsam.noiseModel.Isotropic.Sigma(6, 1e-6)
    graph.add(gtsam.PriorFactorPose3(0, gtsam.Pose3(T_map_keys[0]), fixed))
    for c in constraints:
        graph.add(gtsam.BetweenFactorPose3(c.i, c.j, gtsam.Pose3(c.T_i_j), _noise(c)))
    for k, T in enumerate(T_map_keys):
        values.insert(k, gtsam.Pose3(T))
    parameters = gtsam.LevenbergMarquardtParams()
    parameters.setMaxIterations(iterations)
    parameters.setRelativeErrorTol(1e-6)
    result = gtsam.LevenbergMarquardtOptimizer(graph, values, parameters).optimize()
    return np.array([result.atPose3(k).matrix() for k in range(len(T_map_keys))])


def _noise(constraint: Constraint3d) -> Any:
    noise: Any = gtsam.noiseModel.Gaussian.Information(constraint.information + FLOOR)
    if constraint.soft > 0.0:
        cauchy = gtsam.noiseModel.mEstimator.Cauchy.Create(constraint.soft)
        noise = gtsam.noiseModel.Robust.Create(cauchy, noise)
    return noise


def residuals(T_map_keys: Array, constraints: Sequence[Constraint3d]) -> Array:
    """What is left of each constraint at the given poses, (n, 6): rotation [rad] and translation [m]."""
    if not constraints:
        return np.zeros((0, 6))
    i, j = np.array([c.i for c in constraints]), np.array([c.j for c in constraints])
    found = se3.inverse(T_map_keys[i]) @ T_map_keys[j]
    return se3.log(se3.inverse(np.array([c.T_i_j for c in constraints])) @ found)


def write_g2o(path: Path, T_map_keys: Array, constraints: Sequence[Constraint3d]) -> None:
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
