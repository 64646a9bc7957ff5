"""Several runs a side: medians and worst, and differences that count only beyond the spread over the runs."""

from __future__ import annotations

import json
from collections import Counter
from collections.abc import Hashable, Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass
from string import ascii_uppercase
from typing import Any

import numpy as np

from turtlebag.datasets.errors import InputError
from turtlebag.datasets.plurals import counted
from turtlebag.reports.kinds import stage_metrics
from turtlebag.reports.metric_specs import SPECS, MetricSpec
from turtlebag.reports.metrics.statistics import Interval, mean_difference, mean_interval, share_difference
from turtlebag.reports.numbers import DASH, finite, leaves, lookup, shown
from turtlebag.reports.stages import Manifest, Stage, read_manifest

MOST = len(ascii_uppercase)
MOST_SETTINGS = 3
"""Values of one setting that are listed for one side."""
VERDICTS = ("better", "worse", "different", "within the spread", "no spread", "the same")


@dataclass(frozen=True, eq=False)
class Side:
    """The runs of one system, and the metrics of each; `letter` stands for it in tables."""

    letter: str
    name: str
    stages: Sequence[Stage]
    metrics: Sequence[Mapping[str, Any]]
    seeds: Sequence[Hashable]

    @property
    def title(self) -> str:
        """How a page calls it."""
        return f"{self.letter}: {self.name} ({counted(len(self.stages), 'run')})"

    def values(self, spec: MetricSpec) -> list[tuple[Hashable, float]]:
        """(seed, value) of the runs that have the number."""
        told = [
            (seed, finite(lookup(one, spec.path))) for seed, one in zip(self.seeds, self.metrics, strict=True)
        ]
        return [(seed, value) for seed, value in told if value is not None]


@dataclass(frozen=True)
class Summary:
    """One number of one side: of `n` of its `runs`. `worst` is None where neither more nor less is better."""

    spec: MetricSpec
    runs: int
    n: int
    median: float | None
    worst: float | None

    @property
    def text(self) -> str:
        """The median, the worst, and of how many runs where not of all; of yes and no, how many say yes."""
        if self.median is None:
            return DASH
        if self.spec.unit == "yes":
            return f"yes in {round(self.median * self.n)} of {self.runs}"
        worst = "" if self.worst is None or self.n == 1 else f", worst {shown(self.worst, self.spec.unit)}"
        some = "" if self.n == self.runs else f" ({self.n} of {self.runs})"
        return f"{shown(self.median, self.spec.unit)}{worst}{some}"


@dataclass(frozen=True)
class Difference:
    """One number of a side minus that of the first: the mean, in pairs where `pairs`, and its interval."""

    spec: MetricSpec
    interval: Interval
    pairs: bool

    @property
    def verdict(self) -> str:
        """One of VERDICTS, the first three where the interval leaves out 0; empty without a difference."""
        value, low, high = self.interval.value, self.interval.low, self.interval.high
        if value is None:
            return ""
        if low is None or high is None:
            return "no spread" if value else "the same"
        if low <= 0.0 <= high:
            return "within the spread"
        if not self.spec.sense or not self.spec.judged:
            return "different"
        return "better" if value * self.spec.sense > 0.0 else "worse"

    @property
    def text(self) -> str:
        """The mean difference and its interval."""
        value, low, high = self.interval.value, self.interval.low, self.interval.high
        unit = "percent" if self.spec.unit == "yes" else self.spec.unit
        if value is None:
            return ""
        text = f"{'+' if value > 0.0 else ''}{shown(value, unit)}"
        return text if low is None else f"{text} ({shown(low, unit)} to {shown(high, unit)})"


@dataclass(frozen=True)
class RunRow:
    """One number of every side; `differences` are those of all sides but the first."""

    spec: MetricSpec
    summaries: Sequence[Summary]
    differences: Sequence[Difference]


@dataclass(frozen=True, eq=False)
class RunComparison:
    """Several sides of one kind; `settings` are (key, text of each side) of those that differ."""

    sides: Sequence[Side]
    rows: Sequence[RunRow]
    settings: Sequence[tuple[str, Sequence[str]]]

    @property
    def sentences(self) -> list[str]:
        """For each side but the first, how many numbers differ beyond the spread."""
        return [self._sentence(k) for k in range(1, len(self.sides))]

    def _sentence(self, k: int) -> str:
        a, b = self.sides[0], self.sides[k]
        single = [side.letter for side in (a, b) if len(side.stages) == 1]
        if single:
            few = " and ".join(single)
            return f"{b.letter} against {a.letter}: one run of {few}: no spread, so no difference is judged."
        told = Counter(row.differences[k - 1].verdict for row in self.rows)
        counts = ", ".join(f"{told[word]} {word}" for word in VERDICTS if told[word])
        pairs = max(
            (row.differences[k - 1].interval.n for row in self.rows if row.differences[k - 1].pairs),
            default=0,
        )
        how = f"{counted(pairs, 'pair')} by seed" if pairs else "not in pairs"
        return f"{b.letter} against {a.letter} ({how}): {counts or 'no number in common'}."

    @property
    def metrics(self) -> dict[str, Any]:
        """Its metrics.json: the summaries of each side, and the differences to the first, by number."""
        sides = {
            side.letter: {
                "name": side.name,
                "runs": len(side.stages),
                "numbers": {
                    row.spec.path: {
                        "n": row.summaries[k].n,
                        "median": row.summaries[k].median,
                        "worst": row.summaries[k].worst,
                        "values": [value for _, value in side.values(row.spec)],
                    }
                    for row in self.rows
                },
            }
            for k, side in enumerate(self.sides)
        }
        differences = {
            side.letter: {row.spec.path: _record(row.differences[k]) for row in self.rows}
            for k, side in enumerate(self.sides[1:])
        }
        return {"sides": sides, "differences": differences, "sentence": " ".join(self.sentences)}


