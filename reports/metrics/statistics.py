"""Medians with bootstrap intervals, and paired comparisons (Efron 1979, percentile method)."""

from __future__ import annotations

from collections.abc import Hashable, Mapping
from dataclasses import dataclass

import numpy as np

from turtlebag.datasets.se2 import Array

RESAMPLES = 2000
LARGE = 10_000
"""Of more values no resample is drawn, only the place of its median among the values in order."""
CONFIDENCE = 0.95


@dataclass(frozen=True)
class Interval:
    """A statistic of `n` values with its confidence interval; None where there are no values."""

    n: int
    value: float | None
    low: float | None
    high: float | None


def median_interval(values: Array, rng: np.random.Generator) -> Interval:
    """Median of values (n,) and its bootstrap interval."""
    values = np.asarray(values, dtype=np.float64)
    values = values[np.isfinite(values)]
    n = len(values)
    if n == 0:
        return Interval(0, None, None, None)
    if n <= LARGE:
        medians = np.median(values[rng.integers(n, size=(RESAMPLES, n))], axis=1)
    else:  # the median of n places drawn at random among n is distributed as Beta(m, m), m = (n + 1) / 2
        places = n * rng.beta((n + 1) / 2, (n + 1) / 2, size=RESAMPLES)
        medians = np.sort(values)[places.astype(np.int64)]
    low, high = np.quantile(medians, [(1.0 - CONFIDENCE) / 2.0, (1.0 + CONFIDENCE) / 2.0])
    return Interval(n, float(np.median(values)), float(low), float(high))


def share_interval(successes: int, n: int) -> Interval:
    """Share of successes with Wilson's interval (1927): sensible at 0 and at n, where bootstrap is not."""
    if n == 0:
        return Interval(0, None, None, None)
    z = 1.959963984540054
    share = successes / n
    middle = (share + z * z / (2 * n)) / (1 + z * z / n)
    half = z * float(np.sqrt(share * (1 - share) / n + z * z / (4 * n * n))) / (1 + z * z / n)
    return Interval(n, share, max(0.0, middle - half), min(1.0, middle + half))


@dataclass(frozen=True)
class Paired:
    """B minus A over pairs that share everything else; `less` is the share of pairs in which B is less."""

    difference: Interval
    less: float | None


def paired(a: Mapping[Hashable, float], b: Mapping[Hashable, float], rng: np.random.Generator) -> Paired:
    """Median of the differences b - a over the keys both have, with its bootstrap interval."""
    keys = [key for key in a if key in b]
    differences = np.array([b[key] - a[key] for key in keys], dtype=np.float64)
    differences = differences[np.isfinite(differences)]
    less = float(np.mean(differences < 0.0)) if len(differences) else None
    return Paired(median_interval(differences, rng), less)
