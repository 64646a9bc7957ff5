"""Small dense matrices in plain loops: the same to the last bit whatever the machine is doing.

A threaded BLAS is slower than this for matrices of tens of rows, and its threads disturb the others.
"""

from __future__ import annotations

import numpy as np
from numba import njit

from datasets.se2 import Array


@njit(cache=True)
def multiply(a: Array, b: Array) -> Array:
    """a (n, k) times b (k, m)."""
    out = np.zeros((a.shape[0], b.shape[1]))
    for i in range(a.shape[0]):
        for k in range(a.shape[1]):
            for j in range(b.shape[1]):
                out[i, j] += a[i, k] * b[k, j]
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
        for i in range(k + 1, n):
            factor = left[i, k] / left[k, k]
            if factor == 0.0:
                continue
            for j in range(k + 1, n):
                left[i, j] -= factor * left[k, j]
            for j in range(m):
                x[i, j] -= factor * x[k, j]
    for k in range(n - 1, -1, -1):
        for j in range(m):
            total = x[k, j]
            for i in range(k + 1, n):
                total -= left[k, i] * x[i, j]
            x[k, j] = total / left[k, k]
    return x
