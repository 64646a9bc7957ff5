"""The page of a campaign."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from functools import partial
from typing import Any

from reports.campaign import LevelSummary, PairedSummary
from reports.content import slug
from reports.figures.album import Album, Picture
from reports.figures.campaign import result_over_factor
from reports.metrics.statistics import Interval
from reports.numbers import DASH, shown
from reports.page import fill

Row = Mapping[str, Any]


def draw_campaign(figures: Sequence[Mapping[str, Any]], rows: Sequence[Row], seed: int, album: Album) -> None:
    """Draw the figures a campaign asks for: mappings of x, y, lines, title, unit, log."""
    for number, wish in enumerate(figures, start=1):
        drawing = partial(
            result_over_factor,
            rows,
            wish["x"],
            wish["y"],
            lines=wish["lines"],
            unit=wish["unit"],
            log=wish["log"],
            seed=seed,
        )
        caption = f"{wish['y']} over {wish['x']}" + (f", for each {wish['lines']}." if wish["lines"] else ".")
        name = f"{number:02d}-{slug(wish['y'])}-over-{slug(wish['x'])}"
        album.add(name, wish["title"] or wish["y"], caption, drawing)


def render_campaign(
    name: str,
    question: str,
    rows: Sequence[Row],
    summaries: Mapping[str, Sequence[LevelSummary]],
    pairs: Sequence[PairedSummary],
    *,
    compare: str,
    against: Any,
    units: Mapping[str, str],
    factors: Sequence[str],
    pictures: Sequence[Picture],
    file: str,
) -> str:
    """The page as HTML text; `units` says how each result is shown."""
    return fill(
        "campaign.html.j2",
        name=name,
        question=question,
        total=len(rows),
        failed=[_failure(row, factors) for row in rows if row["failed"]],
        pictures=pictures,
        compare=compare,
        against=against,
        pairs=[_pair(pair, units.get(pair.result, "plain")) for pair in pairs],
        levels=[
            _level(factor, item, units.get(item.result, "plain"))
            for factor, found in summaries.items()
            for item in found
        ],
        file=file,
    )


def _failure(row: Row, factors: Sequence[str]) -> dict[str, str]:
    chosen = ", ".join(f"{factor} {row[factor]}" for factor in factors)
    return {"case": str(row["case"]), "factors": chosen, "error": str(row["error"])}


def _texts(interval: Interval, unit: str) -> dict[str, str]:
    return {
        "n": str(interval.n),
        "value": shown(interval.value, unit),
        "low": shown(interval.low, unit),
        "high": shown(interval.high, unit),
    }


def _level(factor: str, item: LevelSummary, unit: str) -> dict[str, str]:
    unit = "percent" if item.kind == "share" else unit
    return {
        "factor": factor,
        "level": str(item.level),
        "result": item.result,
        "kind": item.kind,
        "failed": str(item.failed),
        **_texts(item.interval, unit),
    }


def _pair(pair: PairedSummary, unit: str) -> dict[str, Any]:
    found = pair.found.difference
    clear = found.low is not None and found.high is not None and (found.low > 0.0 or found.high < 0.0)
    less = DASH if pair.found.less is None else shown(pair.found.less, "percent")
    return {
        "level": str(pair.level),
        "result": pair.result,
        "clear": clear,
        "less": less,
        **_texts(found, unit),
    }
