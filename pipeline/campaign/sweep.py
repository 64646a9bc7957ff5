"""The sweep stage: a campaign file in, a table of all its cases with figures and intervals out."""

from __future__ import annotations

import json
import os
import platform
import sys
from collections import Counter
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from functools import cache
from operator import itemgetter
from pathlib import Path

from llvmlite.binding import get_host_cpu_name

from turtlebag.datasets.errors import InputError
from turtlebag.datasets.output_lock import lock_output
from turtlebag.datasets.outputs import Output, Stopwatch, package_versions, sha256_text, sha256_tree
from turtlebag.datasets.plurals import counted
from turtlebag.datasets.yaml_files import config_text
from turtlebag.pipeline.campaign.campaign_file import Campaign, campaign_path, load_campaign
from turtlebag.pipeline.campaign.case import CASES, ROWS, SHARED, STREAMS, Done, Row, Run, Where, recipes
from turtlebag.pipeline.campaign.cases import Case, Reader, cases
from turtlebag.pipeline.campaign.engine import THREADS, require_scheduler, run_cases
from turtlebag.pipeline.campaign.results import absent_results, write_results
from turtlebag.pipeline.campaign.store import UNFINISHED, Store, or_else
from turtlebag.pipeline.campaign.worst import worst_case
from turtlebag.pipeline.stages.command_line import read
from turtlebag.pipeline.stages.requests.program import ProgramRequest
from turtlebag.pipeline.stages.run import run
from turtlebag.pipeline.terminal.messages import log, track

TELL_S = 60.0
MARK = "made_by.txt"
"""In a campaign's store: the maker of its rows, as `Where` has it."""
OUTPUTS = "outputs"
"""Part of a store that keeps what `shared` stages made, for all campaigns of it."""
SCRATCH = "scratch"
"""Folder in which the workers of this machine work."""
ROOT = Path(__file__).parents[2]
MAKERS = ("datasets", "sim", "planners", "pipeline", "reports/metrics")


@dataclass(frozen=True, eq=False)
class Plan:
    """A campaign by the name it was asked for, its cases, and the files that they read."""

    name: str
    campaign: Campaign
    cases: Sequence[Case]
    inputs: Mapping[str, Path]


@dataclass(frozen=True)
class Hands:
    """What runs the cases: each stage by `run`, on a Dask scheduler or on processes of this machine."""

    run: Run = run
    scheduler: str | None = None
    workers: int | None = None


@dataclass(frozen=True, eq=False)
class Swept:
    """The rows of a campaign, how long each took [s], and a line for each result that none of them has."""

    rows: Sequence[Row]
    timing: Mapping[str, float]
    absent: Sequence[str]

    @property
    def failed(self) -> int:
        """How many cases failed."""
        return sum(bool(row["failed"]) for row in self.rows)


def sweep(
    campaign_name: str,
    out: Output,
    *,
    run: Run = run,
    read: Reader = read,
    store: str | None = None,
    scheduler: str | None = None,
    workers: int | None = None,
    allow_commands: bool = False,
) -> int:
    """Run what is left of a campaign, each stage by `run`, and write its results to `out`; 1 when any case
    failed, or a result is in none of them.

    `allow_commands`: also stages that run somebody else's program.
    Of the command lines in the file `read` makes the requests, of all before any case runs. Workers keep what
    they make in `store`, which is `out` itself where no URL is given. It grows in `OUT.partial` and stays
    there when it is stopped: the same command goes on with it.
    """
    plan = planned(campaign_name, read, allow_commands=allow_commands)
    require_scheduler(scheduler)
    with lock_output(out.folder, force=out.force) as lock:
        lock.spare()
        lock.watch(plan.inputs.values())
        where = _where(plan, store, lock.partial, scheduler)
        found = finished(plan, where, lock.partial, Hands(run, scheduler, workers), force=out.force)
        tidy(lock.partial)
        extra = {"case_wall_s": found.timing, **({} if store is None else {"store": where.runs.url})}
        text, seed = config_text(plan.campaign), plan.campaign.seed
        out.finish(lock.partial, "sweep", plan.inputs, config=text, seed=seed, extra=extra)
        lock.finish()
    log.info(f"{out.folder}: {counted(len(found.rows), 'case')}, {found.failed} failed")
    for line in found.absent:
        log.error(f"{campaign_name}: {line}")
    return int(found.failed > 0 or bool(found.absent))


