"""Robust statistics: estimates that a few wild values do not spoil."""

from __future__ import annotations

from itertools import product

import numpy as np

from turtlebag.datasets.se2 import Array

# Ratio of a Gaussian's standard deviation to the median of its absolute value.
PER_MEDIAN = 1.4826
# Width of the Cauchy kernel in standard deviations.
WIDTH = 2.0


def sigma_by_median(errors: Array, axis: int | None = None) -> Array:
    """Standard deviation of errors about zero, by the median of their absolute values."""
    return np.asarray(PER_MEDIAN * np.median(np.abs(errors), axis=axis))


def cauchy_weight(squares: Array) -> Array:
    """Weight (0 to 1) of errors with such squared Mahalanobis distances, for reweighted least squares."""
    return np.asarray(1.0 / (1.0 + squares / WIDTH**2))


def cauchy_cost(squares: Array) -> Array:
    """Cost of errors with such squared Mahalanobis distances: the logarithm of how unlikely they are."""
    return np.asarray(np.log1p(squares / WIDTH**2))


def not_negative(rows: Array, wanted: Array) -> Array:
    """Least squares of a few unknowns (p,), none below zero, from rows (n, p): the best of all choices of
    those that are zero. The optimisers of SciPy take a tenth of a second to load."""
    best, least = np.zeros(rows.shape[1]), float(wanted @ wanted)
    for parts in product((False, True), repeat=rows.shape[1]):
        values = np.zeros(rows.shape[1])
        values[list(parts)] = np.linalg.lstsq(rows[:, parts], wanted)[0]
        left = rows @ values - wanted
        if (values >= 0.0).all() and left @ left < least:
            best, least = values, float(left @ left)
    return best
