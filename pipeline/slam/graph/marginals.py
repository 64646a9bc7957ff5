"""The covariance of each key by the whole graph: blocks on the diagonal of the inverse of its information.

The inverse is full, but its entries where the triangular factor has some follow from each other, last row
first (Takahashi, Fagan and Chin 1973; Kaess and Dellaert 2009), which costs no more than the factor.
"""

from __future__ import annotations

from typing import Any

import numpy as np
import scipy
from numpy.typing import NDArray

from turtlebag.datasets.kernels import njit
from turtlebag.datasets.se2 import Array
from turtlebag.pipeline.slam.graph.pose_graph import WEAK


def laplacian(n: int, i: NDArray[np.int64], j: NDArray[np.int64], weights: Array) -> scipy.sparse.csc_matrix:
    """The information (3 n, 3 n) of n vectors whose differences, j (k,) less i (k,), are known with
    information (k, 3, 3)."""
    blocks = [(i, i, weights), (j, j, weights), (i, j, -weights), (j, i, -weights)]
    cell = np.arange(3)
    rows = np.concatenate([np.repeat(3 * a[:, None] + cell, 3, axis=1).ravel() for a, _, _ in blocks])
    columns = np.concatenate([np.tile(3 * b[:, None] + cell, 3).ravel() for _, b, _ in blocks])
    values = np.concatenate([w.ravel() for _, _, w in blocks])
    return scipy.sparse.csc_matrix((values, (rows, columns)), shape=(3 * n, 3 * n))


def factorised(information: scipy.sparse.csc_matrix) -> Any:
    """SuperLU's factors L, D L^T of a positive definite matrix, its rows in the order of its columns."""
    symmetric = {"SymmetricMode": True}
    return scipy.sparse.linalg.splu(information, "MMD_AT_PLUS_A", diag_pivot_thresh=0.0, options=symmetric)


def marginals(n: int, i: NDArray[np.int64], j: NDArray[np.int64], information: Array) -> Array:
    """Covariances (n, 3, 3) of n vectors, the first of them fixed, as known in a `laplacian`."""
    out = np.zeros((n, 3, 3))
    if n < 2:
        return out
    # in units in which the usual information is 1: a turn about the middle of a large map moves its ends far
    units = np.median(np.diagonal(information, axis1=1, axis2=2), axis=0) ** -0.5 if len(i) else np.ones(3)
    held = laplacian(n, i, j, information * np.outer(units, units))[3:, 3:]
    # what hardly holds a key to the others must not be lost beside the rest
    factors = factorised((held + WEAK**2 * scipy.sparse.eye_array(3 * n - 3)).tocsc())
    lower, diagonal = factors.L.tocsc(), factors.U.diagonal()
    lower.sort_indices()
    lower.data = _inverse_in(lower.indptr, lower.indices, lower.data, diagonal)
    place = factors.perm_c.reshape(n - 1, 3)
    ends = np.broadcast_arrays(place[:, :, None], place[:, None, :])
    own = lower[np.maximum(*ends).ravel(), np.minimum(*ends).ravel()]
    out[1:] = np.asarray(own).reshape(n - 1, 3, 3) * np.outer(units, units)
    return out


@njit(cache=True)
def _inverse_in(first: NDArray, row: NDArray, lower: Array, diagonal: Array) -> Array:
    """The entries (m,) of the inverse of L D L^T where L has some, in the order of L's; its columns begin at
    `first` (n + 1,) with their ones."""
    n = len(first) - 1
    inverse, sums, place = np.zeros(len(lower)), np.zeros(n), np.full(n, -1)
    for column in range(n - 1, -1, -1):
        below = range(first[column] + 1, first[column + 1])
        for p in below:
            place[row[p]], sums[row[p]] = p, 0.0
        for p in below:  # the inverse of what comes after, times this column of L
            k = row[p]
            sums[k] += inverse[first[k]] * lower[p]
            for q in range(first[k] + 1, first[k + 1]):
                if place[row[q]] >= 0:
                    sums[k] += inverse[q] * lower[place[row[q]]]
                    sums[row[q]] += inverse[q] * lower[p]
        inverse[first[column]] = 1.0 / diagonal[column]
        for p in below:
            inverse[p] = -sums[row[p]]
            inverse[first[column]] += lower[p] * sums[row[p]]
            place[row[p]] = -1
    return inverse
