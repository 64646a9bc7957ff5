"""What a campaign found: statistics of each result for each level, and differences in pairs."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from turtlebag.reports.metrics.statistics import Interval, mean_interval, share_interval

Row = Mapping[str, Any]


@dataclass(frozen=True)
class LevelSummary:
    """One result at one level of a factor; `kind` is mean, or share for yes-or-no results."""

    level: Any
    result: str
    kind: str
    interval: Interval
    failed: int


@dataclass(frozen=True)
class PairedSummary:
    """One result at one level, minus the same at the level it is compared with: the mean difference, and the
    share of pairs in which it is less."""

    level: Any
    result: str
    difference: Interval
    less: float | None

    @property
    def differs(self) -> bool:
        """Whether the interval of the difference leaves out 0."""
        low, high = self.difference.low, self.difference.high
        return low is not None and high is not None and (low > 0.0 or high < 0.0)


def levels_of(rows: Sequence[Row], factor: str) -> list[Any]:
    """Levels of a factor in order of appearance."""
    return list(dict.fromkeys(row[factor] for row in rows))


def is_share(rows: Sequence[Row], result: str) -> bool:
    """Whether a result is yes or no."""
    values = [row[result] for row in rows if row[result] is not None]
    return bool(values) and all(isinstance(value, bool) for value in values)


def interval(rows: Sequence[Row], result: str) -> Interval:
    """Mean or share of a result over rows; a failed case is in no mean and counts as no success."""
    if is_share(rows, result):
        return share_interval(sum(row[result] is True for row in rows), len(rows))
    return mean_interval(_finite([row[result] for row in rows if isinstance(row[result], (int, float))]))


def _finite(values: Sequence[float]) -> np.ndarray:
    found = np.array(values, dtype=np.float64)
    return found[np.isfinite(found)]


def summarise(rows: Sequence[Row], factor: str, results: Sequence[str]) -> list[LevelSummary]:
    """Every result at every level of the factor."""
    found = []
    for result in results:
        kind = "share" if is_share(rows, result) else "mean"
        for level in levels_of(rows, factor):
            chosen = [row for row in rows if row[factor] == level]
            failed = sum(bool(row["failed"]) for row in chosen)
            found.append(LevelSummary(level, result, kind, interval(chosen, result), failed))
    return found


def compare_pairs(
    rows: Sequence[Row], factor: str, against: Any, others: Sequence[str], results: Sequence[str]
) -> list[PairedSummary]:
    """Each level minus `against`, over cases that agree in all the other factors."""
    found = []
    for result in results:
        by_level = {level: _keyed(rows, factor, level, others, result) for level in levels_of(rows, factor)}
        for level, values in by_level.items():
            if level != against:
                base = by_level.get(against, {})
                differences = _finite([values[key] - base[key] for key in base if key in values])
                less = float(np.mean(differences < 0.0)) if len(differences) else None
                found.append(PairedSummary(level, result, mean_interval(differences), less))
    return found


def _keyed(
    rows: Sequence[Row], factor: str, level: Any, others: Sequence[str], result: str
) -> dict[Any, float]:
    return {
        tuple(row[other] for other in others): float(row[result])
        for row in rows
        if row[factor] == level and isinstance(row[result], (bool, int, float))
    }
