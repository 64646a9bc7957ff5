"""Means, shares and differences over many runs or few, with 95 % confidence intervals."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
import scipy.stats

from turtlebag.datasets.se2 import Array

CONFIDENCE = 0.95
SAME, LEAST = 1e-9, 1e-60
"""Share of the largest by which values may differ and still be the same, and the least that is not 0."""


@dataclass(frozen=True)
class Interval:
    """A statistic of `n` values with its confidence interval; None where there are no values."""

    n: int
    value: float | None
    low: float | None
    high: float | None


def share_interval(successes: int, n: int) -> Interval:
    """Share of successes with Wilson's interval (1927): sensible at 0 and at n, where bootstrap is not."""
    if n == 0:
        return Interval(0, None, None, None)
    z = 1.959963984540054
    share = successes / n
    middle = (share + z * z / (2 * n)) / (1 + z * z / n)
    half = z * float(np.sqrt(share * (1 - share) / n + z * z / (4 * n * n))) / (1 + z * z / n)
    return Interval(n, share, max(0.0, middle - half), min(1.0, middle + half))


def mean_interval(values: Array) -> Interval:
    """Mean of values (n,) and Student's interval: of a few runs a bootstrap's is too narrow.

    There is none of a single value, nor of values that do not vary.
    """
    values = np.asarray(values, dtype=np.float64)
    n = len(values)
    if n == 0:
        return Interval(0, None, None, None)
    mean = float(np.mean(values))
    if n == 1 or not _vary(values):
        return Interval(n, mean, None, None)
    half = _student(n - 1) * float(np.std(values, ddof=1)) / math.sqrt(n)
    return Interval(n, mean, mean - half, mean + half)


def mean_difference(a: Array, b: Array) -> Interval:
    """Mean of b (m,) minus mean of a (n,), not in pairs, and its interval (Welch 1947).

    There is none where one of them is a single value, or neither varies; the interval's n is the smaller.
    """
    n = min(len(a), len(b))
    if n == 0:
        return Interval(0, None, None, None)
    difference = float(np.mean(b) - np.mean(a))
    if n == 1 or not (_vary(a) or _vary(b)):
        return Interval(n, difference, None, None)
    shares = [float(np.var(one, ddof=1)) / len(one) for one in (a, b)]
    freedom = sum(shares) ** 2 / sum(s**2 / (len(one) - 1) for s, one in zip(shares, (a, b), strict=True))
    half = _student(freedom) * math.sqrt(sum(shares))
    return Interval(n, difference, difference - half, difference + half)


def share_difference(a: Array, b: Array) -> Interval:
    """Share of ones in b (m,) minus that in a (n,), all zeros and ones, and its interval (Newcombe 1998)."""
    n = min(len(a), len(b))
    if n == 0:
        return Interval(0, None, None, None)
    one, other = (share_interval(int(np.sum(values)), len(values)) for values in (a, b))
    difference = float(np.mean(b) - np.mean(a))
    if n == 1 or one.low is None or one.high is None or other.low is None or other.high is None:
        return Interval(n, difference, None, None)
    below = math.hypot(float(np.mean(b)) - other.low, one.high - float(np.mean(a)))
    above = math.hypot(other.high - float(np.mean(b)), float(np.mean(a)) - one.low)
    return Interval(n, difference, difference - below, difference + above)


def _vary(values: Array) -> bool:
    return bool(np.ptp(values) > max(SAME * np.abs(values).max(), LEAST))


def _student(freedom: float) -> float:
    return float(scipy.stats.t.ppf((1.0 + CONFIDENCE) / 2.0, freedom))
