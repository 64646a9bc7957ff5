"""The page of a campaign."""

from __future__ import annotations

import math
import shlex
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import partial
from typing import Any

from turtlebag.reports.campaign import LevelSummary, PairedSummary, levels_of
from turtlebag.reports.figures.album import Album, Picture
from turtlebag.reports.figures.campaign import Wish, result_over_factor, words
from turtlebag.reports.numbers import DASH, shown
from turtlebag.reports.page import fill
from turtlebag.reports.stage_titles import slug

MOST_FAILURES = 1000
"""So many failed cases are listed."""
Row = Mapping[str, Any]
Names = Mapping[str, tuple[str, str]]
"""Result -> (what it is called, unit of turtlebag.reports.numbers.UNITS)."""


def draw_campaign(wishes: Sequence[Wish], rows: Sequence[Row], seed: int, album: Album) -> None:
    """Draw the figures a campaign asks for."""
    for number, wish in enumerate(wishes, start=1):
        shares = [words(factor) for factor in (wish.lines, wish.panels) if factor]
        each = f", for each {' and '.join(shares)}" if shares else ""
        caption = f"{wish.label} over {words(wish.x)}{each}."
        name = f"{number:02d}-{slug(wish.y)}-over-{slug(wish.x)}"
        caption, drawn = caption[0].upper() + caption[1:], (rows, wish, seed)
        album.add(name, wish.title or wish.label, caption, result_over_factor, *drawn)


@dataclass(frozen=True, eq=False)
class Worst:
    """The case with the largest value of a result, called `label`; `link` leads to its files."""

    row: Row
    label: str
    value: float
    unit: str
    link: str


@dataclass(frozen=True, eq=False)
class Running:
    """How far a campaign is: cases done and failed of all, `rate` in cases a second, the newest failures."""

    name: str
    question: str
    factors: Sequence[str]
    total: int
    done: int
    failed: int
    rate: float
    failures: Sequence[Row]
    worst: Worst | None


@dataclass(frozen=True, eq=False)
class Study:
    """A finished campaign as its page shows it: its question, its table, and the numbers made of that.

    `against` is the level of the factor `compare` that the pairs hold the others against; `source` names the
    campaign file, `file` is its text; `worst` its worst case by the first result, if that is a number.
    """

    name: str
    question: str
    factors: Sequence[str]
    rows: Sequence[Row]
    names: Names
    summaries: Mapping[str, Sequence[LevelSummary]]
    pairs: Sequence[PairedSummary]
    compare: str
    against: Any
    source: str
    file: str
    worst: Worst | None


def render_running(running: Running, again_s: float) -> str:
    """The page of a campaign under way, as HTML text that a browser loads again every so often [s]."""
    left, rate = running.total - running.done, running.rate
    return fill(
        "campaign_running.html.j2",
        running=running,
        share=shown(running.done / running.total, "percent") if running.total else DASH,
        rate=f"{60.0 * rate:.3g}" if rate > 0.0 else DASH,
        left=_duration(left / rate) if rate > 0.0 else DASH,
        chosen=partial(_chosen, running.factors),
        shown=shown,
        again_s=round(again_s),
    )


def _duration(seconds: float) -> str:
    """A time span for people, to two units."""
    for size, unit, smaller, name in ((86400, "d", 3600, "h"), (3600, "h", 60, "min"), (60, "min", 1, "s")):
        if seconds >= size:
            return f"{int(seconds // size)} {unit} {int(seconds % size // smaller)} {name}"
    return f"{int(seconds)} s"


def render_campaign(study: Study, pictures: Sequence[Picture], base: str) -> str:
    """The page as HTML text; `base` stands before links to the files of cases."""
    failed = [row for row in study.rows if row["failed"]]
    return fill(
        "campaign.html.j2",
        study=study,
        sizes=_sizes(study),
        failed=len(failed),
        failures=failed[:MOST_FAILURES],
        chosen=partial(_chosen, study.factors),
        pictures=pictures,
        against=f"{words(study.compare)} = {words(study.against)}",
        clear=_clear(study),
        source=shlex.quote(study.source),
        base=base,
        words=words,
        shown=shown,
    )


def _sizes(study: Study) -> str:
    """How many levels each factor has: `2 levels of hz x 3 seeds`."""
    counts = {factor: len(levels_of(study.rows, factor)) for factor in study.factors}
    whole = math.prod(counts.values()) == len(study.rows)
    return (" \u00d7 " if whole else ", ").join(
        f"{n} {factor if factor == 'seed' else 'level'}{'' if n == 1 else 's'}"
        f"{'' if factor == 'seed' else f' of {words(factor)}'}"
        for factor, n in counts.items()
    )


def _clear(study: Study) -> dict[str, tuple[list[PairedSummary], list[PairedSummary]]]:
    """For each result the pairs whose difference leaves out 0, and the others that were compared."""
    found: dict[str, tuple[list[PairedSummary], list[PairedSummary]]] = {}
    for pair in study.pairs:
        differ, rest = found.setdefault(study.names[pair.result][0], ([], []))
        (differ if pair.differs else rest).append(pair)
    return found


def _chosen(factors: Sequence[str], row: Row) -> str:
    """The levels of a case."""
    return ", ".join(f"{factor} {row[factor]}" for factor in factors)
