"""Two outputs of one stage side by side: settings, numbers, maps, paths."""

from __future__ import annotations

import json
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

from turtlebag.datasets.errors import InputError
from turtlebag.datasets.grid import OccupancyGrid
from turtlebag.datasets.se2 import Array
from turtlebag.datasets.types import Stamps
from turtlebag.reports.figures import series, systems
from turtlebag.reports.figures.album import Album
from turtlebag.reports.kinds import KINDS, stage_metrics, verdict
from turtlebag.reports.metric_specs import SPECS
from turtlebag.reports.metrics.map import walls_in
from turtlebag.reports.metrics.trajectory import associate
from turtlebag.reports.numbers import Row, finite, leaves, lookup, shown
from turtlebag.reports.stages import Group, Stage


@dataclass(frozen=True)
class Change(Row):
    """One number of A and of B. Neither is called better: of one run each, the spread is not known."""

    @property
    def by(self) -> float | None:
        """B - A."""
        a, b = self.values
        return None if a is None or b is None else b - a

    @property
    def difference(self) -> str:
        """As shown: `≈` where it is too small to show."""
        a, b = self.values
        if self.spec.unit == "yes" or self.by == 0.0:
            return "=" if a == b else "\u2260"
        if self.by is None:
            return ""
        text = shown(self.by, self.spec.unit)
        if not any(digit in text for digit in "123456789"):
            return "\u2248"
        return f"+{text}" if self.by > 0 else text

    @property
    def relative(self) -> str:
        """The difference as a share of A; empty where that says nothing."""
        a, _ = self.values
        if not a or not self.by or self.spec.unit == "yes" or self.difference == "\u2248":
            return ""
        return f"{100.0 * self.by / abs(a):+.0f} %".replace("-", "\u2212")


@dataclass(frozen=True)
class Comparison:
    """What differs between two outputs of one kind; `verdicts` are (mood, sentence) of each."""

    verdicts: tuple[tuple[str, str], tuple[str, str]]
    rows: list[Change]
    settings: list[tuple[str, str, str]]
    same_bytes: list[str]
    changed: list[str]
    same_source: bool | None


def compare(a: Stage, b: Stage) -> Comparison:
    """Numbers, settings and files of both; InputError when they are not of one kind."""
    if a.kind != b.kind:
        raise InputError(
            f"{a.folder} is a {a.kind} output and {b.folder} a {b.kind} output: nothing to compare"
        )
    metrics_a, metrics_b = stage_metrics(a), stage_metrics(b)
    rows = []
    for spec in SPECS[a.kind]:
        one, other = lookup(metrics_a, spec.path), lookup(metrics_b, spec.path)
        if one is not None or other is not None:
            rows.append(Change(spec, (finite(one), finite(other))))
    files = sorted(set(a.manifest.outputs) & set(b.manifest.outputs))
    same = [path for path in files if a.manifest.outputs[path] == b.manifest.outputs[path]]
    settings = changed_settings(a.config, b.config)
    known = all("source" in stage.manifest.inputs for stage in (a, b))
    source = same_input(a, b) if known else None
    verdicts = verdict(a, metrics_a), verdict(b, metrics_b)
    return Comparison(verdicts, rows, settings, same, sorted(set(files) - set(same)), source)


def changed_settings(a: Mapping[str, Any], b: Mapping[str, Any]) -> list[tuple[str, str, str]]:
    """(key, value in A, value in B) of every setting that is not the same, as --set takes it."""
    one, other = dict(leaves(a)), dict(leaves(b))
    keys = [*one, *(key for key in other if key not in one)]
    return [
        (key, _setting(one, key), _setting(other, key))
        for key in keys
        if one.get(key) != other.get(key) or (key in one) != (key in other)
    ]


def _setting(settings: Mapping[str, Any], key: str) -> str:
    value = settings.get(key, "not set")
    return value if isinstance(value, str) else json.dumps(value)


def draw_comparison(a: Stage, b: Stage, album: Album) -> None:
    """Maps over each other, paths over each other, errors over time of both."""
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
    elif a.kind == "map" and path_a is not None and path_b is not None and same_input(a, b):
        pairs = associate(path_b, path_a)
        caption = f"Distance between the estimates of A and B at the same instant. {series.AXIS_TOLD}"
        apart = {"A to B": (pairs.stamps_ns, pairs.position_errors())}
        album.add("apart", "Difference", caption, systems.errors, apart, [*apart], "A to B [cm]")


def same_input(a: Stage, b: Stage) -> bool:
    """Whether both were made from the same source files."""
    return bool(a.hashes("source")) and a.hashes("source") == b.hashes("source")


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
