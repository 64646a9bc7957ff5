"""The pose graph in 2D and 3D: constraints between key scans, optimised by GTSAM.

Poses are an `SE2` or an `SE3` (n,). Nothing else sees GTSAM's keys, its
noise models or its failure modes.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from functools import cache
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from turtlebag.datasets import se3
from turtlebag.datasets.se2 import SE2, Array
from turtlebag.datasets.se3 import SE3
from turtlebag.pipeline.slam.graph.constraints import Constraint
from turtlebag.pipeline.slam.graph.cost import Poses

# A negligible information that keeps matrices positive definite: a hundred metres, a hundred radians.
WEAK = 1e-4
# Standard deviation of the fixed first pose [m, rad].
HELD = 1e-6
FLOOR = {size: WEAK * np.eye(size) for size in (3, 6)}
NO_GAPS = np.zeros((0, 2), dtype=np.int64)
G2O_NAME = {(3,): "SE2", (4, 4): "SE3:QUAT"}
# g2o writes translation before rotation.
G2O_ORDER = {"SE2": [0, 1, 2], "SE3:QUAT": [3, 4, 5, 0, 1, 2]}


class Gtsam:
    """GTSAM's factor graph: a `turtlebag.pipeline.slam.graph.back_end.BackEnd`, and in space too."""

    def optimise(self, T_map_keys: Poses, constraints: Sequence[Constraint], iterations: int = 30) -> Poses:
        """Least squares poses (n,) with the first one held; Levenberg-Marquardt."""
        import gtsam  # takes a quarter of a second, and most runs need no graph

        kind, start = space(T_map_keys.array.shape[1:]), T_map_keys.array
        graph, values = gtsam.NonlinearFactorGraph(), gtsam.Values()
        held = gtsam.noiseModel.Diagonal.Sigmas(np.full(kind.dof, HELD))
        graph.add(kind.prior(0, kind.pose(start[0]), held))
        for c in constraints:
            graph.add(kind.between(c.i, c.j, kind.pose(c.T_i_j), noise_model(c)))
        for k, T in enumerate(start):
            values.insert(k, kind.pose(T))
        parameters = gtsam.LevenbergMarquardtParams()
        parameters.setMaxIterations(iterations)
        found = gtsam.LevenbergMarquardtOptimizer(graph, values, parameters).optimize()
        return type(T_map_keys).from_array(kind.solved(found))


class Space(NamedTuple):
    """GTSAM's names for the plane, or for space: degrees of freedom, a pose from an array, all poses of the
    solved values, and the factors."""

    dof: int
    pose: Callable[[Array], Any]
    solved: Callable[[Any], Array]
    prior: Callable[..., Any]
    between: Callable[..., Any]


@cache
def space(shape: tuple[int, ...]) -> Space:
    """The plane for poses (3,), space for poses (4, 4)."""
    import gtsam

    def planar(values: Any) -> Array:
        return np.ascontiguousarray(gtsam.utilities.extractPose2(values))

    def spatial(values: Any) -> Array:
        return np.array([values.atPose3(k).matrix() for k in range(values.size())])

    if shape == (3,):
        factors = gtsam.PriorFactorPose2, gtsam.BetweenFactorPose2
        return Space(3, lambda xyt: gtsam.Pose2(*xyt.tolist()), planar, *factors)
    return Space(6, gtsam.Pose3, spatial, gtsam.PriorFactorPose3, gtsam.BetweenFactorPose3)


GTSAM = Gtsam()
optimise = GTSAM.optimise


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
    from_before = T_map_keys[before] @ (T_track[keys[before]].inverse() @ T_track)
    from_after = T_map_keys[after] @ (T_track[keys[after]].inverse() @ T_track)
    fraction = np.maximum(scans - keys[before], 0) / np.maximum(keys[after] - keys[before], 1)
    for last, first in gaps.tolist():
        within = (before == before[last]) & (scans < keys[after[last]])
        fraction[within] = np.clip((scans[within] - last) / (first - last), 0.0, 1.0)
    return from_before.interpolate(from_after, fraction)


def write_g2o(path: Path, T_map_keys: SE2 | SE3, constraints: Sequence[Constraint]) -> None:
    """The graph as g2o text (VERTEX_SE2, EDGE_SE2; VERTEX_SE3:QUAT, EDGE_SE3:QUAT), without kernels."""
    kind = G2O_NAME[T_map_keys.array.shape[1:]]
    lines = [f"VERTEX_{kind} {k} {_text(_row(T), '.9f')}" for k, T in enumerate(T_map_keys.array)]
    rows, columns = np.array(G2O_ORDER[kind])[np.array(np.triu_indices(len(G2O_ORDER[kind])))]
    for c in constraints:
        numbers = np.concatenate([_row(c.T_i_j), c.information[rows, columns]])
        lines.append(f"EDGE_{kind} {c.i} {c.j} {_text(numbers, '.9g')}")
    path.write_text("\n".join(lines) + "\n")


def _row(T: Array) -> Array:
    """A pose as g2o writes it: x, y, yaw, or x, y, z and a quaternion."""
    return T if T.shape == (3,) else np.concatenate([T[:3, 3], se3.quaternions(T)])


def _text(values: Array, digits: str) -> str:
    return " ".join(f"{value:{digits}}" for value in values.tolist())


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


def chain(steps: Array, pairs: NDArray[np.int64]) -> Array:
    """Motion (n, 3) over each pair of keys, composed of steps."""
    yaw = np.concatenate([[0.0], np.cumsum(steps[:, 2])])
    c, s = np.cos(yaw[:-1]), np.sin(yaw[:-1])
    move = np.stack([c * steps[:, 0] - s * steps[:, 1], s * steps[:, 0] + c * steps[:, 1]], axis=1)
    T = SE2.from_array(np.column_stack([np.concatenate([np.zeros((1, 2)), np.cumsum(move, axis=0)]), yaw]))
    return (T[pairs[:, 0]].inverse() @ T[pairs[:, 1]]).xyt
