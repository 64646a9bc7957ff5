"""The board: the shipped campaign of standard drives, and one page of its rows."""

from __future__ import annotations

import json
import os
import shlex
import sys
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from statistics import median
from typing import Any

from turtlebag.datasets.outputs import Output
from turtlebag.datasets.plurals import counted
from turtlebag.pipeline.board.inputs import (
    BAG,
    CAMPAIGN,
    RECORD,
    SYSTEM,
    Drive,
    absent_logs,
    drives,
    input_name,
)
from turtlebag.pipeline.campaign.campaign_file import Campaign
from turtlebag.pipeline.campaign.case import Row, Where, kept_at
from turtlebag.pipeline.campaign.cases import Case, with_places
from turtlebag.pipeline.campaign.figures import draw_figures, words
from turtlebag.pipeline.campaign.sweep import sweep
from turtlebag.pipeline.stages.requests.program import ProgramRequest
from turtlebag.reports.figures.album import Album
from turtlebag.reports.page import fill

PAGE = "board.html"
MAP = "map"
"""The campaign's stage that makes a row."""
TRAJECTORY = "map/trajectory.tum"
QUICK: dict[str, Sequence[str | int]] = {"world": ["arena"], "seed": [1]}


@dataclass(frozen=True)
class Run:
    """One case on the page: the commands that make it, and the hash of the trajectory that they make."""

    input: str
    system: str
    commands: tuple[str, ...]
    sha256: str
    row: Row


@dataclass(frozen=True)
class Line:
    """A system on the drives of one kind: for each result the median and the worst over the seeds that did
    not fail, None where all did."""

    kind: str
    system: str
    runs: int
    failed: int
    numbers: dict[str, tuple[float | None, float | None]]


def board(out: Output, *, quick: bool = False, workers: int | None = None) -> int:
    """Run what is left of the board and write its table and page to `out`; 1 when any case failed.

    `quick`: the first drive only. Each row is made by a process of its own, by the `turtlebag` that lies
    beside this Python.
    """
    beside = str(Path(sys.executable).parent)
    os.environ["PATH"] = f"{beside}{os.pathsep}{os.environ.get('PATH', os.defpath)}"
    only = QUICK if quick else {}
    return sweep(CAMPAIGN, out, workers=workers, allow_commands=True, only=only, more=_write_page)


def _write_page(
    campaign: Campaign, todo: Sequence[Case], rows: Sequence[Row], where: Where, folder: Path
) -> None:
    inputs = drives(campaign, todo)
    made = {input_name(campaign, case): _hash(case, campaign, where, RECORD, BAG) for case in todo}
    runs = [_run(case, row, campaign, inputs, where) for case, row in zip(todo, rows, strict=True)]
    album = Album(folder / "figures")
    draw_figures(campaign, rows, album)
    page = fill(
        "board.html.j2",
        campaign=campaign,
        sizes=f"{counted(len(inputs), 'drive')}, {counted(len(runs), 'row')}",
        lines=lines_of(campaign, rows),
        runs=runs,
        inputs=list(inputs.values()),
        made=made,
        logs=absent_logs(),
        pictures=album.pictures,
        words=words,
    )
    (folder / PAGE).write_text(page)


def lines_of(campaign: Campaign, rows: Sequence[Row]) -> list[Line]:
    """The rows of each system on each kind of drive, over the seeds."""
    kinds = [factor for factor in campaign.factor_names if factor not in ("seed", SYSTEM)]
    groups: dict[tuple[str, str], list[Row]] = {}
    for row in rows:
        kind = ", ".join(words(row[factor]) for factor in kinds)
        groups.setdefault((kind, str(row[SYSTEM])), []).append(row)
    return [
        Line(kind, system, len(found), sum(bool(row["failed"]) for row in found), _numbers(campaign, found))
        for (kind, system), found in groups.items()
    ]


def _numbers(campaign: Campaign, rows: Sequence[Row]) -> dict[str, tuple[float | None, float | None]]:
    """All results are the better the smaller."""
    found: dict[str, tuple[float | None, float | None]] = {}
    for name in campaign.results:
        values = [row[name] for row in rows if isinstance(row[name], (int, float))]
        found[name] = (median(values), max(values)) if values else (None, None)
    return found


def _run(case: Case, row: Row, campaign: Campaign, inputs: Mapping[str, Drive], where: Where) -> Run:
    name, system = input_name(campaign, case), str(case.factors[SYSTEM])
    request = case.requests[MAP]
    assert isinstance(request, ProgramRequest)
    places = {RECORD: name, "out": f"{name}-{system}"}
    command = shlex.join(with_places(word, places) for word in request.command)
    folder = f"{name}-{system}"
    record = f"{inputs[name].command} --out {name}"
    commands = (record, f"mkdir {folder}", command, f"sha256sum {folder}/{TRAJECTORY}")
    return Run(name, system, commands, _hash(case, campaign, where, MAP, TRAJECTORY), row)


def _hash(case: Case, campaign: Campaign, where: Where, stage: str, file: str) -> str:
    """The hash of a file that a stage made, by the manifest that is kept of it; empty where it failed."""
    content = where.runs.read(f"{kept_at(case, campaign, where.maker, stage)}/manifest.json")
    outputs: dict[str, Any] = {} if content is None else json.loads(content)["outputs"]
    return str(outputs.get(file, ""))
