"""Compare two outputs of one stage, as a table and as a page."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

from turtlebag.datasets.outputs import Stopwatch, staged_output, write_json, write_manifest
from turtlebag.reports.compare import Comparison, compare, draw_comparison
from turtlebag.reports.figures.album import Album
from turtlebag.reports.page import render_comparison
from turtlebag.reports.stages import Stage, load_stage


def compare_outputs(a: Path, b: Path) -> Comparison:
    """Numbers, settings and files of two outputs of one stage."""
    return compare(load_stage(a), load_stage(b))


def write_comparison(
    a: Path, b: Path, out: Path, *, force: bool = False, command: Sequence[str] = ()
) -> Comparison:
    """Also write `index.html`, `figures/*.png`, `metrics.json` and the manifest into `out`."""
    watch = Stopwatch()
    stages = load_stage(a), load_stage(b)
    found = compare(*stages)
    names = _names(*stages)
    with staged_output(out, force=force) as folder:
        album = Album(folder / "figures")
        draw_comparison(*stages, album)
        (folder / "index.html").write_text(render_comparison(*names, found, album.pictures))
        write_json(folder / "metrics.json", {row.path: row.values for row in found.rows})
        write_manifest(folder, "compare", command, {"A": a, "B": b}, wall_s=watch.seconds())
    return found


def _names(a: Stage, b: Stage) -> tuple[str, str]:
    """Folder names, told apart by A and B."""
    return f"A: {a.folder.resolve().name}", f"B: {b.folder.resolve().name}"
