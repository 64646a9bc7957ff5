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

from turtlebag.datasets.se2 import SE2, Array
from turtlebag.datasets.se3 import SE3
from turtlebag.pipeline.slam.graph.constraints import Constraint

Poses = TypeVar("Poses", SE2, SE3)
"""The poses of a graph, of the plane or of space."""


def residuals(T_map_keys: SE2 | SE3, constraints: Sequence[Constraint]) -> Array:
    """Residual of each constraint at the given poses, as vectors (n, 3) or (n, 6)."""
    i, j = np.array([c.i for c in constraints], int), np.array([c.j for c in constraints], int)
    one = T_map_keys.array.shape[1:]
    measured = type(T_map_keys)(np.array([c.T_i_j for c in constraints]).reshape(-1, *one))
    return (measured.inverse() @ (T_map_keys[i].inverse() @ T_map_keys[j])).vector()  # type: ignore[operator]


def mahalanobis(T_map_keys: SE2 | SE3, constraints: Sequence[Constraint]) -> Array:
    """Squared Mahalanobis residual of each constraint at the given poses, kernels left out."""
    e = residuals(T_map_keys, constraints)
    information = np.array([c.information for c in constraints]).reshape(-1, e.shape[1], e.shape[1])
    return np.einsum("na,nab,nb->n", e, information, e)
