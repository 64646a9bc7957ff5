"""The report stage: stage outputs in, one page with its figures and numbers out."""

from __future__ import annotations

import os
from collections.abc import Sequence
from pathlib import Path

from turtlebag.datasets.errors import InputError
from turtlebag.datasets.outputs import Stopwatch, staged_output, write_json, write_manifest
from turtlebag.pipeline.terminal.messages import drawing
from turtlebag.reports.content import build_chapter
from turtlebag.reports.figures.album import Album
from turtlebag.reports.grouping import group_stages
from turtlebag.reports.index import index_lines, shown_outputs
from turtlebag.reports.layout import viewer_layouts
from turtlebag.reports.page import render, render_index
from turtlebag.reports.stages import load_stage
from turtlebag.reports.tables import write_tables


def make_report(
    folders: Sequence[Path],
    out: Path,
    *,
    force: bool = False,
    animate: bool = True,
    paper: bool = False,
    command: Sequence[str] = ("turtlebag", "report"),
) -> Path:
    """Write `index.html`, `figures/`, `tables/`, `metrics.json`, the manifest; returns the page's path.

    Layouts for Foxglove or Lichtblick, in which the bags can be scrubbed through, lie beside them.

    `folders` are finished outputs of record, map and navigate in any number and order; those that
    share a world or data files by hash are shown together. `paper` adds each figure as PDF and SVG.
    InputError for anything that is not such an output.
    """
    watch = Stopwatch()
    groups = group_stages([load_stage(folder) for folder in folders])
    with staged_output(out, force=force, inputs=folders) as partial:
        with drawing() as told:
            album = Album(partial / "figures", animate=animate, paper=paper, told=told)
            chapters = [build_chapter(group, album) for group in groups]
        (partial / "index.html").write_text(render(chapters, groups))
        write_tables(chapters, partial / "tables")
        stages = [stage for group in groups for stage in group.stages]
        for name, layout in viewer_layouts(stages).items():
            (partial / name).write_text(layout)
        numbers = {
            chapter.name: {part.stage.label: part.metrics for part in chapter.parts} for chapter in chapters
        }
        write_json(partial / "metrics.json", numbers)
        inputs = {f"{group.name}/{stage.label}": stage.folder for group in groups for stage in group.stages}
        # A report moved together with its inputs still finds them.
        places = {name: os.path.relpath(folder, out) for name, folder in inputs.items()}
        write_manifest(partial, "report", command, inputs, wall_s=watch.seconds(), extra={"folders": places})
    return out / "index.html"


def make_index(
    roots: Sequence[Path], out: Path, *, force: bool = False, command: Sequence[str] = ("turtlebag", "report")
) -> Path:
    """Write a page with a sortable table of every output below `roots`; returns its path."""
    watch = Stopwatch()
    lines = index_lines(roots)
    if not lines:
        places = ", ".join(str(root) for root in roots)
        raise InputError(f"{places}: no finished outputs in it; give the folder that holds them")
    with staged_output(out, force=force, inputs=shown_outputs(roots)) as partial:
        (partial / "index.html").write_text(render_index(lines))
        write_manifest(partial, "index", command, {}, wall_s=watch.seconds())
    return out / "index.html"
