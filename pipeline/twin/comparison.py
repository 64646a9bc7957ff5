"""Two-sample tests between a real drive and simulated ones, and what they say in words."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
import scipy

from turtlebag.datasets.se2 import Array
from turtlebag.pipeline.twin.samples import QUANTITIES, Quantity, Samples

# Chance of a false alarm in all tests together.
ALPHA = 0.05
# Values that are tested at most, and at least; pairs of them up to which p is exact; effects in words
# (Romano et al. 2006).
MOST, LEAST, FEW = 20_000, 5, 5_000
EFFECTS = ((0.147, "negligible"), (0.33, "small"), (0.474, "medium"), (2.0, "large"))


@dataclass(frozen=True, eq=False)
class Difference:
    """One quantity of the real drive beside the simulated ones.

    `distance` is that of Kolmogorov and Smirnov, `p` its chance with equal distributions, corrected after
    Holm. `effect` is Cliff's delta: how much more often a simulated value is the larger of two than the
    smaller, from -1 to 1.
    """

    quantity: Quantity
    real: Array
    simulated: Array
    distance: float
    effect: float
    p: float

    @property
    def differs(self) -> bool:
        """Whether the two can be told apart."""
        return self.p < ALPHA

    @property
    def size(self) -> str:
        """The effect in a word."""
        return next(word for limit, word in EFFECTS if abs(self.effect) < limit)

    @property
    def sentence(self) -> str:
        """What it comes to."""
        if not self.differs:
            return "cannot be told apart"
        if self.size == "negligible":
            return "can be told apart, but hardly differs in size"
        way = "larger" if self.effect > 0.0 else "smaller"
        return f"{way} in the twin ({self.size}): {self.quantity.hint}"

    def as_metrics(self) -> dict[str, Any]:
        """Its entry in metrics.json."""
        return {
            "label": self.quantity.label, "unit": self.quantity.unit,
            "real": _quantiles(self.real), "simulated": _quantiles(self.simulated),
            "n": [len(self.real), len(self.simulated)], "ks": self.distance, "cliffs_delta": self.effect,
            "p_holm": self.p, "told_apart": self.differs,
        }  # fmt: skip


def compare(real: Samples, simulated: Sequence[Samples]) -> list[Difference]:
    """Each quantity that both have, those that differ most first."""
    found = []
    for quantity in QUANTITIES:
        a = _some(real.get(quantity.name, np.zeros(0)))
        b = _some(np.concatenate([one.get(quantity.name, np.zeros(0)) for one in simulated]))
        if min(len(a), len(b)) >= LEAST:
            method = "exact" if len(a) * len(b) < FEW else "asymp"
            found.append((quantity, a, b, scipy.stats.ks_2samp(a, b, method=method)))
    ps = holm(np.array([float(test.pvalue) for *_, test in found]))
    differences = [
        Difference(quantity, a, b, float(test.statistic), cliffs_delta(a, b), float(p))
        for (quantity, a, b, test), p in zip(found, ps, strict=True)
    ]
    return sorted(differences, key=lambda one: (not one.differs, -abs(one.effect), -one.distance))


def holm(ps: Array) -> Array:
    """P values (n,) corrected for n tests after Holm (1979)."""
    order = np.argsort(ps, kind="stable")
    raised = np.maximum.accumulate(ps[order] * np.arange(len(ps), 0, -1)) if len(ps) else ps
    corrected = np.empty(len(ps))
    corrected[order] = np.minimum(raised, 1.0)
    return corrected


def cliffs_delta(a: Array, b: Array) -> float:
    """P(b > a) - P(b < a) of values (n,) and (m,), by the ranks of all."""
    ranks = scipy.stats.rankdata(np.concatenate([a, b]))
    u = ranks[len(a) :].sum() - 0.5 * len(b) * (len(b) + 1)
    return float(2.0 * u / (len(a) * len(b)) - 1.0)


def _some(values: Array) -> Array:
    """No more than `MOST` of the values that are known, evenly from all of them."""
    values = values[np.isfinite(values)]
    return values[np.linspace(0, len(values) - 1, min(len(values), MOST)).astype(np.int64)]


def _quantiles(values: Array) -> dict[str, float]:
    low, median, high = np.quantile(values, [0.05, 0.5, 0.95]).tolist()
    return {"p05": low, "median": median, "p95": high}