def planned(campaign_name: str, read: Reader = read, *, allow_commands: bool = False) -> Plan:
    """A campaign and its cases; InputError for one that cannot be run, or whose programs are not allowed."""
    campaign = load_campaign(campaign_name)
    for stage, command in campaign.programs.items():
        if not allow_commands:
            raise InputError(f"{campaign_name}: stages.{stage} runs `{command}`; --allow-commands allows it")
    try:
        todo = cases(campaign, read)
    except InputError as error:
        raise InputError(f"{campaign_name}: {error}") from None
    return Plan(campaign_name, campaign, todo, _inputs(campaign_name, todo))


def finished(plan: Plan, where: Where, folder: Path, hands: Hands, *, force: bool) -> Swept:
    """Run what is left of a campaign, and write its table, figures and page into `folder`."""
    campaign, todo = plan.campaign, plan.cases
    _begin(where, campaign, force=force)

    def start(left: Sequence[Case]) -> Iterator[Done]:
        at, workers = hands.scheduler, hands.workers
        return run_cases(campaign, left, where, hands.run, folder / SCRATCH, scheduler=at, workers=workers)

    rows, timing = _run(campaign, todo, where, start)
    worst = worst_case(campaign, todo, rows, where)
    write_results(campaign, Path(plan.name).name, rows, where.runs, folder, worst)
    return Swept(rows, timing, absent_results(campaign, todo, rows, where))


def tidy(folder: Path) -> None:
    """What only a campaign that still runs needs goes."""
    place = Store(str(folder))
    place.delete(MARK)
    for part in (ROWS, OUTPUTS, SCRATCH, UNFINISHED):
        place.delete_below(part)


def _inputs(campaign_name: str, todo: Sequence[Case]) -> dict[str, Path]:
    """The campaign file, every file and folder of outputs that a stage's command names, and what programs are
    measured by."""
    words = {word for case in todo for line in case.commands.values() for word in line}
    values = {word.partition("=")[2] if word.startswith("--") else word for word in words}
    named = {word: Path(word.partition("+clutter:")[0].partition(":")[0]) for word in values}
    # A program's word may be a script, longer than any name: for os.path that is no file.
    files = {
        str(path): path
        for path in named.values()
        if os.path.isfile(path) or os.path.isfile(path / "manifest.json")
    }
    programs = [
        request for case in todo for request in case.requests.values() if isinstance(request, ProgramRequest)
    ]
    files |= {str(path): path for request in programs for path in request.files()}
    return {"campaign": campaign_path(campaign_name), **dict(sorted(files.items()))}


def _where(plan: Plan, store: str | None, folder: Path, scheduler: str | None) -> Where:
    maker = maker_of(plan.inputs)
    if store is None:
        runs = Store(str(folder.absolute()))
        return Where(runs, runs.below(OUTPUTS), maker)
    whole = Store(store)
    if "memory" in whole.files.protocol and scheduler is None:
        raise InputError(f"--store {store}: only this process sees it; add --scheduler {THREADS}")
    return Where(whole.below(plan.campaign.name), whole.below(OUTPUTS), maker)


def maker_of(inputs: Mapping[str, Path]) -> str:
    """Fingerprint of all that shapes an output besides its command, of a campaign that reads these files."""
    read = {name: sha256_tree(path) for name, path in inputs.items() if name != "campaign"}
    return sha256_text(repr([surroundings(), read]))


