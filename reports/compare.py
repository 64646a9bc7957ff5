"""Two outputs of one stage side by side: settings, numbers, maps, paths."""

from __future__ import annotations

import json
import math
import re
import shlex
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

from turtlebag.datasets.errors import InputError
from turtlebag.datasets.grid import OccupancyGrid
from turtlebag.datasets.se2 import Array
from turtlebag.datasets.types import Stamps, Trajectory
from turtlebag.reports.content import stage_metrics, verdict
from turtlebag.reports.figures import series, systems
from turtlebag.reports.figures.album import Album
from turtlebag.reports.metric_specs import LESS_IS_BETTER, MORE_IS_BETTER, SPECS, MetricSpec
from turtlebag.reports.metrics.map import walls_in
from turtlebag.reports.metrics.trajectory import associate
from turtlebag.reports.numbers import DASH, leaves, lookup, shown
from turtlebag.reports.provenance import renamed
from turtlebag.reports.stages import Group, Stage

PATHS = {"map": "SLAM's paths", "localise": "AMCL's estimates", "plan": "The plans"}


@dataclass(frozen=True)
class Row:
    """One number of both; `mood` says whether B is better, worse or neither."""

    path: str
    label: str
    a: str
    b: str
    difference: str
    relative: str
    mood: str
    values: tuple[float | None, float | None]


@dataclass(frozen=True)
class Comparison:
    """What differs between two outputs of one kind; `verdicts` are (mood, sentence) of each."""

    verdicts: tuple[tuple[str, str], tuple[str, str]]
    rows: list[Row]
    settings: list[tuple[str, str, str]]
    same_bytes: list[str]
    changed: list[str]
    commands: tuple[str, str]
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
            rows.append(_row(spec, _number(one), _number(other)))
    files = sorted(set(a.manifest.outputs) & set(b.manifest.outputs))
    same = [path for path in files if a.manifest.outputs[path] == b.manifest.outputs[path]]
    settings = changed_settings(a.config, b.config)
    commands = command_of(a, "A"), command_of(b, "B")
    known = all("source" in stage.manifest.inputs for stage in (a, b))
    source = same_input(a, b) if known else None
    verdicts = verdict(a, metrics_a), verdict(b, metrics_b)
    return Comparison(verdicts, rows, settings, same, sorted(set(files) - set(same)), commands, source)


def command_of(stage: Stage, name: str) -> str:
    """The command that made a stage, its output called `name`, of absolute paths the last part only."""
    out = stage.option("out")
    names = {} if out is None else {out.rstrip("/"): name}
    words = renamed(stage.command, names)
    return shlex.join(re.sub(r"^(--[\w-]+=)?/.*/(?=[^/])", r"\1", word) for word in words)


def _number(value: Any) -> float | None:
    return float(value) if isinstance(value, (int, float)) and math.isfinite(value) else None


def _row(spec: MetricSpec, a: float | None, b: float | None) -> Row:
    path, label, unit = spec.path, spec.label, spec.unit
    difference, relative, mood = "", "", "neutral"
    if unit == "yes":
        texts = [DASH if value is None else shown(bool(value), unit) for value in (a, b)]
        mood = _mood(path, b - a) if a is not None and b is not None and a != b else "neutral"
        return Row(path, label, texts[0], texts[1], "=" if a == b else "\u2260", "", mood, (a, b))
    if a is not None and b is not None:
        change = b - a
        difference = "=" if change == 0.0 else shown(change, unit)
        if change != 0.0 and not any(digit in difference for digit in "123456789"):
            difference = "\u2248"
        elif change != 0.0:
            difference = f"+{difference}" if change > 0 else difference
            relative = f"{100.0 * change / abs(a):+.0f} %".replace("-", "\u2212") if a != 0.0 else ""
            mood = _mood(path, change)
    return Row(path, label, shown(a, unit), shown(b, unit), difference, relative, mood, (a, b))


def _mood(path: str, change: float) -> str:
    last = path.rpartition(".")[2]
    if last not in MORE_IS_BETTER + LESS_IS_BETTER:
        return "neutral"
    return "good" if (change > 0) == (last in MORE_IS_BETTER) else "bad"


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
    path_a, path_b = driven(a), driven(b)
    if path_a is not None and path_b is not None:
        grids = (a.map, a.true_map, Group("", (a,)).given_map(a))
        ground = next((grid for grid in grids if grid is not None), None)
        caption = f"{PATHS.get(a.kind, 'True paths')}: A wide, B thin on top of it."
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


def driven(stage: Stage) -> Trajectory | None:
    """What a stage's picture shows as its path: an estimate, a plan, or the true path of a drive."""
    if stage.kind in ("map", "localise"):
        return stage.trajectory
    if stage.kind == "plan":
        return stage.plan
    return stage.truth


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
