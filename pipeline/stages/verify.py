"""Verify a report: hashes of everything it rests on, and every number computed again."""

from __future__ import annotations

import difflib
import html
import re
from collections.abc import Iterable, Mapping
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any

import numpy as np
from scipy import ndimage

from turtlebag.datasets.errors import InputError
from turtlebag.datasets.grid import OccupancyGrid
from turtlebag.datasets.outputs import sha256_file
from turtlebag.datasets.se2 import SE2, Array
from turtlebag.pipeline.stages import recompute
from turtlebag.pipeline.stages.other_systems import MARK, from_manifest, inputs_of, measured_in
from turtlebag.pipeline.stages.run_again import Run, places_of, remade
from turtlebag.reports.content import build_chapter, stage_metrics
from turtlebag.reports.figures.album import Album
from turtlebag.reports.grouping import group_stages
from turtlebag.reports.metrics.map import occupied
from turtlebag.reports.numbers import leaves, shown
from turtlebag.reports.page import render
from turtlebag.reports.stages import (
    Group,
    Manifest,
    Stage,
    changed_files,
    changed_parts,
    load_stage,
    read_json,
    read_manifest,
)
from turtlebag.reports.system_comparison import SystemComparison, compare_systems


@dataclass
class Verification:
    """What was found: every check, every problem in one line each, what could not be checked, and
    stages that came out equal in numbers but not in bytes when run again.
    """

    checks: list[recompute.Check] = field(default_factory=list)
    problems: list[str] = field(default_factory=list)
    unchecked: list[str] = field(default_factory=list)
    files: int = 0
    notes: list[str] = field(default_factory=list)


def stage_folders(report: Path, manifest: Manifest) -> list[Path]:
    """Where the report's stages are: where the manifest says, or beside a report that was moved with them."""
    if manifest.stage != "report":
        raise InputError(f"{report}: is a {manifest.stage} output, not a report")
    folders = []
    for label, entry in manifest.inputs.items():
        if label.startswith("rival:"):
            raise InputError(f"{report}: is a report of an earlier version; make it again")
        if label.startswith(MARK):
            continue
        for candidate in (report / manifest.folders.get(label, ""), entry.path):
            if (candidate / "manifest.json").is_file():
                folders.append(candidate)
                break
        else:
            raise InputError(f"{report}: its input {label} is neither at {entry.path} nor next to the report")
    return folders


def _file(folder: Path, name: str) -> Path:
    if not folder.is_dir():
        raise InputError(f"{folder}: no such folder (expected a report)")
    if not (folder / name).is_file():
        raise InputError(f"{folder}: has no {name}, so it is not a report")
    return folder / name


def verify(report: Path, run: Run | None = None) -> Verification:
    """Check a report folder; InputError when it or its inputs cannot be read at all.

    With `run`, stages whose numbers their files alone do not hold are run again from what they read.
    """
    found = Verification()
    manifest = read_manifest(_file(report, "manifest.json"))
    groups = group_stages([load_stage(folder) for folder in stage_folders(report, manifest)])
    reported = read_json(_file(report, "metrics.json"))
    _check_report_files(report, manifest, groups, found)
    places = places_of(groups)
    for group in groups:
        for stage in group.stages:
            chapter = reported.get(group.name)
            metrics = chapter.get(stage.label) if isinstance(chapter, dict) else None
            if not isinstance(metrics, dict):
                found.problems.append(f"{group.name}/{stage.label}: not in the report's metrics.json")
                continue
            _check_stage(stage, group, metrics, places, run, found)
    systems = _check_systems(report, manifest, groups, reported, found) if manifest.systems else None
    _check_texts(_file(report, "index.html"), groups, systems, found)
    return found


