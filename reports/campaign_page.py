"""The page of a campaign."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from functools import partial
from typing import Any

from turtlebag.reports.campaign import LevelSummary, PairedSummary, levels_of
from turtlebag.reports.figures.album import Album, Picture
from turtlebag.reports.figures.campaign import result_over_factor, words
from turtlebag.reports.metrics.statistics import Interval
from turtlebag.reports.numbers import DASH, shown
from turtlebag.reports.page import fill
from turtlebag.reports.stage_titles import slug

Row = Mapping[str, Any]
Names = Mapping[str, tuple[str, str]]
"""Result -> (what it is called, unit of turtlebag.reports.numbers.UNITS)."""


def draw_campaign(
    figures: Sequence[Mapping[str, Any]],
    rows: Sequence[Row],
    seed: int,
    names: Names,
    album: Album,
) -> None:
    """Draw the figures a campaign asks for: mappings of x, y, lines, panels, title, unit, log."""
    for number, wish in enumerate(figures, start=1):
        label, unit = names[wish["y"]]
        unit = wish["unit"] or unit
        options = {key: wish[key] for key in ("lines", "panels", "log")}
        drawing = partial(
            result_over_factor, rows, wish["x"], wish["y"], label=label, unit=unit, seed=seed, **options
        )
        shares = [words(wish[key]) for key in ("lines", "panels") if wish[key]]
        caption = f"{label} over {words(wish['x'])}" + (
            f", for each {' and '.join(shares)}" if shares else ""
        )
        name = f"{number:02d}-{slug(wish['y'])}-over-{slug(wish['x'])}"
        album.add(name, wish["title"] or label, caption[0].upper() + caption[1:] + ".", drawing)


def render_campaign(
    name: str,
    question: str,
    rows: Sequence[Row],
    summaries: Mapping[str, Sequence[LevelSummary]],
    pairs: Sequence[PairedSummary],
    *,
    compare: str,
    against: Any,
    names: Names,
    factors: Sequence[str],
    pictures: Sequence[Picture],
    file: str,
) -> str:
    """The page as HTML text; `names` says how each result is called and its unit."""
    compared = [_pair(pair, names) for pair in pairs]
    return fill(
        "campaign.html.j2",
        name=name,
        question=question,
        total=len(rows),
        sizes=", ".join(f"{words(factor)} {len(levels_of(rows, factor))}" for factor in factors),
        failed=[_failure(row, factors) for row in rows if row["failed"]],
        pictures=pictures,
        compare=words(compare),
        against=words(against),
        pairs=compared,
        clear=_clear(compared),
        levels=[_level(factor, item, names) for factor, found in summaries.items() for item in found],
        file=file,
    )


def _clear(pairs: Sequence[Mapping[str, Any]]) -> list[dict[str, Any]]:
    """For each result the levels whose difference leaves out 0, and how many others were compared."""
    found: dict[str, dict[str, Any]] = {}
    for pair in pairs:
        entry = found.setdefault(pair["result"], {"result": pair["result"], "differ": [], "rest": []})
        entry["differ" if pair["differs"] else "rest"].append(pair)
    return list(found.values())


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


def _level(factor: str, item: LevelSummary, names: Names) -> dict[str, str]:
    label, unit = names[item.result]
    unit = "percent" if item.kind == "share" else unit
    return {
        "factor": words(factor),
        "level": words(item.level),
        "result": label,
        "kind": item.kind,
        "failed": str(item.failed),
        **_texts(item.interval, unit),
    }


def _pair(pair: PairedSummary, names: Names) -> dict[str, Any]:
    label, unit = names[pair.result]
    found = pair.found.difference
    clear = found.low is not None and found.high is not None and (found.low > 0.0 or found.high < 0.0)
    less = DASH if pair.found.less is None else shown(pair.found.less, "percent")
    return {
        "level": words(pair.level),
        "result": label,
        "differs": clear,
        "less": less,
        **_texts(found, unit),
    }
