"""Medians with bootstrap intervals, and paired comparisons (Efron 1979, percentile method)."""

from __future__ import annotations

from collections.abc import Hashable, Mapping
from dataclasses import dataclass

import numpy as np

from turtlebag.datasets.se2 import Array

RESAMPLES = 2000
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
    return _interval(np.asarray(values, dtype=np.float64), np.median, rng)


def _interval(values: Array, statistic: object, rng: np.random.Generator) -> Interval:
    values = values[np.isfinite(values)]
    if len(values) == 0:
        return Interval(0, None, None, None)
    drawn = values[rng.integers(len(values), size=(RESAMPLES, len(values)))]
    resampled = statistic(drawn, axis=1)  # type: ignore[operator]
    low, high = np.quantile(resampled, [(1.0 - CONFIDENCE) / 2.0, (1.0 + CONFIDENCE) / 2.0])
    return Interval(len(values), float(statistic(values)), float(low), float(high))  # type: ignore[operator]


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