def _check_report_files(report: Path, manifest: Manifest, groups: list[Group], found: Verification) -> None:
    found.files += len(manifest.outputs)
    for path in changed_files(report, manifest.outputs):
        found.problems.append(f"{report.name}/{path}: changed since the report was made")
    for group in groups:
        for stage in group.stages:
            name = f"{group.name}/{stage.label}"
            if name not in manifest.inputs:
                continue
            then = manifest.inputs[name].sha256
            # In the folder of a stage there may be files that it did not make.
            others = {path: digest for path, digest in then.items() if path not in stage.manifest.outputs}
            again = [
                path for path, digest in then.items() if stage.manifest.outputs.get(path, digest) != digest
            ]
            for path in [*again, *changed_files(stage.folder, others)]:
                found.problems.append(f"{name}/{path}: changed since the report was made")


def _check_stage(
    stage: Stage,
    group: Group,
    metrics: Mapping[str, Any],
    places: dict[str, str],
    run: Run | None,
    found: Verification,
) -> None:
    name = f"{group.name}/{stage.label}"
    found.files += len(stage.manifest.outputs)
    changed = changed_files(stage.folder, stage.manifest.outputs)
    found.problems += [f"{name}/{path}: does not match its manifest" for path in changed]
    found.problems += [f"{name}: {said}" for said in changed_parts(stage)]
    disagreement = recompute.truth_disagreement(stage)
    if disagreement is not None and disagreement > recompute.TRUTH_AGREES_M:
        apart = shown(disagreement, "cm")
        found.problems.append(
            f"{name}/truth/trajectory.tum: differs by {apart} from the bag's /ground_truth/odom"
        )
    if stage.kind == "navigate":
        _check_clearance(stage, name, found)
    for path, value in leaves(stage_metrics(stage)):
        if dict(leaves(metrics)).get(path) != value:
            found.problems.append(f"{name}:{path}: the report and the stage's own metrics differ")
    try:
        done = list(recompute.checks(name, metrics, recompute.recomputed(stage, group, places)))
    except InputError as error:
        found.problems.append(f"{name}: {error}")
        return
    left = _unknown(name, metrics, done)
    if left and run is not None and (anew := remade(stage, places, run)) is not None:
        if anew.other_bytes:
            found.notes.append(f"{name}: run again, different bytes in {', '.join(anew.other_bytes)}")
        done += [check for check in recompute.checks(name, metrics, anew.metrics) if check.key in left]
        left = _unknown(name, metrics, done)
    found.unchecked += left
    _keep(done, found)


def _check_systems(
    report: Path, manifest: Manifest, groups: list[Group], reported: Mapping[str, Any], found: Verification
) -> SystemComparison | None:
    """The other systems measured again: what the report should say of them, None when they cannot be."""
    group = groups[0]
    name = f"{group.name}/systems"
    try:
        files = from_manifest(manifest, report)
        changed = [
            f"{what}: {path} changed since the report was made"
            for what, path in inputs_of(files).items()
            if not path.is_file() or sha256_file(path) not in manifest.inputs[what].sha256.values()
        ]
        known, systems = measured_in(groups, files)
    except (InputError, KeyError) as error:
        found.problems.append(f"{name}: {error}")
        return None
    expected = compare_systems(systems, known, Album(None), f"{group.name}-systems")
    told = reported.get(group.name, {}).get("systems", {})
    found.problems += changed
    if missing := {path for path, _ in leaves(expected.metrics)} - {path for path, _ in leaves(told)}:
        found.problems.append(f"{name}: not in the report's metrics.json: {', '.join(sorted(missing)[:3])}")
    _keep(recompute.checks(name, told, expected.metrics), found)
    return expected


def _keep(done: Iterable[recompute.Check], found: Verification) -> None:
    """Add checks, and a problem for each that found another number."""
    for check in done:
        found.checks.append(check)
        if not check.agrees:
            found.problems.append(f"{check.key}: reported {check.reported}, computed {check.found}")


