"""The report stage: stage outputs in, one page with its figures and numbers out."""

from __future__ import annotations

import os
from collections.abc import Sequence
from pathlib import Path

from datasets.outputs import Stopwatch, staged_output, write_json, write_manifest
from pipeline.console import track
from reports.content import build_chapter
from reports.figures.album import Album
from reports.page import render
from reports.stages import group_stages, load_stage


def make_report(
    folders: Sequence[Path],
    out: Path,
    *,
    force: bool = False,
    animate: bool = True,
    command: Sequence[str] = ("turtlebag", "report"),
) -> Path:
    """Write `index.html`, `figures/*`, `metrics.json` and the manifest; returns the page's path.

    `folders` are finished outputs of record, map and navigate in any number and order; those that
    share a world or data files by hash are shown together. InputError for anything else.
    """
    watch = Stopwatch()
    groups = group_stages([load_stage(folder) for folder in folders])
    with staged_output(out, force=force) as partial:
        album = Album(partial / "figures", animate=animate)
        chapters = [build_chapter(group, album) for group in track(groups, "draw")]
        (partial / "index.html").write_text(render(chapters, groups))
        numbers = {
            chapter.name: {part.stage.label: part.metrics for part in chapter.parts} for chapter in chapters
        }
        write_json(partial / "metrics.json", numbers)
        inputs = {f"{group.name}/{stage.label}": stage.folder for group in groups for stage in group.stages}
        write_manifest(
            partial,
            stage="report",
            command=command,
            inputs=inputs,
            seed=None,
            wall_s=watch.seconds(),
            # A report moved together with its inputs still finds them.
            extra={"folders": {name: os.path.relpath(folder, out) for name, folder in inputs.items()}},
        )
    return out / "index.html"
