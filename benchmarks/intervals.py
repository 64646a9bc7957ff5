"""Confidence intervals of a rate of success."""

from __future__ import annotations

import math

from scipy.stats import beta


def wilson(successes: int, n: int) -> tuple[float, float]:
    """Wilson's 95 % interval (1927): its coverage is right on average."""
    if n == 0:
        return 0.0, 1.0
    z, p = 1.959964, successes / n
    middle = (p + z * z / (2 * n)) / (1 + z * z / n)
    half = z * math.sqrt(p * (1 - p) / n + z * z / (4 * n * n)) / (1 + z * z / n)
    return max(middle - half, 0.0), min(middle + half, 1.0)


def clopper_pearson(successes: int, n: int) -> tuple[float, float]:
    """The exact 95 % interval (Clopper, Pearson 1934): its coverage is never below."""
    low = float(beta.ppf(0.025, successes, n - successes + 1)) if successes else 0.0
    high = float(beta.ppf(0.975, successes + 1, n - successes)) if successes < n else 1.0
    return low, high