def _record(one: Difference) -> dict[str, Any]:
    found = one.interval
    told = {"n": found.n, "mean": found.value, "low": found.low, "high": found.high}
    return {**told, "in_pairs": one.pairs, "verdict": one.verdict}


def compare_runs(sides: Sequence[tuple[str, Sequence[Stage]]]) -> RunComparison:
    """(name, runs) of every side, the first being what the others are compared with.

    InputError for runs of several kinds, and for more sides than there are letters.
    """
    if len(sides) > MOST:
        raise InputError(f"compare takes at most {MOST} systems, not {len(sides)}")
    stages = [stage for _, runs in sides for stage in runs]
    for stage in stages[1:]:
        if stage.kind != stages[0].kind:
            raise InputError(
                f"{stages[0].folder} is a {stages[0].kind} output and {stage.folder} a {stage.kind} output: "
                "nothing to compare"
            )
    known = [
        Side(letter, name, runs, [stage_metrics(run) for run in runs], [seed_of(run) for run in runs])
        for letter, (name, runs) in zip(ascii_uppercase, sides, strict=False)
    ]
    rows = [_row(spec, known) for spec in SPECS[stages[0].kind]]
    rows = [row for row in rows if any(summary.n for summary in row.summaries)]
    return RunComparison(known, rows, changed_between([[run.config for run in runs] for _, runs in sides]))


def seed_of(stage: Stage) -> Hashable:
    """What two runs share that make a pair: their world and seed, and those of the recording that they read,
    or its hashes where it is not one of ours."""
    return _world(stage.manifest), stage.manifest.seed, _recording(stage)


def _recording(stage: Stage) -> Hashable:
    read = next(
        (stage.manifest.inputs[name] for name in ("source", "bag") if name in stage.manifest.inputs), None
    )
    if read is None:
        return None
    place = read.path
    if not place.exists() and stage.manifest.started_in is not None:
        place = stage.folder.resolve() / stage.manifest.started_in / place
    for folder in (place, place.parent):
        with suppress(InputError):
            made = read_manifest(folder / "manifest.json")
            if made.stage == "record" and made.seed is not None:
                return _world(made), made.seed
    return frozenset(read.sha256.items())


def _world(manifest: Manifest) -> str:
    return str((manifest.request or {}).get("world", manifest.world))


def _row(spec: MetricSpec, sides: Sequence[Side]) -> RunRow:
    return RunRow(
        spec, [_summary(spec, side) for side in sides], [_difference(spec, sides[0], b) for b in sides[1:]]
    )


def _summary(spec: MetricSpec, side: Side) -> Summary:
    values = [value for _, value in side.values(spec)]
    if not values:
        return Summary(spec, len(side.stages), 0, None, None)
    middle = float(np.mean(values) if spec.unit == "yes" else np.median(values))
    worst = (min if spec.sense > 0 else max)(values) if spec.sense and spec.judged else None
    return Summary(spec, len(side.stages), len(values), middle, worst)


def _difference(spec: MetricSpec, a: Side, b: Side) -> Difference:
    one, other = a.values(spec), b.values(spec)
    by_seed = [dict(values) for values in (one, other)]
    seeds = [seed for seed in by_seed[0] if seed in by_seed[1]]
    paired = [len(set(side.seeds)) == len(side.seeds) for side in (a, b)] == [True, True] and len(seeds) > 1
    values_a, values_b = (np.array([value for _, value in values]) for values in (one, other))
    if spec.unit == "yes":
        return Difference(spec, share_difference(values_a, values_b), False)
    if paired:
        return Difference(spec, mean_interval(np.array([by_seed[1][s] - by_seed[0][s] for s in seeds])), True)
    return Difference(spec, mean_difference(values_a, values_b), False)


def changed_between(sides: Sequence[Sequence[Mapping[str, Any]]]) -> list[tuple[str, list[str]]]:
    """(key, values of each side) of every setting that has not the same values on all sides."""
    flat = [[{key: _text(value) for key, value in leaves(config)} for config in runs] for runs in sides]
    keys = dict.fromkeys(key for runs in flat for run in runs for key in run)
    found = []
    for key in keys:
        held = [sorted({run.get(key, "not set") for run in runs}) for runs in flat]
        if any(values != held[0] for values in held):
            found.append((key, [_listed(values) for values in held]))
    return found


def _text(value: Any) -> str:
    return value if isinstance(value, str) else json.dumps(value)


def _listed(values: Sequence[str]) -> str:
    more = f", and {len(values) - MOST_SETTINGS} more" if len(values) > MOST_SETTINGS else ""
    return ", ".join(values[:MOST_SETTINGS]) + more
