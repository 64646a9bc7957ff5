"""One line for each output below some folders: what a sortable table of many runs shows."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from turtlebag.datasets.errors import InputError
from turtlebag.datasets.plurals import counted
from turtlebag.reports.kinds import KINDS, stage_metrics, verdict
from turtlebag.reports.metric_specs import SPECS
from turtlebag.reports.metrics.navigation import goal_counts
from turtlebag.reports.numbers import lookup, shown
from turtlebag.reports.stages import Stage, load_stage, read_json
from turtlebag.reports.verdicts import collision_count

BY_PATH = {spec.path: spec for specs in SPECS.values() for spec in specs}
# (head, path in the metrics)
COLUMNS = (
    ("trajectory error (ATE)", "ate_m.rmse"),
    ("wall cells within one cell", "map.occupied_error_m.within_one_cell"),
    ("surfaces found", "map.coverage"),
    ("relations error", "relations.trans_m.mean"),
    ("localisation error", "localisation_error_m.rmse"),
    ("minimum clearance", "min_clearance_m"),
    ("distance", "distance_m"),
    ("time", "time_s"),
)


@dataclass(frozen=True)
class Line:
    """One output: texts to show and what to sort by."""

    name: str
    stage: str
    world: str
    robot: str
    seed: str
    mood: str
    result: str
    values: list[tuple[str, str]]


def shown_outputs(roots: Sequence[Path]) -> dict[Path, str]:
    """Folders below the roots (or themselves) of finished records, maps and runs, and the names to show them
    by; everything else is passed over."""
    found = {}
    for root in roots:
        if not root.is_dir():
            raise InputError(f"{root}: no such folder")
        for path in sorted(root.rglob("manifest.json")):
            growing = any(part.endswith(".partial") for part in path.parts)
            if not growing and read_json(path).get("stage") in KINDS:
                found[path.parent.resolve()] = _name(path.parent, root)
    return found


def index_lines(outputs: Mapping[Path, str]) -> list[Line]:
    """A line for each output, by its name.

    What a map or a localisation does not say itself - world, robot, seed - is its recording's, where that is
    among the outputs.
    """
    stages = {name: load_stage(folder) for folder, name in outputs.items()}
    records = {
        digest: stage
        for stage in stages.values()
        if stage.kind == "record"
        for path, digest in stage.manifest.outputs.items()
        if path.startswith("bag/bag_")
    }
    return [
        _line(stage, name, next((records[one] for one in stage.linking_hashes() if one in records), stage))
        for name, stage in stages.items()
    ]


def used_columns(lines: Sequence[Line]) -> list[tuple[int, str, str]]:
    """(place among COLUMNS, head, meaning) of the columns that any line has a value for."""
    return [
        (place, head, BY_PATH[path].meaning)
        for place, (head, path) in enumerate(COLUMNS)
        if any(line.values[place][0] for line in lines)
    ]


def _name(folder: Path, root: Path) -> str:
    relative = folder.relative_to(root).as_posix()
    return root.resolve().name if relative == "." else f"{root.resolve().name}/{relative}"


def _line(stage: Stage, name: str, source: Stage) -> Line:
    metrics = stage_metrics(stage)
    seed = stage.manifest.seed if stage.manifest.seed is not None else source.manifest.seed
    mood, _ = verdict(stage, metrics) if stage.metrics else ("neutral", "")
    return Line(
        name,
        stage.fact("task") or stage.kind,
        stage.fact("world") or source.fact("world") or "",
        stage.fact("robot") or source.fact("robot") or "",
        "" if seed is None else str(seed),
        mood,
        _result(stage, metrics),
        [_cell(metrics, path) for _, path in COLUMNS],
    )


def _cell(metrics: Mapping[str, Any], path: str) -> tuple[str, str]:
    value = lookup(metrics, path)
    return ("", "") if value is None else (shown(value, BY_PATH[path].unit), repr(value))


def _result(stage: Stage, metrics: Mapping[str, Any]) -> str:
    if stage.kind != "navigate":
        return f"{metrics['scans']} scans" if "scans" in metrics else ""
    goals = metrics.get("goals") or []
    reached = goal_counts(goals)["goals_truly_reached"]
    hits = collision_count(metrics)
    parts = [f"{reached} of {len(goals)} goals"] if goals else []
    if hits or not goals:
        parts.append(counted(hits, "collision") if hits else "no collision")
    return ", ".join(parts)
