"""Small dense matrices in plain loops: the result is the same to the last bit, whatever the load.

A threaded BLAS is slower than this for matrices of tens of rows, and its threads compete with the others.
"""

from __future__ import annotations

import numpy as np

from turtlebag.datasets.kernels import njit
from turtlebag.datasets.se2 import Array


@njit(cache=True)
def multiply(a: Array, b: Array) -> Array:
    """a (n, k) times b (k, m); zeros in `a` cost nothing."""
    out = np.zeros((a.shape[0], b.shape[1]))
    for i in range(a.shape[0]):
        row = out[i]
        for k in range(a.shape[1]):
            factor, b_k = a[i, k], b[k]
            if factor == 0.0:
                continue
            for j in range(len(row)):
                row[j] += factor * b_k[j]
    return out


@njit(cache=True)
def solve(a: Array, b: Array) -> Array:
    """x (n, m) with a x = b, by elimination with row pivots; a (n, n) must not be singular."""
    n, m = b.shape
    left, x = a.copy(), b.copy()
    for k in range(n):
        pivot = k
        for i in range(k + 1, n):
            if abs(left[i, k]) > abs(left[pivot, k]):
                pivot = i
        if pivot != k:
            for j in range(n):
                left[k, j], left[pivot, j] = left[pivot, j], left[k, j]
            for j in range(m):
                x[k, j], x[pivot, j] = x[pivot, j], x[k, j]
        # Rows as slices: the compiler sees that they do not overlap, and works on several columns at once.
        left_k, x_k = left[k, k + 1 :], x[k]
        for i in range(k + 1, n):
            factor = left[i, k] / left[k, k]
            if factor == 0.0:
                continue
            left_i, x_i = left[i, k + 1 :], x[i]
            for j in range(len(left_k)):
                left_i[j] -= factor * left_k[j]
            for j in range(m):
                x_i[j] -= factor * x_k[j]
    for k in range(n - 1, -1, -1):
        x_k = x[k]
        for i in range(k + 1, n):
            factor, x_i = left[k, i], x[i]
            for j in range(m):
                x_k[j] -= factor * x_i[j]
        for j in range(m):
            x_k[j] /= left[k, k]
    return x
