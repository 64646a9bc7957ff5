"""One case of a campaign: its stages run one after the other, its numbers kept, the rest thrown away."""

from __future__ import annotations

import contextlib
import hashlib
import io
import json
import shutil
import time
from collections.abc import Callable, Collection, Mapping, Sequence
from pathlib import Path
from typing import Any

from turtlebag.datasets.outputs import write_json
from turtlebag.pipeline.campaign.campaign_file import Campaign, Case
from turtlebag.reports.numbers import lookup
from turtlebag.reports.stages import read_json

Run = Callable[[list[str]], int]
"""Runs a command line, without its `turtlebag`, and gives the exit code."""
Row = dict[str, Any]
"""A line of the table, by column."""
ROW = "row.json"
SHARED = "shared"
"""Beside the cases: outputs that several use."""


def run_case(case: Case, campaign: Campaign, place: Path, run: Run) -> Row:
    """Run a case in `place`, its own folder, and return its row; a stage that breaks makes a `failed` row.

    What was finished before is not run again; a shared stage whose command another case gives too is run
    once for both, beside the cases. The row is written last: where it is, the case is done.
    """
    row_path = place / ROW
    if row_path.is_file():
        return read_json(row_path)
    place.mkdir(parents=True, exist_ok=True)
    started = time.perf_counter()
    error = ""
    folders = stage_folders(case.commands, place, campaign.shared)
    for stage, words in case.commands.items():
        error = _run_stage(stage, [word.format(**folders) for word in words], folders[stage], place, run)
        if error:
            break
    row = row_of(case, campaign, error)
    if not error:
        row |= {name: _value(folders, result.at) for name, result in campaign.results.items()}
    throw_away(place, campaign.keep)
    timing = {"wall_s": round(time.perf_counter() - started, 3)}
    (place / "timing.json").write_text(json.dumps(timing))
    unfinished = place / (ROW + ".partial")
    write_json(unfinished, row)
    unfinished.rename(row_path)
    return row


def row_of(case: Case, campaign: Campaign, error: str) -> Row:
    """The row of a case before its results are known; `error` says why it failed, if it did."""
    nothing = dict.fromkeys(campaign.results)
    return {"case": case.name, **case.factors, "failed": bool(error), "error": error, **nothing}


def stage_folders(
    commands: Mapping[str, Sequence[str]], place: Path, shared: Collection[str]
) -> dict[str, Path]:
    """Where each stage's output lies: in the case's folder, or beside the cases, named by what makes it."""
    folders: dict[str, Path] = {}
    recipes: dict[str, str] = {}
    for stage, words in commands.items():
        # With the recipes of earlier stages in their braces: the same recipe is the same output.
        recipes[stage] = json.dumps([word.format(**recipes) for word in words])
        name = hashlib.sha256(recipes[stage].encode()).hexdigest()[:12]
        folders[stage] = place.parents[1] / SHARED / name if stage in shared else place / stage
    return folders


def _run_stage(stage: str, words: Sequence[str], out: Path, place: Path, run: Run) -> str:
    """Run one command into its folder; the reason in one line when it did not finish its outputs."""
    if (out / "manifest.json").is_file():
        return ""
    mine = out if out.parent == place else place / stage
    shutil.rmtree(mine, ignore_errors=True)  # what a killed worker had half thrown away
    told, said = io.StringIO(), io.StringIO()
    try:
        with contextlib.redirect_stderr(told), contextlib.redirect_stdout(said):
            code = run([*words, "--quiet", "--out", str(mine), "--force"])
    except (Exception, SystemExit) as error:
        # A defect in one case must not end a campaign of a thousand: it becomes that case's result.
        return f"{stage}: {type(error).__name__}: {error}".replace("\n", " ")
    if not (mine / "manifest.json").is_file():
        last = told.getvalue().strip().splitlines()[-1:] or [f"exit code {code}"]
        return f"{stage}: {last[0]}".replace(str(place), "CASE")
    if mine != out:
        out.parent.mkdir(exist_ok=True)
        with contextlib.suppress(OSError):  # another case was quicker: its output is the same
            mine.rename(out)
        shutil.rmtree(mine, ignore_errors=True)
    return ""


def _value(folders: Mapping[str, Path], where: str) -> Any:
    """The number at `stage:dotted.path` of a stage's metrics.json; None when it is not there."""
    stage, _, path = where.partition(":")
    file = folders[stage] / "metrics.json"
    value = lookup(read_json(file), path) if file.is_file() else None
    return value if isinstance(value, (bool, int, float, str)) else None


def throw_away(place: Path, keep: Sequence[str]) -> None:
    """Delete everything in the stage folders below `place` but the files to keep."""
    if "*" in keep:
        return
    for path in sorted(place.rglob("*"), reverse=True):
        if path.is_file() and path.name not in keep:
            path.unlink()
        elif path.is_dir() and not any(path.iterdir()):
            shutil.rmtree(path)
