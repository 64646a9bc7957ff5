"""The board: the shipped campaigns of standard inputs, and one page of their rows."""

from __future__ import annotations

import csv
import json
import os
import shlex
import shutil
import sys
from collections.abc import Sequence
from dataclasses import dataclass, replace
from fnmatch import fnmatchcase
from pathlib import Path
from statistics import median
from typing import Any

from turtlebag.datasets.errors import InputError
from turtlebag.datasets.output_lock import lock_output
from turtlebag.datasets.outputs import Output
from turtlebag.datasets.plurals import counted
from turtlebag.pipeline.board.inputs import BAG, CHAPTERS, INPUT, SYSTEM, Drive, drives, input_name
from turtlebag.pipeline.campaign.campaign_file import Campaign
from turtlebag.pipeline.campaign.case import Row, Where, kept_at
from turtlebag.pipeline.campaign.cases import OUT, Case, with_places
from turtlebag.pipeline.campaign.figures import draw_figures, words
from turtlebag.pipeline.campaign.store import Store
from turtlebag.pipeline.campaign.sweep import OUTPUTS, Hands, Plan, finished, maker_of, planned, tidy
from turtlebag.pipeline.stages.requests.program import ProgramRequest
from turtlebag.pipeline.terminal.messages import log
from turtlebag.reports.figures.album import Album, Picture
from turtlebag.reports.metric_specs import tolerance_of
from turtlebag.reports.numbers import DASH, shown
from turtlebag.reports.page import fill

PAGE, TABLE, MADE = "board.html", "rows.csv", "inputs.yaml"
FILES = {"localise": "trajectory.tum", "navigate": "trajectory.tum", "plan": "path.csv"}
"""The file of a row that is hashed, by the stage that makes it; a program names its own."""


@dataclass(frozen=True)
class Run:
    """One case on the page: the commands that make it, the hash of the file that they make, and what its
    first number is, with the tolerance of another machine."""

    input: str
    system: str
    commands: tuple[str, ...]
    sha256: str
    row: Row
    number: str


@dataclass(frozen=True)
class Line:
    """A system on the inputs of one kind: for each result what sorts it and its text, over the seeds that did
    not fail."""

    kind: str
    system: str
    runs: int
    failed: int
    numbers: dict[str, tuple[float | None, str]]


@dataclass(frozen=True, eq=False)
class Chapter:
    """One campaign on the page. `left_out` are inputs and systems that are no rows, with the reason; `made`
    are the hashes of the drives here."""

    name: str
    campaign: Campaign
    lines: Sequence[Line]
    runs: Sequence[Run]
    left_out: Sequence[tuple[str, str, str]]
    drives: Sequence[Drive]
    made: dict[str, str]
    pictures: Sequence[Picture]

    @property
    def failed(self) -> list[Run]:
        """The rows that failed."""
        return [run for run in self.runs if run.row["failed"]]


def board(out: Output, *, inputs: str = "*", workers: int | None = None) -> int:
    """Run what is left of the board and write its tables and page to `out`; 1 when any row failed.

    `inputs`: a pattern of the names of inputs, of which alone rows are made; InputError where it fits none.
    Each map is made by a process of its own, by the `turtlebag` that lies beside this Python.
    """
    beside = str(Path(sys.executable).parent)
    os.environ["PATH"] = f"{beside}{os.pathsep}{os.environ.get('PATH', os.defpath)}"
    asked = {name: planned(campaign, allow_commands=True) for name, campaign in CHAPTERS.items()}
    plans = {name: _fitting(name, plan, inputs) for name, plan in asked.items()}
    if not any(plan.cases for plan in plans.values()):
        raise InputError(f"--inputs {inputs}: fits no input; for example house-clean-1, barn-25-realistic-1")
    with lock_output(out.folder, force=out.force) as lock:
        lock.spare()
        files = {f"{name}.yaml": plan.inputs["campaign"] for name, plan in plans.items() if plan.cases}
        lock.watch(files.values())
        chapters = [
            _chapter(name, plan, lock.partial, Hands(workers=workers), force=out.force)
            for name, plan in plans.items()
            if plan.cases
        ]
        made = {name: digest for chapter in chapters for name, digest in chapter.made.items()}
        (lock.partial / MADE).write_text("".join(f"{name}: {digest}\n" for name, digest in made.items()))
        runs = [run for chapter in chapters for run in chapter.runs]
        sizes = f"{counted(len({run.input for run in runs}), 'input')}, {counted(len(runs), 'row')}"
        failed = sum(len(chapter.failed) for chapter in chapters)
        page = fill("board.html.j2", sizes=sizes, failed=failed, chapters=chapters, words=words)
        (lock.partial / PAGE).write_text(page)
        for place in (lock.partial, *(lock.partial / chapter.name for chapter in chapters)):
            tidy(place)
        out.finish(lock.partial, "board", files, extra={"selection": inputs})
        lock.finish()
    log.info(f"{out.folder}: {sizes}, {failed} failed")
    return int(failed > 0)


def _fitting(chapter: str, plan: Plan, inputs: str) -> Plan:
    """The cases whose inputs fit a pattern."""
    fitting = [case for case in plan.cases if fnmatchcase(input_name(chapter, plan.campaign, case), inputs)]
    return replace(plan, cases=fitting)


