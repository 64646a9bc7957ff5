"""What a campaign found: statistics of each result for each level, and differences in pairs."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from turtlebag.datasets.seeds import stream
from turtlebag.reports.metrics.statistics import Interval, Paired, median_interval, paired, share_interval

Row = Mapping[str, Any]


@dataclass(frozen=True)
class LevelSummary:
    """One result at one level of a factor; `kind` is median, or share for yes-or-no results."""

    level: Any
    result: str
    kind: str
    interval: Interval
    failed: int


@dataclass(frozen=True)
class PairedSummary:
    """One result at one level, minus the same at the level it is compared with."""

    level: Any
    result: str
    found: Paired

    @property
    def differs(self) -> bool:
        """Whether the interval of the difference leaves out 0."""
        low, high = self.found.difference.low, self.found.difference.high
        return low is not None and high is not None and (low > 0.0 or high < 0.0)


def levels_of(rows: Sequence[Row], factor: str) -> list[Any]:
    """Levels of a factor in order of appearance."""
    return list(dict.fromkeys(row[factor] for row in rows))


def is_share(rows: Sequence[Row], result: str) -> bool:
    """Whether a result is yes or no."""
    values = [row[result] for row in rows if row[result] is not None]
    return bool(values) and all(isinstance(value, bool) for value in values)


def interval(rows: Sequence[Row], result: str, seed: int, name: str) -> Interval:
    """Median or share of a result over rows; a failed case has no median and counts as no success."""
    if is_share(rows, result):
        return share_interval(sum(row[result] is True for row in rows), len(rows))
    values = np.array(
        [row[result] for row in rows if isinstance(row[result], (int, float))], dtype=np.float64
    )
    return median_interval(values, stream(seed, f"bootstrap {name} {result}"))


def summarise(rows: Sequence[Row], factor: str, results: Sequence[str], seed: int) -> list[LevelSummary]:
    """Every result at every level of the factor."""
    found = []
    for result in results:
        kind = "share" if is_share(rows, result) else "median"
        for level in levels_of(rows, factor):
            chosen = [row for row in rows if row[factor] == level]
            failed = sum(bool(row["failed"]) for row in chosen)
            found.append(
                LevelSummary(level, result, kind, interval(chosen, result, seed, f"{factor}={level}"), failed)
            )
    return found


def compare_pairs(
    rows: Sequence[Row], factor: str, against: Any, others: Sequence[str], results: Sequence[str], seed: int
) -> list[PairedSummary]:
    """Each level minus `against`, over cases that agree in all the other factors."""
    found = []
    for result in results:
        by_level = {level: _keyed(rows, factor, level, others, result) for level in levels_of(rows, factor)}
        for level, values in by_level.items():
            if level != against:
                rng = stream(seed, f"bootstrap pairs {factor}={level} {result}")
                found.append(PairedSummary(level, result, paired(by_level.get(against, {}), values, rng)))
    return found


def _keyed(
    rows: Sequence[Row], factor: str, level: Any, others: Sequence[str], result: str
) -> dict[Any, float]:
    return {
        tuple(row[other] for other in others): float(row[result])
        for row in rows
        if row[factor] == level and isinstance(row[result], (bool, int, float))
    }
