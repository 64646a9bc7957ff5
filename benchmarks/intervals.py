"""Confidence intervals of a rate of success."""

from __future__ import annotations

from scipy.stats import beta

from turtlebag.reports.metrics.statistics import share_interval


def wilson(successes: int, n: int) -> tuple[float, float]:
    """Wilson's 95 % interval: its coverage is right on average; all of 0..1 when there is nothing."""
    found = share_interval(successes, n)
    return found.low or 0.0, 1.0 if found.high is None else found.high


def clopper_pearson(successes: int, n: int) -> tuple[float, float]:
    """The exact 95 % interval (Clopper, Pearson 1934): its coverage is never below."""
    low = float(beta.ppf(0.025, successes, n - successes + 1)) if successes else 0.0
    high = float(beta.ppf(0.975, successes + 1, n - successes)) if successes < n else 1.0
    return low, high
