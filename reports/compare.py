"""Outputs of one stage beside each other, one run a side or several: numbers, settings, maps, paths.

Differences count only beyond the spread over the runs; of one run a side it is not known.
"""

from __future__ import annotations

import json
from collections import Counter
from collections.abc import Hashable, Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass
from functools import cached_property
from string import ascii_uppercase
from typing import Any

import numpy as np

from turtlebag.datasets.errors import InputError
from turtlebag.datasets.grid import OccupancyGrid
from turtlebag.datasets.plurals import counted
from turtlebag.datasets.se2 import Array
from turtlebag.datasets.types import Stamps
from turtlebag.reports.figures import series, systems
from turtlebag.reports.figures.album import Album
from turtlebag.reports.kinds import KINDS, stage_metrics, verdict
from turtlebag.reports.metric_specs import SPECS, MetricSpec
from turtlebag.reports.metrics.map import walls_in
from turtlebag.reports.metrics.statistics import Interval, mean_difference, mean_interval, share_difference
from turtlebag.reports.metrics.trajectory import associate
from turtlebag.reports.numbers import DASH, finite, leaves, lookup, shown
from turtlebag.reports.stages import Group, Manifest, Stage, read_manifest
from turtlebag.reports.verdicts import Verdict

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
        if self.spec.unit == "yes" and self.runs > 1:
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
class Pair:
    """The two outputs of a comparison of one run with another, and what is to be said of each."""

    a: Stage
    b: Stage
    verdicts: tuple[Verdict, Verdict]

    @property
    def same_source(self) -> bool | None:
        """Whether both were made from the same source files; None where that is not known of both."""
        one, other = self.a.hashes("source"), self.b.hashes("source")
        return one == other if one and other else None

    @property
    def same_bytes(self) -> list[str]:
        """Files that both have, and that are the same."""
        made = self.b.manifest.outputs
        return sorted(path for path, digest in self.a.manifest.outputs.items() if made.get(path) == digest)

    @property
    def changed(self) -> list[str]:
        """Files that both have, and that are not the same."""
        both = set(self.a.manifest.outputs) & set(self.b.manifest.outputs)
        return sorted(both - set(self.same_bytes))


@dataclass(frozen=True, eq=False)
class Comparison:
    """Several sides of one kind; `settings` are (key, text of each side) of those that differ."""

    sides: Sequence[Side]
    rows: Sequence[RunRow]
    settings: Sequence[tuple[str, Sequence[str]]]

    @cached_property
    def pair(self) -> Pair | None:
        """The two outputs, of two sides of one run each."""
        runs = [(run, one) for side in self.sides for run, one in zip(side.stages, side.metrics, strict=True)]
        if len(self.sides) > 2 or len(runs) > 2:
            return None
        (a, of_a), (b, of_b) = runs
        return Pair(a, b, (verdict(a, of_a), verdict(b, of_b)))

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


def compare(sides: Sequence[tuple[str, Sequence[Stage]]]) -> Comparison:
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
    return Comparison(known, rows, changed_between([[run.config for run in runs] for _, runs in sides]))


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


def draw_pair(pair: Pair, album: Album) -> None:
    """Maps over each other, paths over each other, errors over time of both."""
    a, b = pair.a, pair.b
    if a.map is not None and b.map is not None:
        both, only_a, only_b = map_overlap(a.map, b.map)
        caption = (
            f"Wall cells: {both} in both to a cell (grey), {only_a} only in A, {only_b} only in B. Coloured "
            "walls exist in only one of the two."
        )
        album.add("maps", "Maps", caption, systems.walls, a.map, b.map, ("A", "B"))
    path_a, path_b = KINDS[a.kind].path(a), KINDS[b.kind].path(b)
    if path_a is not None and path_b is not None:
        grids = (a.map, a.true_map, Group("", (a,)).given_map(a))
        ground = next((grid for grid in grids if grid is not None), None)
        caption = f"{KINDS[a.kind].paths}: A wide, B thin on top of it."
        album.add("paths", "Paths", caption, systems.paths, ground, None, {"A": path_a, "B": path_b})
    errors_a, errors_b = _errors(a), _errors(b)
    if errors_a is not None and errors_b is not None:
        caption = (
            "Distance of the estimate from the truth, each run in its own time; lower is better. "
            f"{series.AXIS_TOLD}"
        )
        both_errors = {"A": errors_a, "B": errors_b}
        label = "position error [cm]"
        album.add("errors", "Position error", caption, systems.errors, both_errors, "AB", label)
    elif a.kind == "map" and path_a is not None and path_b is not None and pair.same_source:
        pairs = associate(path_b, path_a)
        caption = f"Distance between the estimates of A and B at the same instant. {series.AXIS_TOLD}"
        apart = {"A to B": (pairs.stamps_ns, pairs.position_errors())}
        album.add("apart", "Difference", caption, systems.errors, apart, [*apart], "A to B [cm]")


def _errors(stage: Stage) -> tuple[Stamps, Array] | None:
    """A run's localisation error [m], by the time since its first scan."""
    if stage.kind != "navigate" or not stage.localised or stage.trajectory is None or stage.truth is None:
        return None
    pairs = associate(stage.trajectory, stage.truth)
    return pairs.stamps_ns - pairs.stamps_ns[0], pairs.position_errors()


def map_overlap(a: OccupancyGrid, b: OccupancyGrid) -> tuple[int, int, int]:
    """Occupied cells of A that B has too, to a cell, those that it has not, and those of B that A has not."""
    in_b, in_a = walls_in(a, b), walls_in(b, a)
    return int(in_b.sum()), int((~in_b).sum()), int((~in_a).sum())
