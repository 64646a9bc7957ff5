"""One case of a campaign: its stages run one after the other, its numbers kept, the rest thrown away."""

from __future__ import annotations

import contextlib
import io
import json
import shutil
import time
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

from datasets.outputs import write_json
from reports.stages import read_json

ROW = "row.json"


def run_case(
    case: Mapping[str, Any], results: Mapping[str, str], folder: str, keep: Sequence[str]
) -> dict[str, Any]:
    """Run a case in `folder` (its own) and return its row; a stage that breaks makes a `failed` row.

    What was finished before is not run again. The row is written last: where it is, the case is done.
    """
    place = Path(folder)
    row_path = place / ROW
    if row_path.is_file():
        return dict(read_json(row_path))
    place.mkdir(parents=True, exist_ok=True)
    started = time.perf_counter()
    error = ""
    for stage, words in case["commands"].items():
        error = _run_stage(stage, [word.format(**_folders(case, place)) for word in words], place)
        if error:
            break
    row: dict[str, Any] = {"case": case["name"], **case["factors"], "failed": bool(error), "error": error}
    row |= {name: None if error else _value(place, where) for name, where in results.items()}
    _throw_away(place, keep)
    timing = {"wall_s": round(time.perf_counter() - started, 3)}
    (place / "timing.json").write_text(json.dumps(timing))
    unfinished = place / (ROW + ".partial")
    write_json(unfinished, row)
    unfinished.rename(row_path)
    return row


def _folders(case: Mapping[str, Any], place: Path) -> dict[str, str]:
    return {stage: str(place / stage) for stage in case["commands"]}


def _run_stage(stage: str, words: Sequence[str], place: Path) -> str:
    """Run one command into its folder; the reason in one line when it did not finish its outputs."""
    from pipeline.cli import main

    out = place / stage
    if (out / "manifest.json").is_file():
        return ""
    told, said = io.StringIO(), io.StringIO()
    try:
        with contextlib.redirect_stderr(told), contextlib.redirect_stdout(said):
            code = main([*words, "--quiet", "--out", str(out), "--force"])
    except (Exception, SystemExit) as error:
        # A defect in one case must not end a campaign of a thousand: it becomes that case's result.
        return f"{stage}: {type(error).__name__}: {error}".replace("\n", " ")
    if (out / "manifest.json").is_file():
        return ""
    last = told.getvalue().strip().splitlines()[-1:] or [f"exit code {code}"]
    return f"{stage}: {last[0]}".replace(str(place), "CASE")


def _value(place: Path, where: str) -> Any:
    """The number at `stage:dotted.path` of a stage's metrics.json; None when it is not there."""
    stage, _, path = where.partition(":")
    node: Any = (
        read_json(place / stage / "metrics.json") if (place / stage / "metrics.json").is_file() else {}
    )
    for part in path.split("."):
        node = node.get(part) if isinstance(node, dict) else None
    return node if isinstance(node, (bool, int, float, str)) else None


def _throw_away(place: Path, keep: Sequence[str]) -> None:
    """Delete everything in the stage folders but the files to keep."""
    if "*" in keep:
        return
    for path in sorted(place.rglob("*"), reverse=True):
        if path.is_file() and path.name not in keep:
            path.unlink()
        elif path.is_dir() and not any(path.iterdir()):
            shutil.rmtree(path)