def _begin(where: Where, campaign: Campaign, *, force: bool) -> None:
    """Mark a store with the campaign and the maker of its rows; InputError when it holds others."""
    runs, marks = where.runs, {"config.yaml": config_text(campaign), MARK: where.maker + "\n"}
    with or_else(f"{runs.url}: cannot be written"):
        if maker := _other_maker(runs, marks):
            if not force:
                raise InputError(f"{runs.url}: left by {maker}; remove it or pass --force to start over")
            for part in (ROWS, CASES, SHARED):
                runs.delete_below(part)
        for name, text in marks.items():
            runs.put(name, text.encode())


def _other_maker(runs: Store, marks: Mapping[str, str]) -> str:
    """What made a store's rows when it is not what the marks say; empty when it is, or there are none."""
    kinds = (
        "another campaign",
        "made with other code, packages or input files, or on another machine: it cannot be resumed",
    )
    found = [runs.read(name) for name in marks]
    for content, text, kind in zip(found, marks.values(), kinds, strict=True):
        if any(found) and content != text.encode():
            return kind
    return ""


@cache
def surroundings() -> str:
    """Fingerprint of our sources, the packages and the machine: what shapes rows besides the campaign."""
    files = sorted(
        path
        for folder in MAKERS
        for path in (ROOT / folder).rglob("*")
        if path.suffix in (".py", ".yaml") and path.is_file()
    )
    read = [(path.relative_to(ROOT).as_posix(), path.read_bytes()) for path in files]
    machine = [platform.python_version(), platform.machine(), get_host_cpu_name()]
    return sha256_text(repr([read, package_versions(), machine]))


def _run(
    campaign: Campaign,
    todo: Sequence[Case],
    where: Where,
    start: Callable[[Sequence[Case]], Iterable[Done]],
) -> tuple[list[Row], dict[str, float]]:
    """Rows of all cases in the campaign's order, and how long each took [s]; those that were done before are
    only read, and `start` runs the others."""
    wanted = {case.name for case in todo}
    rows: dict[str, Row] = {}
    timing: dict[str, float] = {}
    names = [name for name in where.runs.names(ROWS) if Path(name).stem in wanted]
    for content in where.runs.read_all(names):
        done = json.loads(content)
        rows[done["row"]["case"]], timing[done["row"]["case"]] = done["row"], done["wall_s"]
    # Draws may repeat a case: it runs once.
    left = list({case.name: case for case in todo if case.name not in rows}.values())
    if rows:
        log.info(f"resuming: {len(rows)} of {len(todo)} cases are done")
    if left:
        found, told = start(_interleaved(left, campaign)), False
        for row, wall_s in track(with_time_left(found, len(left)), campaign.name, total=len(left)):
            rows[row["case"]] = row
            if wall_s is not None:
                timing[row["case"]] = wall_s
            if row["failed"]:
                with STREAMS:
                    log.warning(f"{row['case']}: {row['error']}")
            elif not told:  # at once: at the end may be tomorrow
                told = True
                for line in absent_results(campaign, todo, [row], where):
                    with STREAMS:
                        log.warning(f"{line} (so far)")
    return [rows[case.name] for case in todo], dict(sorted(timing.items()))


def with_time_left(found: Iterable[Done], total: int) -> Iterator[Done]:
    """The cases as they are done; where no progress bar is seen, a line a minute tells how long the rest of
    all `total` takes."""
    watch, told_s = Stopwatch(), 0.0
    for done, item in enumerate(found, start=1):
        yield item
        if not sys.stderr.isatty() and watch.seconds() - told_s > TELL_S:
            told_s = watch.seconds()
            left_s = told_s / done * (total - done)
            log.info(f"{done} of {total} cases, about {left_s / 60.0:.0f} min left")


def _interleaved(left: Sequence[Case], campaign: Campaign) -> list[Case]:
    """The cases in such an order that those which share an output come one after the other's first: workers
    rather make two outputs than wait for one."""
    if not campaign.shared:
        return list(left)
    rank: Counter[str] = Counter()
    ranked = []
    for case in left:
        first = recipes(case, "").get(campaign.shared[0], case.name)
        ranked.append((rank[first], case))
        rank[first] += 1
    return [case for _, case in sorted(ranked, key=itemgetter(0))]