def _chapter(name: str, plan: Plan, folder: Path, hands: Hands, *, force: bool) -> Chapter:
    """Run what is left of a chapter. Outputs of shared stages are kept for all chapters."""
    runs = Store(str((folder / name).absolute()))
    where = Where(runs, Store(str(folder.absolute())).below(OUTPUTS), maker_of(plan.inputs))
    campaign, missing = plan.campaign, {case.name: _missing(case) for case in plan.cases}
    here = replace(plan, cases=[case for case in plan.cases if not missing[case.name]])
    rows = finished(here, where, folder / name, hands, force=force).rows if here.cases else ()
    if rows:
        with (folder / name / TABLE).open("w", newline="") as file:
            table = csv.DictWriter(file, list(rows[0]))
            table.writeheader()
            table.writerows(rows)
    done = dict(zip((case.name for case in here.cases), rows, strict=True))
    left_out = {
        case.name: missing[case.name] or reason
        for case in plan.cases
        if (reason := _no_input(done.get(case.name))) or missing[case.name]
    }
    there = [case for case in here.cases if case.name not in left_out]
    made = {input_name(name, campaign, case): _hash(case, campaign, where, INPUT, BAG) for case in there}
    album = Album(folder / "figures", prefix=f"{name}-")
    rows = [done[case.name] for case in there]
    if rows:
        draw_figures(campaign, rows, album)
    return Chapter(
        name,
        campaign,
        lines_of(campaign, rows),
        [_run(name, case, done[case.name], campaign, where) for case in there],
        [
            (input_name(name, campaign, case), str(case.factors[SYSTEM]), left_out[case.name])
            for case in plan.cases
            if case.name in left_out
        ],
        list(drives(name, campaign, there).values()),
        {name: digest for name, digest in made.items() if digest},
        album.pictures,
    )


def _missing(case: Case) -> str:
    """Why a case cannot be run here: a program that is not there; empty where it can."""
    programs = [one.command[0] for one in case.requests.values() if isinstance(one, ProgramRequest)]
    return next((f"{one} is not installed" for one in programs if shutil.which(one) is None), "")


def _no_input(row: Row | None) -> str:
    """Why a case had no input; empty where it had, or was not run."""
    error = "" if row is None else str(row["error"])
    return error.removeprefix(f"{INPUT}: ") if error.startswith(f"{INPUT}: ") else ""


def lines_of(campaign: Campaign, rows: Sequence[Row]) -> list[Line]:
    """The rows of each system on each kind of input, over the seeds."""
    kinds = [factor for factor in campaign.factor_names if factor not in ("seed", SYSTEM)]
    groups: dict[tuple[str, str], list[Row]] = {}
    for row in rows:
        kind = ", ".join(words(row[factor]) for factor in kinds)
        groups.setdefault((kind, str(row[SYSTEM])), []).append(row)
    return [
        Line(kind, system, len(found), sum(bool(row["failed"]) for row in found), _numbers(campaign, found))
        for (kind, system), found in groups.items()
    ]


def _numbers(campaign: Campaign, rows: Sequence[Row]) -> dict[str, tuple[float | None, str]]:
    return {
        name: _over_seeds([row[name] for row in rows if row[name] is not None], unit)
        for name, (_, unit) in campaign.names.items()
    }


def _over_seeds(values: Sequence[Any], unit: str) -> tuple[float | None, str]:
    """The only value; of several the median, the least and the largest, of yes and no how many say yes."""
    if not values:
        return None, DASH
    if len(values) == 1:
        return float(values[0]), shown(values[0], unit)
    if isinstance(values[0], bool):
        return sum(values) / len(values), f"{sum(values)} of {len(values)}"
    middle, least, largest = median(values), min(values), max(values)
    spread = "" if least == largest else f" ({shown(least, unit)} to {shown(largest, unit)})"
    return middle, f"{shown(middle, unit)}{spread}"


def _run(chapter: str, case: Case, row: Row, campaign: Campaign, where: Where) -> Run:
    name, system = input_name(chapter, campaign, case), str(case.factors[SYSTEM])
    places: dict[str, str] = {}
    commands = []
    for stage, request in case.requests.items():
        shared = name if stage == INPUT else f"{name}-{stage}"
        folder = places[stage] = shared if stage in campaign.shared else f"{name}-{system}-{stage}"
        if isinstance(request, ProgramRequest):
            known = {**places, OUT: folder}
            command = shlex.join(with_places(word, known) for word in request.command)
            commands += [f"mkdir {folder}", command]
        else:
            told = [with_places(word, places) for word in case.commands[stage]]
            commands.append(shlex.join(["turtlebag", *told, "--out", folder]))
    last, request = next(reversed(case.requests.items()))
    program = isinstance(request, ProgramRequest)
    file = (request.trajectory or "") if isinstance(request, ProgramRequest) else FILES[request.VERB]
    commands.append(f"sha256sum {places[last]}/{file}")
    digest = _hash(case, campaign, where, last, file)
    number = _first_number(campaign, row, "map" if program else request.VERB)
    return Run(name, system, tuple(commands), digest, row, number)


def _first_number(campaign: Campaign, row: Row, kind: str) -> str:
    """The first number of a row, and by how much it may be another on another machine."""
    for name, result in campaign.results.items():
        if isinstance(row[name], float):
            label, unit = campaign.names[name]
            tolerance = tolerance_of(kind, result.at.partition(":")[2], row[name])
            return f"{label} {shown(row[name], unit)}, elsewhere within {shown(tolerance, unit)} of it"
    return "failed"


def _hash(case: Case, campaign: Campaign, where: Where, stage: str, file: str) -> str:
    """The hash of a file that a stage made, by the manifest that is kept of it; empty where it failed."""
    if stage not in case.commands:
        return ""
    content = where.runs.read(f"{kept_at(case, campaign, where.maker, stage)}/manifest.json")
    outputs: dict[str, Any] = {} if content is None else json.loads(content)["outputs"]
    return str(outputs.get(file, ""))
