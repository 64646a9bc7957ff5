"""What a campaign leaves for people: the table, the statistics of it, and the page."""

from __future__ import annotations

import json
import math
import re
import shlex
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import asdict
from difflib import get_close_matches
from pathlib import Path
from typing import Any

from turtlebag.datasets.outputs import write_json
from turtlebag.datasets.yaml_files import config_text
from turtlebag.pipeline.campaign.campaign_file import BAG, Campaign
from turtlebag.pipeline.campaign.case import NUMBERS, Row, Where, kept_at, numbers_of
from turtlebag.pipeline.campaign.cases import Case
from turtlebag.pipeline.campaign.figures import draw_figures, words
from turtlebag.pipeline.campaign.statistics import PairedSummary, compare_pairs, levels_of, summarise
from turtlebag.pipeline.campaign.store import Store
from turtlebag.pipeline.campaign.table import write_table
from turtlebag.pipeline.campaign.worst import Worst
from turtlebag.reports.figures.album import Album
from turtlebag.reports.page import fill

MANY = 100
"""A factor of more levels has no statistics of each, and the table no file for each."""
PAGE = "index.html"
FEW = 100
"""About so many cases are looked at for a result that no row has."""
MOST_FAILURES = 1000
"""So many failed cases are listed."""


def absent_results(campaign: Campaign, todo: Sequence[Case], rows: Sequence[Row], where: Where) -> list[str]:
    """A line for each result that is in no finished case's metrics.json, as when its path is misspelt; one
    that is there and null (not measured) is not absent."""
    finished = {row["case"]: row for row in rows if not row["failed"]}
    done = [case for case in todo if case.name in finished]
    lines = []
    for name, result in campaign.results.items():
        if not done or any(row[name] is not None for row in finished.values()):
            continue
        stage, _, path = result.at.partition(":")
        found = [_kept_metrics(case, campaign, where, stage) for case in done[:: 1 + len(done) // FEW]]
        paths = list(dict.fromkeys(key for metrics in found for key in _paths(metrics)))
        if path not in paths:
            near = get_close_matches(path, paths, 1)
            meant = f"; did you mean {stage}:{near[0]}?" if near else ""
            lines.append(f"results.{name}: no case has {result.at}{meant}")
    return lines


def _kept_metrics(case: Case, campaign: Campaign, where: Where, stage: str) -> dict[str, Any]:
    if stage not in case.commands:
        return {}
    place = kept_at(case, campaign, where.maker, stage)
    contents = [where.runs.read(f"{place}/{name}") for name in NUMBERS]
    return numbers_of(json.loads(content) for content in contents if content is not None)


def _paths(metrics: Mapping[str, Any], before: str = "") -> Iterator[str]:
    """The dotted paths of single values."""
    for key, value in metrics.items():
        if isinstance(value, Mapping):
            yield from _paths(value, f"{before}{key}.")
        elif not isinstance(value, list):
            yield f"{before}{key}"


def write_results(
    campaign: Campaign, source: str, rows: Sequence[Row], runs: Store, folder: Path, worst: Worst | None
) -> None:
    """The table into the store; the statistics, the figures and the page, which names the file `source`, into
    the folder."""
    few = [name for name in campaign.factor_names if len(levels_of(rows, name)) <= MANY]
    write_table(rows, _partition(campaign, few), runs)
    results = list(campaign.results)
    summaries = {factor: summarise(rows, factor, results) for factor in few if factor != "seed"}
    pairs = []
    if campaign.compare is not None and campaign.against is not None:
        others = [factor for factor in campaign.factor_names if factor != campaign.compare]
        pairs = compare_pairs(rows, campaign.compare, campaign.against, others, results)
    write_json(
        folder / "summary.json",
        {
            "levels": {factor: [asdict(item) for item in found] for factor, found in summaries.items()},
            "pairs": [asdict(pair) for pair in pairs],
        },
    )
    album = Album(folder / "figures", paper=True)
    draw_figures(campaign, rows, album)
    failed = [row for row in rows if row["failed"]]

    def page(base: str) -> str:
        """The page as HTML text; `base` stands before links to the files of cases."""
        return fill(
            "campaign.html.j2",
            campaign=campaign,
            rows=rows,
            sizes=_sizes(campaign, rows),
            summaries=summaries,
            pairs=pairs,
            failed=len(failed),
            failures=failed[:MOST_FAILURES],
            pictures=album.pictures,
            against=f"{words(campaign.compare or '')} = {words(campaign.against)}",
            clear=_clear(campaign, pairs),
            source=shlex.quote(source),
            file=config_text(campaign),
            worst=worst,
            base=base,
            words=words,
        )

    place = Path(runs.at("")) if runs.is_local else None
    if place == folder.absolute():
        (folder / PAGE).write_text(page(""))
        return
    (folder / PAGE).write_text(page(f"{runs.url if place is None else place.as_uri()}/"))
    runs.put(PAGE, page("").encode())


def _partition(campaign: Campaign, few: Sequence[str]) -> str:
    """The column whose levels have a file of the table each: what is compared, or else the first that may."""
    wanted = [name for name in few if name not in (BAG, "seed") and re.fullmatch(r"\w+", name)]
    return campaign.compare if campaign.compare in wanted else next(iter(wanted), "failed")


def _sizes(campaign: Campaign, rows: Sequence[Row]) -> str:
    """How many levels each factor has: `2 levels of hz x 3 seeds`."""
    counts = {factor: len(levels_of(rows, factor)) for factor in campaign.factor_names}
    whole = math.prod(counts.values()) == len(rows)
    return (" \u00d7 " if whole else ", ").join(
        f"{n} {factor if factor == 'seed' else 'level'}{'' if n == 1 else 's'}"
        f"{'' if factor == 'seed' else f' of {words(factor)}'}"
        for factor, n in counts.items()
    )


def _clear(
    campaign: Campaign, pairs: Sequence[PairedSummary]
) -> dict[str, tuple[list[PairedSummary], list[PairedSummary]]]:
    """For each result the pairs whose difference leaves out 0, and the others that were compared."""
    found: dict[str, tuple[list[PairedSummary], list[PairedSummary]]] = {}
    for pair in pairs:
        differ, rest = found.setdefault(campaign.names[pair.result][0], ([], []))
        (differ if pair.differs else rest).append(pair)
    return found
