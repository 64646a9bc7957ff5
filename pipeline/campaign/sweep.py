"""The sweep stage: a campaign file in, a table of all its cases with figures and intervals out."""

from __future__ import annotations

import json
import platform
import sys
from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import asdict
from functools import cache
from pathlib import Path

from llvmlite.binding import get_host_cpu_name

from turtlebag.datasets.claims import MARKER, Claim, claimed
from turtlebag.datasets.errors import InputError
from turtlebag.datasets.fingerprints import fingerprint
from turtlebag.datasets.output_rules import check_free
from turtlebag.datasets.outputs import Stopwatch, package_versions, sha256_text, write_json, write_manifest
from turtlebag.datasets.yaml_files import config_text
from turtlebag.pipeline.campaign.campaign_file import Campaign, Case, campaign_path, cases, load_campaign
from turtlebag.pipeline.campaign.case import ROW, SHARED, Row, Run, throw_away
from turtlebag.pipeline.campaign.engine import run_cases
from turtlebag.pipeline.campaign.table import write_parquet
from turtlebag.pipeline.terminal.messages import log, track
from turtlebag.reports.campaign import compare_pairs, summarise
from turtlebag.reports.campaign_page import Study, draw_campaign, render_campaign
from turtlebag.reports.figures.album import Album
from turtlebag.reports.figures.campaign import Wish
from turtlebag.reports.stages import read_json

TABLE = "results.parquet"
TELL_S = 60.0
MARK = "made_by.txt"
"""In a growing folder: fingerprint of the code, the packages and the machine that made its rows."""
ROOT = Path(__file__).parents[2]
MAKERS = ("datasets", "sim", "planners", "pipeline", "reports/metrics")


def sweep(
    campaign_name: str,
    out: Path,
    run: Run,
    *,
    scheduler: str | None = None,
    workers: int | None = None,
    force: bool = False,
    command: Sequence[str] = ("turtlebag", "sweep"),
) -> int:
    """Run what is left of a campaign, each command line by `run`, and write its results to `out`; 1 when
    any case failed.

    The work grows in `OUT.partial` and stays there when it is stopped: the same command goes on with it.
    """
    watch = Stopwatch()
    campaign = load_campaign(campaign_name)
    check_free(out, force=force, kind="folder")
    with claimed(out, force=force) as claim:
        folder = _work_folder(campaign, claim)
        todo = cases(campaign)
        inputs = _inputs(campaign_name, todo)
        claim.watch(inputs.values())
        rows = _run(campaign, todo, folder / "cases", run, scheduler, workers)
        timing = _collect_timing(folder / "cases")
        _tidy(folder, campaign)
        write_results(campaign, rows, folder)
        extra = {"case_wall_s": timing}
        wall_s = watch.seconds()
        write_manifest(folder, "sweep", command, inputs, seed=campaign.seed, wall_s=wall_s, extra=extra)
        claim.finish()
    failed = sum(bool(row["failed"]) for row in rows)
    log.info(f"{out}: {len(rows)} cases, {failed} failed")
    return int(failed > 0)


def _inputs(campaign_name: str, todo: Sequence[Case]) -> dict[str, Path]:
    """The campaign file, and every file and folder of outputs that a stage's command names."""
    words = {word for case in todo for line in case.commands.values() for word in line}
    values = {word.partition("=")[2] if word.startswith("--") else word for word in words}
    named = {word: Path(word.partition("+clutter:")[0].partition(":")[0]) for word in values}
    files = {
        str(path): path for path in named.values() if path.is_file() or (path / "manifest.json").is_file()
    }
    return {"campaign": campaign_path(campaign_name), **dict(sorted(files.items()))}


def _work_folder(campaign: Campaign, claim: Claim) -> Path:
    """OUT.partial: a new one, or the one an earlier start of the same campaign and code left."""
    folder = claim.partial
    marks = {"config.yaml": config_text(campaign), MARK: surroundings() + "\n"}
    if any(path.name != MARKER for path in folder.iterdir()) and (maker := _other_maker(folder, marks)):
        if not claim.force:
            raise InputError(f"{folder}: left by {maker}; remove it or pass --force to start over")
        claim.clear()
    try:
        (folder / "cases").mkdir(parents=True, exist_ok=True)
        for name, text in marks.items():
            (folder / name).write_text(text)
    except OSError as error:
        raise InputError(f"{folder}: cannot be written ({error.strerror})") from None
    return folder


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
    return fingerprint([read, package_versions(), machine])


