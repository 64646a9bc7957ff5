"""Compare outputs of one stage, or one with what other systems made, as a table and as a page."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

from turtlebag.datasets.errors import InputError
from turtlebag.datasets.other_systems import SystemFiles
from turtlebag.datasets.outputs import Output
from turtlebag.pipeline.stages.command_line import recorded
from turtlebag.pipeline.stages.other_systems import inputs_of, measured, ours_of, systems_of
from turtlebag.pipeline.stages.recipe import command_of
from turtlebag.pipeline.stages.requests.options import flag_of
from turtlebag.pipeline.stages.requests.pages import SYSTEM_OPTIONS, CompareRequest
from turtlebag.reports.compare import Comparison, compare, draw_pair
from turtlebag.reports.figures.album import Album
from turtlebag.reports.page import fill
from turtlebag.reports.stages import Stage, load_stage
from turtlebag.reports.system_comparison import SystemComparison, compare_systems, write_pairs


def compare_with_page(request: CompareRequest, out: Output) -> int:
    """Write the page of a comparison; 0."""
    compare_as_asked(request, out)
    return 0


def compare_as_asked(request: CompareRequest, out: Output | None) -> Comparison | SystemComparison:
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
    return compare_outputs(folders, out)


def compare_outputs(folders: Sequence[Path], out: Output | None = None) -> Comparison:
    """Numbers and settings of several sides: each folder is an output, or holds the outputs of several runs.

    With `out` also `index.html`, `metrics.json` and the manifest, and of two outputs `figures/*.svg`.
    """
    found = compare([(folder.resolve().name, _runs(folder)) for folder in folders])
    if out is None:
        return found
    commands = [
        command_of(run, f"{side.letter}/{run.folder.name}" if len(side.stages) > 1 else side.letter)
        for side in found.sides
        for run in side.stages
    ]
    with out.staged() as partial:
        album = Album(partial / "figures")
        if found.pair is not None:
            draw_pair(found.pair, album)
        page = fill("compare.html.j2", found=found, commands=commands, pictures=album.pictures)
        (partial / "index.html").write_text(page)
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


def compare_with_systems(
    folder: Path, files: Sequence[SystemFiles], out: Output | None = None
) -> SystemComparison:
    """An output of ours beside what other systems made of the same recording.

    With `out` also `index.html`, `figures/*.svg`, `systems/*.tum`, `metrics.json` and the manifest.
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
