"""The pose graph in 2D and 3D: constraints between key scans, optimised by GTSAM.

Poses of the plane are an `SE2` (n,), those of space matrices (n, 4, 4). Nothing else sees GTSAM's keys, its
noise models or its failure modes.
"""

from __future__ import annotations

from collections.abc import Sequence
from functools import cache
from pathlib import Path
from typing import Any
from weakref import WeakKeyDictionary

import numpy as np
from numpy.typing import NDArray

from turtlebag.datasets import se3
from turtlebag.datasets.se2 import SE2, Array
from turtlebag.pipeline.slam.graph.constraints import Constraint
from turtlebag.pipeline.slam.graph.cost import Poses, relative

# A negligible information that keeps matrices positive definite: a hundred metres, a hundred radians.
WEAK = 1e-4
# Standard deviation of the fixed first pose [m, rad].
HELD = 1e-6
FLOOR = {size: WEAK * np.eye(size) for size in (3, 6)}
NO_GAPS = np.zeros((0, 2), dtype=np.int64)
# g2o writes translation before rotation.
G2O_ORDER = {3: [0, 1, 2], 6: [3, 4, 5, 0, 1, 2]}


class Gtsam:
    """GTSAM's factor graph: a `turtlebag.pipeline.slam.graph.back_end.BackEnd`, and in space too."""

    def __init__(self) -> None:
        # loop closure solves a graph that has grown a little, again and again
        self._factors: WeakKeyDictionary[Constraint, Any] = WeakKeyDictionary()

    def optimise(self, T_map_keys: Poses, constraints: Sequence[Constraint], iterations: int = 30) -> Poses:
        """Least squares poses (n,) with the first one held; Levenberg-Marquardt."""
        import gtsam  # takes a quarter of a second, and most runs need no graph

        if isinstance(T_map_keys, SE2):
            start, pose, prior = T_map_keys.xyt, lambda xyt: gtsam.Pose2(*xyt), gtsam.PriorFactorPose2
        else:
            start, pose, prior = T_map_keys, gtsam.Pose3, gtsam.PriorFactorPose3
        graph, values = gtsam.NonlinearFactorGraph(), gtsam.Values()
        held = gtsam.noiseModel.Diagonal.Sigmas(np.full(3 if isinstance(T_map_keys, SE2) else 6, HELD))
        graph.add(prior(0, pose(start[0]), held))
        for c in constraints:
            graph.add(self._factor(c))
        for k, T in enumerate(start):
            values.insert(k, pose(T))
        parameters = gtsam.LevenbergMarquardtParams()
        parameters.setMaxIterations(iterations)
        found = gtsam.LevenbergMarquardtOptimizer(graph, values, parameters).optimize()
        if isinstance(T_map_keys, SE2):
            poses = [found.atPose2(k) for k in range(len(start))]
            return SE2.from_array(np.array([[p.x(), p.y(), p.theta()] for p in poses]))
        return np.array([found.atPose3(k).matrix() for k in range(len(start))])

    def _factor(self, c: Constraint) -> Any:
        import gtsam

        factor = self._factors.get(c)
        if factor is None:
            if c.T_i_j.shape == (3,):
                factor = gtsam.BetweenFactorPose2(c.i, c.j, gtsam.Pose2(*c.T_i_j), noise_model(c))
            else:
                factor = gtsam.BetweenFactorPose3(c.i, c.j, gtsam.Pose3(c.T_i_j), noise_model(c))
            self._factors[c] = factor
        return factor


GTSAM = Gtsam()
optimise = GTSAM.optimise