def _other_maker(folder: Path, marks: Mapping[str, str]) -> str:
    """What made a folder's rows when it is not what the marks say; empty when it is."""
    kinds = (
        "another campaign",
        "made with other code or packages, or on another machine: it cannot be resumed",
    )
    for (name, text), kind in zip(marks.items(), kinds, strict=True):
        path = folder / name
        if not path.is_file() or sha256_text(path.read_text()) != sha256_text(text):
            return kind
    return ""


def _run(
    campaign: Campaign,
    todo: Sequence[Case],
    folder: Path,
    run: Run,
    scheduler: str | None,
    workers: int | None,
) -> list[Row]:
    """Rows of all cases in the campaign's order; those that were done before are only read."""
    rows: dict[str, Row] = {}
    for case in todo:
        if (folder / case.name / ROW).is_file():
            rows[case.name] = read_json(folder / case.name / ROW)
    # Draws may repeat a case: it runs once.
    left = list({case.name: case for case in todo if case.name not in rows}.values())
    if rows:
        log.info(f"resuming: {len(rows)} of {len(todo)} cases are done")
    if left:
        found = run_cases(campaign, left, folder, run, scheduler=scheduler, workers=workers)
        for row in track(_told(found, len(left)), campaign.name, total=len(left)):
            rows[row["case"]] = row
            if row["failed"]:
                log.warning(f"{row['case']}: {row['error']}")
    return [rows[case.name] for case in todo]


def _told(found: Iterable[Row], total: int) -> Iterator[Row]:
    """The rows; where no progress bar is seen, a line a minute says how far it is."""
    watch, told_s = Stopwatch(), 0.0
    for done, row in enumerate(found, start=1):
        yield row
        if not sys.stderr.isatty() and watch.seconds() - told_s > TELL_S:
            told_s = watch.seconds()
            left_s = told_s / done * (total - done)
            log.info(f"{done} of {total} cases, about {left_s / 60.0:.0f} min left")


def _collect_timing(folder: Path) -> dict[str, float]:
    """Wall time of each case [s]; taken out of the folder, which is the same when a campaign is repeated."""
    timing = {}
    for path in sorted(folder.glob("*/timing.json")):
        timing[path.parent.name] = float(json.loads(path.read_text())["wall_s"])
        path.unlink()
    return timing


def _tidy(folder: Path, campaign: Campaign) -> None:
    """What only the running campaign needed goes; of shared outputs stays what stays of any stage."""
    (folder / MARK).unlink(missing_ok=True)
    if (folder / SHARED).is_dir():
        throw_away(folder / SHARED, campaign.keep)


def write_results(campaign: Campaign, rows: Sequence[Row], folder: Path) -> None:
    """The Parquet table, the statistics and the page."""
    write_parquet(rows, folder / TABLE)
    results = list(campaign.results)
    summaries = {
        factor: summarise(rows, factor, results, campaign.seed)
        for factor in campaign.factors
        if factor != "seed"
    }
    pairs = []
    if campaign.compare is not None and campaign.against is not None:
        others = [factor for factor in campaign.factors if factor != campaign.compare]
        pairs = compare_pairs(rows, campaign.compare, campaign.against, others, results, campaign.seed)
    write_json(
        folder / "summary.json",
        {
            "levels": {factor: [asdict(item) for item in found] for factor, found in summaries.items()},
            "pairs": [asdict(pair) for pair in pairs],
        },
    )
    album = Album(folder / "figures", paper=True)
    names = {key: (item.label or key.replace("_", " "), item.unit) for key, item in campaign.results.items()}
    wishes = [
        Wish(f.x, f.y, names[f.y][0], f.unit or names[f.y][1], f.lines, f.panels, f.title, f.log)
        for f in campaign.figures
    ]
    draw_campaign(wishes, rows, campaign.seed, album)
    study = Study(
        campaign.name,
        campaign.question,
        list(campaign.factors),
        rows,
        names,
        summaries,
        pairs,
        campaign.compare or "",
        campaign.against,
        config_text(campaign),
    )
    page = render_campaign(study, album.pictures)
    (folder / "index.html").write_text(page)
