"""Compare outputs of one stage, or one with what other systems made, as a table and as a page."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import Any

from turtlebag.datasets.errors import InputError
from turtlebag.datasets.other_systems import SystemFiles
from turtlebag.datasets.outputs import Output
from turtlebag.pipeline.stages.command_line import recorded
from turtlebag.pipeline.stages.other_systems import inputs_of, measured, ours_of, systems_of
from turtlebag.pipeline.stages.recipe import command_of
from turtlebag.pipeline.stages.requests.options import flag_of
from turtlebag.pipeline.stages.requests.pages import SYSTEM_OPTIONS, CompareRequest
from turtlebag.reports.compare import Comparison, compare, draw_comparison
from turtlebag.reports.figures.album import Album
from turtlebag.reports.page import fill
from turtlebag.reports.run_comparison import RunComparison, compare_runs
from turtlebag.reports.stages import Stage, load_stage
from turtlebag.reports.system_comparison import SystemComparison, compare_systems, write_pairs


def compare_as_asked(
    request: CompareRequest, out: Output | None
) -> Comparison | RunComparison | SystemComparison:
    """The comparison of outputs or runs, or of ours and other systems'; with `out` as a page too."""
    out = out and recorded(request, out)
    for name, path in request.b:
        if not name and not path.exists():
            raise InputError(f"{path}: no such output, trajectory or map")
    if not any(not name and path.is_dir() for name, path in request.b):
        return compare_with_systems(request.a, systems_of(request, request.b), out)
    folders = [request.a, *(path for name, path in request.b if not name and path.is_dir())]
    if len(folders) <= len(request.b):
        raise InputError("compare takes outputs, or one output and files of other systems, not both")
    for option in SYSTEM_OPTIONS:
        if getattr(request, option):
            raise InputError(
                f"{flag_of(option)}: only for files of other systems; {folders[1]} is an output of turtlebag"
            )
    if len(folders) == 2 and all((folder / "manifest.json").is_file() for folder in folders):
        return compare_outputs(folders[0], folders[1], out)
    return compare_sides(folders, out)


def compare_sides(folders: Sequence[Path], out: Output | None = None) -> RunComparison:
    """Numbers and settings of several sides: each folder is an output, or holds the outputs of several runs.

    With `out` also `index.html`, `metrics.json` and the manifest.
    """
    sides = [(folder.resolve().name, _runs(folder)) for folder in folders]
    found = compare_runs(sides)
    if out is None:
        return found
    commands = [
        command_of(run, f"{side.letter}/{run.folder.name}") for side in found.sides for run in side.stages
    ]
    with out.staged() as partial:
        (partial / "index.html").write_text(fill("compare_runs.html.j2", found=found, commands=commands))
        inputs = {side.letter: folder for side, folder in zip(found.sides, folders, strict=True)}
        out.finish(partial, "compare", inputs, metrics=found.metrics)
    return found


def _runs(folder: Path) -> list[Stage]:
    if folder.is_dir() and not (folder / "manifest.json").is_file():
        runs = [
            path.parent for path in sorted(folder.glob("*/manifest.json")) if path.parent.suffix != ".partial"
        ]
        if not runs:
            raise InputError(f"{folder}: is no finished output, and holds none")
        return [load_stage(run) for run in runs]
    return [load_stage(folder)]


def compare_outputs(a: Path, b: Path, out: Output | None = None) -> Comparison:
    """Numbers, settings and files of two outputs of one stage.

    With `out` also `index.html`, `figures/*.png`, `metrics.json` and the manifest.
    """
    stages = load_stage(a), load_stage(b)
    found = compare(*stages)
    if out is None:
        return found
    names = {"name_a": f"A: {a.resolve().name}", "name_b": f"B: {b.resolve().name}"}
    commands = [command_of(stage, name) for stage, name in zip(stages, "AB", strict=True)]
    with out.staged() as folder:
        album = Album(folder / "figures")
        draw_comparison(*stages, album)
        told: dict[str, Any] = {"found": found, "commands": commands, "pictures": album.pictures}
        page = fill("compare.html.j2", **names, **told)
        (folder / "index.html").write_text(page)
        metrics = {row.spec.path: row.values for row in found.rows}
        out.finish(folder, "compare", {"A": a, "B": b}, metrics=metrics)
    return found


def compare_with_systems(
    folder: Path, files: Sequence[SystemFiles], out: Output | None = None
) -> SystemComparison:
    """An output of ours beside what other systems made of the same recording.

    With `out` also `index.html`, `figures/*.png`, `systems/*.tum`, `metrics.json` and the manifest.
    """
    stage = ours_of([load_stage(folder)])
    known, systems = measured(stage, files)
    if out is None:
        return compare_systems(systems, known, Album(None), "systems")
    with out.staged() as partial:
        found = compare_systems(systems, known, Album(partial / "figures"), "systems")
        page = fill("compare_systems.html.j2", recording=stage.folder.resolve().name, found=found)
        (partial / "index.html").write_text(page)
        write_pairs(systems, partial / "systems")
        out.finish(partial, "compare", {"ours": folder, **inputs_of(files)}, metrics=found.metrics)
    return found
