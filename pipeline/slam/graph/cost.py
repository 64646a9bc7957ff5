"""What the mapper minimises over the poses T_i of the key scans.

    F(T) = sum over all constraints (i, j) of rho(e^T I e),  e = vectors(T_i_j^-1 T_i^-1 T_j)

T_i_j is what a constraint says of j as seen from i, and I its information: steps between successive keys by
scans and wheels, or a constant velocity (`odometry.steps`), borders of recordings (`sessions`), loops
(`loops.by_distance`), and pairs of overlapping keys (`graph.refinement`; Lu and Milios 1997). rho is the
identity, or Cauchy's kernel where a constraint has one. The back end finds the minimum; docs/how-it-maps.md
derives the information from points and lines.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import TypeVar

import numpy as np

from turtlebag.datasets import se3
from turtlebag.datasets.se2 import SE2, Array
from turtlebag.pipeline.slam.graph.constraints import Constraint

Poses = TypeVar("Poses", SE2, Array)


def relative(T_a: Poses, T_b: Poses) -> Poses:
    """Poses b relative to poses a."""
    return T_a.inverse() @ T_b if isinstance(T_a, SE2) else se3.inverse(T_a) @ T_b


def vectors(T: SE2 | Array) -> Array:
    """Small motions as vectors: x, y, yaw (..., 3), or in space rotation and translation (..., 6)."""
    return T.xyt if isinstance(T, SE2) else se3.log(T)


def residuals(T_map_keys: SE2 | Array, constraints: Sequence[Constraint]) -> Array:
    """Residual of each constraint at the given poses, as `vectors` (n, 3) or (n, 6)."""
    i, j = np.array([c.i for c in constraints], int), np.array([c.j for c in constraints], int)
    measured = np.array([c.T_i_j for c in constraints])
    if isinstance(T_map_keys, SE2):
        return vectors(relative(SE2(measured.reshape(-1, 3)), relative(T_map_keys[i], T_map_keys[j])))
    return vectors(relative(measured.reshape(-1, 4, 4), relative(T_map_keys[i], T_map_keys[j])))


def mahalanobis(T_map_keys: SE2 | Array, constraints: Sequence[Constraint]) -> Array:
    """Squared Mahalanobis residual of each constraint at the given poses, kernels left out."""
    e = residuals(T_map_keys, constraints)
    information = np.array([c.information for c in constraints]).reshape(-1, e.shape[1], e.shape[1])
    return np.einsum("na,nab,nb->n", e, information, e)
