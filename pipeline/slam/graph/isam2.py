"""Incremental planar pose graph (iSAM2), from which keys can be removed."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from turtlebag.datasets.se2 import SE2, Array, between, compose
from turtlebag.pipeline.slam.graph.constraints import Constraint, Kind
from turtlebag.pipeline.slam.graph.pose_graph import HELD, noise_model, positive_definite

# Poses that move farther than this are relinearised [m, rad].
RELINEARISE = 0.01


class GrowingGraph:
    """The first pose is held."""

    def __init__(self) -> None:
        import gtsam  # takes a quarter of a second, and most runs need no graph

        parameters = gtsam.ISAM2Params()
        parameters.setRelinearizeThreshold(RELINEARISE)
        parameters.relinearizeSkip = 1
        self._gtsam, self._isam, self._count = gtsam, gtsam.ISAM2(parameters), 0

    def __len__(self) -> int:
        return self._count

    def update(self, T_map_keys: Array, constraints: Sequence[Constraint]) -> Array:
        """Poses (n, 3) after adding constraints; the given ones are the initial guess of new keys."""
        gtsam: Any = self._gtsam
        graph, values = gtsam.NonlinearFactorGraph(), gtsam.Values()
        if self._count == 0:
            held = gtsam.noiseModel.Diagonal.Sigmas(np.full(3, HELD))
            graph.add(gtsam.PriorFactorPose2(0, gtsam.Pose2(*T_map_keys[0]), held))
        for key in range(self._count, len(T_map_keys)):
            values.insert(key, gtsam.Pose2(*T_map_keys[key]))
        for c in constraints:
            graph.add(gtsam.BetweenFactorPose2(c.i, c.j, gtsam.Pose2(*c.T_i_j), noise_model(c)))
        self._isam.update(graph, values)
        self._count = len(T_map_keys)
        found = self._isam.calculateEstimate()
        # Row-major, because every kernel that takes them would otherwise be compiled again.
        return np.ascontiguousarray(gtsam.utilities.extractPose2(found))


def without(
    constraints: Sequence[Constraint], stays: NDArray[np.bool_], T_map_keys: Array
) -> list[Constraint]:
    """The constraints with only some of the keys (n,) left, which are numbered anew.

    Steps over removed keys become one constraint (their covariances add up). A loop to a removed key moves to
    the last key before it that stays, by the current motion between the two; of several loops between the
    same two keys the most certain one stays.
    """
    number = np.cumsum(stays) - 1
    before = np.maximum.accumulate(np.where(stays, np.arange(len(stays)), 0))
    chained: dict[tuple[int, Kind], Constraint] = {}
    for c in constraints:
        if c.kind is Kind.LOOP:
            continue
        i = int(before[c.i])
        whole = c if c.i == i else joined(chained[i, c.kind], c)
        chained[i, c.kind] = whole
    kept: dict[tuple[int, int, Kind], Constraint] = {}
    for (i, kind), c in chained.items():
        if stays[c.j]:
            kept[i, c.j, kind] = c
    for c in constraints:
        if c.kind is not Kind.LOOP:
            continue
        i, j = int(before[c.i]), int(before[c.j])
        if i == j:
            continue
        T_i_j = compose(
            between(T_map_keys[i], T_map_keys[c.i]), compose(c.T_i_j, between(T_map_keys[c.j], T_map_keys[j]))
        )
        moved = replace(
            c,
            i=i,
            j=j,
            T_i_j=T_i_j,
            information=_told_of(c.information, between(T_map_keys[j], T_map_keys[c.j])),
        )
        other = kept.get((i, j, c.kind))
        if other is None or np.trace(other.information) < np.trace(moved.information):
            kept[i, j, c.kind] = moved
    return [replace(c, i=int(number[c.i]), j=int(number[c.j])) for c in kept.values()]


def joined(a: Constraint, b: Constraint) -> Constraint:
    """Two successive constraints as one."""
    of_a, of_b = positive_definite(a.information), positive_definite(b.information)
    covariance = np.linalg.inv(_told_of(of_a, np.asarray(SE2(b.T_i_j).inverse().xyt)))
    total = np.linalg.inv(covariance + np.linalg.inv(of_b))
    return replace(b, i=a.i, T_i_j=compose(a.T_i_j, b.T_i_j), information=total)


def _told_of(information: Array, T_other_frame: Array) -> Array:
    """Information (3, 3) of a pose, given in its own frame, in that of another frame rigidly attached to it,
    in which it is `T_other_frame` (3,)."""
    x, y, yaw = T_other_frame
    c, s = np.cos(yaw), np.sin(yaw)
    adjoint = np.array([[c, -s, y], [s, c, -x], [0.0, 0.0, 1.0]])
    back = np.linalg.inv(adjoint)
    return np.asarray(back.T @ information @ back)
