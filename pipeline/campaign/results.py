"""What a campaign leaves for people: the table, the statistics of it, and the page."""

from __future__ import annotations

import re
from collections.abc import Sequence
from dataclasses import asdict
from pathlib import Path

from turtlebag.datasets.outputs import write_json
from turtlebag.datasets.yaml_files import config_text
from turtlebag.pipeline.campaign.campaign_file import BAG, Campaign
from turtlebag.pipeline.campaign.case import Row
from turtlebag.pipeline.campaign.store import Store
from turtlebag.pipeline.campaign.table import write_table
from turtlebag.reports.campaign import compare_pairs, levels_of, summarise
from turtlebag.reports.campaign_page import Study, Worst, draw_campaign, render_campaign
from turtlebag.reports.figures.album import Album
from turtlebag.reports.figures.campaign import Wish

PAGE = "index.html"
MANY = 100
"""A factor of more levels has no statistics of each, and the table no file for each."""


def write_results(
    campaign: Campaign, source: str, rows: Sequence[Row], runs: Store, folder: Path, worst: Worst | None
) -> None:
    """The table into the store; the statistics, the figures and the page, which names the file `source`, into
    the folder."""
    few = [name for name in campaign.factor_names if len(levels_of(rows, name)) <= MANY]
    write_table(rows, _partition(campaign, few), runs)
    results = list(campaign.results)
    summaries = {
        factor: summarise(rows, factor, results, campaign.seed) for factor in few if factor != "seed"
    }
    pairs = []
    if campaign.compare is not None and campaign.against is not None:
        others = [factor for factor in campaign.factor_names if factor != campaign.compare]
        pairs = compare_pairs(rows, campaign.compare, campaign.against, others, results, campaign.seed)
    write_json(
        folder / "summary.json",
        {
            "levels": {factor: [asdict(item) for item in found] for factor, found in summaries.items()},
            "pairs": [asdict(pair) for pair in pairs],
        },
    )
    album = Album(folder / "figures", paper=True)
    names = names_of(campaign)
    wishes = [
        Wish(f.x, f.y, names[f.y][0], f.unit or names[f.y][1], f.lines, f.panels, f.title, f.log)
        for f in campaign.figures
    ]
    draw_campaign(wishes, rows, campaign.seed, album)
    study = Study(
        campaign.name,
        campaign.question,
        campaign.factor_names,
        rows,
        names,
        summaries,
        pairs,
        campaign.compare or "",
        campaign.against,
        source,
        config_text(campaign),
        worst,
    )
    (folder / PAGE).write_text(
        render_campaign(study, album.pictures, "" if runs.is_local else f"{runs.url}/")
    )
    if not runs.is_local:
        runs.put(PAGE, render_campaign(study, album.pictures, "").encode())


def _partition(campaign: Campaign, few: Sequence[str]) -> str:
    """The column whose levels have a file of the table each: what is compared, or else the first that may."""
    wanted = [name for name in few if name not in (BAG, "seed") and re.fullmatch(r"\w+", name)]
    return campaign.compare if campaign.compare in wanted else next(iter(wanted), "failed")


def names_of(campaign: Campaign) -> dict[str, tuple[str, str]]:
    """What each result is called, and its unit."""
    return {key: (item.label or key.replace("_", " "), item.unit) for key, item in campaign.results.items()}