def marginals(
    n: int, i: NDArray[np.int64], j: NDArray[np.int64], information: Array, held: float = HELD
) -> Array:
    """Covariances (n, 3, 3) of n vectors whose differences, j (k,) less i (k,), are known with information
    (k, 3, 3), and the first of them to a standard deviation `held`."""
    import gtsam

    unit = gtsam.noiseModel.Unit.Create(3)
    roots = np.linalg.cholesky(information).transpose(0, 2, 1)
    graph, zeros = gtsam.GaussianFactorGraph(), gtsam.VectorValues()
    graph.add(gtsam.JacobianFactor(0, np.eye(3) / held, np.zeros(3), unit))
    for a, b, root in zip(i.tolist(), j.tolist(), roots, strict=True):
        graph.add(gtsam.JacobianFactor(a, -root, b, root, np.zeros(3), unit))
    for k in range(n):
        zeros.insert(k, np.zeros(3))
    found = gtsam.Marginals(graph, zeros)
    return np.array([found.marginalCovariance(k) for k in range(n)])


def positive_definite(information: Array) -> Array:
    """Information (..., k, k) with a negligible one added, so that it has an inverse."""
    return information + FLOOR[information.shape[-1]]


def carried_poses(
    T_track: Poses, keys: NDArray[np.int64], T_map_keys: Poses, gaps: NDArray[np.int64] = NO_GAPS
) -> Poses:
    """Each scan of a track moved with the key scans before and after it, their corrections blended.

    Across `gaps` (n, 2), last scan before and first scan after each, the track does not know the motion, or
    jumps: scans before a gap move with the key before it alone, scans after it with the key after it.
    """
    scans = np.arange(len(T_track))
    before = np.maximum(np.searchsorted(keys, scans, side="right") - 1, 0)
    after = np.minimum(before + 1, len(keys) - 1)
    from_before = T_map_keys[before] @ relative(T_track[keys[before]], T_track)
    from_after = T_map_keys[after] @ relative(T_track[keys[after]], T_track)
    fraction = np.maximum(scans - keys[before], 0) / np.maximum(keys[after] - keys[before], 1)
    for last, first in gaps.tolist():
        within = (before == before[last]) & (scans < keys[after[last]])
        fraction[within] = np.clip((scans[within] - last) / (first - last), 0.0, 1.0)
    if isinstance(from_before, SE2):
        return from_before.interpolate(from_after, fraction)
    return se3.interpolate(from_before, from_after, fraction)


def write_g2o(path: Path, T_map_keys: SE2 | Array, constraints: Sequence[Constraint]) -> None:
    """The graph as g2o text (VERTEX_SE2, EDGE_SE2; VERTEX_SE3:QUAT, EDGE_SE3:QUAT), without kernels."""
    kind, poses = ("SE2", T_map_keys.xyt) if isinstance(T_map_keys, SE2) else ("SE3:QUAT", T_map_keys)
    lines = [f"VERTEX_{kind} {k} {_text(_row(T), '.9f')}" for k, T in enumerate(poses)]
    for c in constraints:
        order = G2O_ORDER[len(c.information)]
        upper = c.information[np.ix_(order, order)][np.triu_indices(len(order))]
        lines.append(f"EDGE_{kind} {c.i} {c.j} {_text([*_row(c.T_i_j), *upper], '.9g')}")
    path.write_text("\n".join(lines) + "\n")


def _row(T: Array) -> Array:
    """A pose as g2o writes it: x, y, yaw, or x, y, z and a quaternion."""
    return T if T.shape == (3,) else np.concatenate([T[:3, 3], se3.quaternions(T)])


def _text(values: Any, digits: str) -> str:
    return " ".join(f"{value:{digits}}" for value in np.asarray(values).tolist())


def noise_model(constraint: Constraint) -> Any:
    """GTSAM's noise model of a constraint, with a floor that keeps its information positive definite."""
    import gtsam

    gaussian: Any = gtsam.noiseModel.Gaussian.Information(positive_definite(constraint.information))
    if constraint.cauchy == 0.0:
        return gaussian
    return gtsam.noiseModel.Robust.Create(_cauchy(constraint.cauchy), gaussian)


@cache
def _cauchy(width: float) -> Any:
    import gtsam

    return gtsam.noiseModel.mEstimator.Cauchy.Create(width)
