"""The probability that a map is bad: a logistic regression on the terms of its self-check.

Bad is a map with a scan more than 0.2 m off, or five times as far as those of undisturbed maps are, or with
fewer than 90 % of its walls within a cell. The numbers are those that `python -m benchmarks.p_bad` prints:
fitted, none below zero, to maps with one half of the kinds of disturbance (benchmarks.coverage).
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import NamedTuple

# The log odds of a map against which nothing speaks, and what a term of size 1 adds.
BASE = -2.41
WEIGHTS = {"contradicted": 3.44, "scans": 0.94, "motion": 3.58, "uncertain": 1.91, "thick": 3.15}
# Larger terms count as this one; a map is doubtful from this probability on.
MOST, DOUBTFUL = 3.0, 0.396


class Term(NamedTuple):
    """What speaks against a map: 0 for nothing, 1 where it begins to matter. `reason` says it in words."""

    name: str
    size: float
    reason: str

    @property
    def weight(self) -> float:
        """What it adds to the log odds."""
        return WEIGHTS[self.name] * min(self.size, MOST)


def doublings(value: float, usual: float) -> float:
    """How often the usual value must be doubled to reach this one; 0 below it."""
    return max(math.log2(value / usual), 0.0) if value > 0.0 else 0.0


def sizes(terms: Sequence[Term]) -> dict[str, float]:
    """What speaks against a map, by name."""
    return {name: round(sum(term.size for term in terms if term.name == name), 6) for name in WEIGHTS}


def p_bad(terms: Sequence[Term]) -> float:
    """The probability that a map with these terms is bad."""
    return 1.0 / (1.0 + math.exp(-BASE - sum(term.weight for term in terms)))


def reasons(terms: Sequence[Term]) -> tuple[str, ...]:
    """Why a map is doubtful, the weightiest reason first; none if it is good."""
    if p_bad(terms) < DOUBTFUL:
        return ()
    ordered = sorted(terms, key=lambda term: -term.weight)
    return tuple(term.reason for term in ordered if term.weight >= min(1.0, ordered[0].weight))
