"""The pose graph: constraints between key scans, optimised by GTSAM."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np

from turtlebag.datasets.se2 import SE2, Array
from turtlebag.pipeline.slam.factors import Constraint, noise, solved

# Keeps information matrices positive definite without saying anything: a hundred metres, a hundred radians.
FLOOR = np.diag([1e-4, 1e-4, 1e-4])


def optimise(T_map_keys: SE2, constraints: Sequence[Constraint], iterations: int = 30) -> SE2:
    """Least squares poses (n,) with the first one held; Levenberg-Marquardt."""
    graph, values = _graph(T_map_keys, constraints), _values(T_map_keys)
    return _poses(solved(graph, values, iterations, 1e-5), len(T_map_keys))


def mahalanobis(T_map_keys: SE2, constraints: Sequence[Constraint]) -> Array:
    """Squared Mahalanobis residual of each constraint at the given poses, kernels left out."""
    if not constraints:
        return np.zeros(0)
    i = np.array([c.i for c in constraints])
    j = np.array([c.j for c in constraints])
    z = SE2(np.array([c.T_i_j for c in constraints]))
    e = (z.inverse() @ (T_map_keys[i].inverse() @ T_map_keys[j])).xyt
    return np.einsum("na,nab,nb->n", e, np.array([c.information for c in constraints]), e)


def write_g2o(path: Path, T_map_keys: SE2, constraints: Sequence[Constraint]) -> None:
    """The graph as g2o text (VERTEX_SE2, EDGE_SE2), without kernels."""
    lines = [
        f"VERTEX_SE2 {k} {x:.9f} {y:.9f} {yaw:.9f}" for k, (x, y, yaw) in enumerate(T_map_keys.xyt.tolist())
    ]
    for c in constraints:
        h = c.information
        upper = [h[0, 0], h[0, 1], h[0, 2], h[1, 1], h[1, 2], h[2, 2]]
        numbers = " ".join(f"{value:.9g}" for value in [*c.T_i_j.tolist(), *map(float, upper)])
        lines.append(f"EDGE_SE2 {c.i} {c.j} {numbers}")
    path.write_text("\n".join(lines) + "\n")


def _graph(T_map_keys: SE2, constraints: Sequence[Constraint]) -> Any:
    import gtsam

    graph = gtsam.NonlinearFactorGraph()
    fixed = gtsam.noiseModel.Diagonal.Sigmas(np.array([1e-6, 1e-6, 1e-6]))
    graph.add(gtsam.PriorFactorPose2(0, gtsam.Pose2(*T_map_keys.xyt[0]), fixed))
    for c in constraints:
        graph.add(gtsam.BetweenFactorPose2(c.i, c.j, gtsam.Pose2(*c.T_i_j), noise(c, FLOOR)))
    return graph


def _values(T_map_keys: SE2) -> Any:
    import gtsam

    values = gtsam.Values()
    for k, (x, y, yaw) in enumerate(T_map_keys.xyt.tolist()):
        values.insert(k, gtsam.Pose2(x, y, yaw))
    return values


def _poses(values: Any, n: int) -> SE2:
    poses = [values.atPose2(k) for k in range(n)]
    return SE2.from_array(np.array([[p.x(), p.y(), p.theta()] for p in poses]))
