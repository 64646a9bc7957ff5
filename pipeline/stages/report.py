"""The report stage: stage outputs in, one page with its figures and numbers out."""

from __future__ import annotations

import os
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path

from turtlebag.datasets.errors import InputError
from turtlebag.datasets.other_systems import SystemFiles
from turtlebag.datasets.outputs import Output
from turtlebag.pipeline.stages.other_systems import for_manifest, inputs_of, measured_in, systems_of
from turtlebag.pipeline.stages.recipe import packages, recipe
from turtlebag.pipeline.stages.requests.pages import ReportRequest
from turtlebag.pipeline.terminal.messages import drawing
from turtlebag.reports.content import build_chapter
from turtlebag.reports.figures.album import Album
from turtlebag.reports.foxglove_layout import viewer_layouts
from turtlebag.reports.grouping import group_stages
from turtlebag.reports.index import index_lines, shown_outputs, used_columns
from turtlebag.reports.metrics.references import NO_REFERENCES
from turtlebag.reports.page import fill, render
from turtlebag.reports.stages import load_stage
from turtlebag.reports.system_comparison import compare_systems, write_pairs
from turtlebag.reports.tables import write_tables
from turtlebag.reports.verdicts import BAD, GOOD


def report(request: ReportRequest, out: Output) -> int:
    """Write the page of outputs, or the table of all below their folders; 0."""
    if request.index:
        make_index(request.folders, out)
    else:
        others = systems_of(request, request.system)
        make_report(request.folders, out, others=others, animate=request.animate, paper=request.paper)
    return 0


def make_report(
    folders: Sequence[Path],
    out: Output,
    *,
    others: Sequence[SystemFiles] = (),
    animate: bool = True,
    paper: bool = False,
) -> Path:
    """Write `index.html`, `figures/`, `tables/`, `metrics.json`, the manifest; returns the page's path.

    Layouts for Foxglove or Lichtblick, in which the bags can be scrubbed through, lie beside them.

    `folders` are finished outputs of record, map and navigate in any number and order; those that
    share a world or data files by hash are shown together. `paper` adds each figure as PDF and PNG.
    `others` are shown beside ours. InputError for anything that is not such an output, and for other
    systems on more than one world or log.
    """
    groups = group_stages([load_stage(folder) for folder in folders])
    known, systems = measured_in(groups, others) if others else (NO_REFERENCES, [])
    files = inputs_of(others)
    with out.staged([*folders, *files.values()]) as partial:
        with drawing() as told:
            album = Album(partial / "figures", animate=animate, paper=paper, told=told)
            chapters = [build_chapter(group, album) for group in groups]
            if systems:
                shown = compare_systems(systems, known, album, f"{chapters[0].anchor}-systems")
                chapters = [replace(chapters[0], systems=shown)]
                write_pairs(systems, partial / "systems")
        (partial / "index.html").write_text(render(chapters, recipe(groups), packages(groups)))
        write_tables(chapters, partial / "tables")
        stages = [stage for group in groups for stage in group.stages]
        for name, layout in viewer_layouts(stages).items():
            (partial / name).write_text(layout)
        numbers = {chapter.name: chapter.metrics for chapter in chapters}
        inputs = {f"{group.name}/{stage.label}": stage.folder for group in groups for stage in group.stages}
        # A report moved together with its inputs still finds them.
        places = {name: os.path.relpath(folder, out.folder) for name, folder in inputs.items()}
        extra = {"folders": places, "systems": for_manifest(others, out.folder)}
        out.finish(partial, "report", inputs | files, metrics=numbers, extra=extra)
    return out.folder / "index.html"


def make_index(roots: Sequence[Path], out: Output) -> Path:
    """Write a page with a sortable table of every output below `roots`; returns its path."""
    outputs = shown_outputs(roots)
    if not outputs:
        places = ", ".join(str(root) for root in roots)
        raise InputError(f"{places}: no finished outputs in it; give the folder that holds them")
    lines = index_lines(outputs)
    moods = [line.mood for line in lines]
    told = {"columns": used_columns(lines), "good": moods.count(GOOD), "bad": moods.count(BAD)}
    with out.staged(outputs) as partial:
        (partial / "index.html").write_text(fill("index.html.j2", lines=lines, **told))
        out.finish(partial, "index", {})
    return out.folder / "index.html"
