"""What is told of a robot: numbers with intervals and their equations, or why a bag does not show them."""

from __future__ import annotations

import itertools
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any

import numpy as np
import scipy

from turtlebag.datasets.se2 import Array

# Parts of a drive that are left out one at a time, to see how much a number varies.
PARTS = 16
# Values of a series that are drawn.
DRAWN = 1200


@dataclass(frozen=True)
class Estimate:
    """A parameter: its value and standard deviation in `unit`, the equation that gives it, and `why` the bag
    does not show it (then the value is that of the base robot, or assumed). `freedom` are the degrees of
    freedom of the deviation; a `positive` one cannot be below zero."""

    name: str
    value: float
    sigma: float
    unit: str
    equation: str
    why: str = ""
    freedom: float = np.inf
    positive: bool = False

    @property
    def observable(self) -> bool:
        """Whether the bag shows it."""
        return not self.why

    @property
    def interval_95(self) -> tuple[float, float]:
        """The interval that holds it with 95 %; of a positive one, the same number of times up and down, as
        long as it is clear of zero."""
        t = float(scipy.stats.t.ppf(0.975, self.freedom))
        away = t * self.sigma
        if self.positive and self.value > 0.0 and self.sigma < 0.5 * self.value:
            factor = float(np.exp(away / self.value))
            return self.value / factor, self.value * factor
        return (max(self.value - away, 0.0) if self.positive else self.value - away), self.value + away

    def drawn(self, unit: float) -> float:
        """A value that may as well be the true one, for a draw from a unit Gaussian."""
        if self.why or self.sigma == 0.0:
            return self.value
        low, high = self.interval_95
        off = self.sigma * float(scipy.stats.t.ppf(scipy.stats.norm.cdf(unit), self.freedom))
        return min(max(self.value + off, low), high)

    def as_record(self) -> dict[str, Any]:
        """Its entry in identify.json."""
        entry: dict[str, Any] = {"value": self.value, "unit": self.unit}
        if self.why:
            return {**entry, "observable": False, "from": "base", "why": self.why, "equation": self.equation}
        told = {"interval_95": list(self.interval_95), "observable": True, "from": "bag"}
        return {**entry, **told, "equation": self.equation}


@dataclass(frozen=True)
class Plot:
    """The data behind the estimates `of` these names: series of x and y, `points` as dots and `lines` as what
    was fitted."""

    of: tuple[str, ...]
    title: str
    caption: str
    x: str
    y: str
    points: Mapping[str, tuple[Array, Array]] = field(default_factory=dict)
    lines: Mapping[str, tuple[Array, Array]] = field(default_factory=dict)

    def as_record(self) -> dict[str, Any]:
        """Its entry in plots.json: series by name, x and y, no more than `DRAWN` of each."""
        told: dict[str, Any] = {name: getattr(self, name) for name in ("of", "title", "caption", "x", "y")}
        for kind, series in (("points", self.points), ("lines", self.lines)):
            told[kind] = {
                name: [
                    [float(f"{one:.5g}") for one in values[:: max(1, len(values) // DRAWN)]] for values in xy
                ]
                for name, xy in series.items()
            }
        return told


@dataclass
class Findings:
    """What one part of the robot's sensors shows: estimates by name, the plots of their data, and how much
    the errors of two have in common, from -1 to 1."""

    estimates: list[Estimate] = field(default_factory=list)
    plots: dict[str, Plot] = field(default_factory=dict)
    correlations: dict[tuple[str, str], float] = field(default_factory=dict)

    def correlate(self, names: Sequence[str], covariance: Array) -> None:
        """Take the correlations of numbers with this covariance (n, n)."""
        for i, j in itertools.combinations(range(len(names)), 2):
            both = float(covariance[i, i] * covariance[j, j]) ** 0.5
            self.correlations[names[i], names[j]] = float(covariance[i, j]) / both if both > 0.0 else 0.0


def unknown(name: str, value: float, unit: str, equation: str, why: str) -> Estimate:
    """What the bag does not show."""
    return Estimate(name, value, 0.0, unit, equation, why)


def jackknife(parts: Array, estimate: Callable[[Array], Array]) -> tuple[Array, Array, int]:
    """Values (p,), their covariance (p, p) and degrees of freedom.

    They are what `estimate` makes of sums over the parts (n, ...) of a drive: n times of all but one (Tukey
    1958).
    """
    parts = parts[parts.reshape(len(parts), -1).any(axis=1)]
    n, whole = len(parts), parts.sum(axis=0)
    values = estimate(whole)
    if n < 3:
        return values, np.diag(np.full(len(values), np.inf)), 1
    others = np.array([estimate(whole - part) for part in parts])
    off = others - others.mean(axis=0)
    return values, (n - 1.0) / n * off.T @ off, n - 1