def _unknown(name: str, metrics: Mapping[str, object], done: list[recompute.Check]) -> list[str]:
    """Keys of the numbers no check is about."""
    known = {check.key for check in done}
    return [
        f"{name}:{path}"
        for path, value in leaves(metrics)
        if f"{name}:{path}" not in known and isinstance(value, (int, float)) and not isinstance(value, bool)
    ]


def clearance_on_map(footprint: Array, grid: OccupancyGrid, T_world_base: SE2) -> float:
    """Least distance [m] from the footprint's outline to an occupied cell of the true map, along true poses.

    The map holds what crosses the lidar plane only: the clearance that counts low things is at most this.
    """
    corners = np.concatenate([footprint, footprint[:1]])
    share = np.linspace(0.0, 1.0, 8, endpoint=False)[:, None, None]
    outline = (corners[:-1] + share * (corners[1:] - corners[:-1])).reshape(-1, 2)
    cells = grid.cell_of(T_world_base[:, None] @ outline)
    cells = np.clip(cells, 0, np.array(grid.shape) - 1)
    room = ndimage.distance_transform_edt(~occupied(grid)) * grid.resolution
    return float(room[cells[..., 0], cells[..., 1]].min())


def _check_clearance(stage: Stage, name: str, found: Verification) -> None:
    """The reported clearance against that on the true map, where robot and map are known."""
    reported, robot, grid = stage.metrics.get("min_clearance_m"), recompute.robot_of(stage), stage.true_map
    if robot is None or grid is None or not isinstance(reported, (int, float)):
        return
    room = clearance_on_map(robot.model.footprint, grid, stage.driven.poses[::3])
    if reported > room + 2.0 * grid.resolution:
        found.problems.append(
            f"{name}:min_clearance_m: reported {reported:.3f}, but the true map leaves only {room:.3f} m"
        )


def _check_texts(
    page: Path, groups: list[Group], systems: SystemComparison | None, found: Verification
) -> None:
    """Everything the page says, written again from what was computed: tiles, verdicts, captions, hashes."""
    text = page.read_text()
    computed = {check.key: check.found for check in found.checks if not check.agrees}
    album = Album(None, animate='class="animation"' in text)
    chapters = []
    for group in groups:
        measured = {
            stage.label: replaced(stage_metrics(stage), computed, f"{group.name}/{stage.label}:")
            for stage in group.stages
        }
        chapters.append(build_chapter(group, album, measured))
    if systems is not None:
        chapters = [replace(chapters[0], systems=systems)]
    said, expected = words_of(text), words_of(render(chapters, groups))
    changes = difflib.SequenceMatcher(None, said, expected, autojunk=False).get_opcodes()
    for kind, a0, a1, b0, b1 in changes:
        if kind != "equal":
            one, other = (" / ".join(part) or "nothing" for part in (said[a0:a1], expected[b0:b1]))
            found.problems.append(f"{page.name}: says {one[:200]}; computed {other[:200]}")


def replaced(node: Any, values: Mapping[str, Any], key: str) -> Any:
    """Nested metrics with the leaves whose dotted keys are in `values` taken from there."""
    if isinstance(node, dict):
        return {
            name: replaced(item, values, f"{key}{name}" if key.endswith(":") else f"{key}.{name}")
            for name, item in node.items()
        }
    if isinstance(node, list):
        return [replaced(item, values, f"{key}.{index}") for index, item in enumerate(node)]
    return values.get(key, node)


def words_of(page: str) -> list[str]:
    """What a page says, line by line: tags, figures and white space left out, numbers after their keys."""
    body = page.partition("<body>")[2].partition("<script>")[0]
    body = re.sub(r"<svg\b.*?</svg>", "", body, flags=re.DOTALL)
    body = re.sub(r'<[^>]* data-key="([^"]*)"[^>]*>', r"\1: ", body)
    lines = (" ".join(line.split()) for line in html.unescape(re.sub(r"<[^>]*>", "", body)).splitlines())
    return [line for line in lines if line]
