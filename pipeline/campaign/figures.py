"""Results of a campaign over a factor, with intervals."""

from __future__ import annotations

import textwrap
from collections.abc import Sequence
from typing import Any, cast

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.ticker import FuncFormatter, LogLocator, NullFormatter
from matplotlib.transforms import offset_copy

from turtlebag.pipeline.campaign.campaign_file import Campaign
from turtlebag.pipeline.campaign.campaign_file import Figure as Wish
from turtlebag.pipeline.campaign.statistics import Row, interval, is_share, levels_of
from turtlebag.reports.figures.album import Album
from turtlebag.reports.figures.style import new_figure, series_colour
from turtlebag.reports.metrics.statistics import Interval
from turtlebag.reports.numbers import UNITS
from turtlebag.reports.stage_titles import slug

COLUMNS = 3
WRAP = 32
"""Characters of a label in a line."""
LEVEL_WORDS = 48
"""Characters of all levels that find room beside each other in a figure; if there are more, they slant."""
MARKERS = ("o", "s", "^", "D", "v", "P")


def draw_figures(campaign: Campaign, rows: Sequence[Row], album: Album) -> None:
    """The figures that a campaign asks for."""
    for number, wish in enumerate(campaign.figures, start=1):
        label, unit = campaign.names[wish.y]
        shares = [words(factor) for factor in (wish.lines, wish.panels) if factor]
        each = f", for each {' and '.join(shares)}" if shares else ""
        caption = f"{label} over {words(wish.x)}{each}."
        caption = caption[0].upper() + caption[1:]
        name = f"{number:02d}-{slug(wish.y)}-over-{slug(wish.x)}"
        album.add(name, wish.title or label, caption, result_over_factor, rows, wish, label, unit)


def result_over_factor(rows: Sequence[Row], wish: Wish, label: str, stored: str) -> Figure:
    """Mean (or share) with its interval at each level; single cases as faint dots. The result is called
    `label`, its unit is `stored`; all panels have one scale."""
    share = is_share(rows, wish.y)
    unit, panels = UNITS["percent" if share else stored], wish.panels
    groups = levels_of(rows, panels) if panels is not None else [None]
    columns = min(len(groups), COLUMNS)
    lanes = -(-len(groups) // columns)
    figure = new_figure(3.2 if panels is None else 1.7 + 1.5 * lanes)
    grid = figure.subplots(lanes, columns, sharex=True, sharey=True, squeeze=False).ravel()
    for axes, group in zip(grid, groups, strict=False):
        chosen = [row for row in rows if panels is None or row[panels] == group]
        _draw_lines(axes, chosen, wish, unit.factor, LEVEL_WORDS // columns)
        if group is not None:
            axes.set_title(words(group), fontsize="small")
    for axes in grid[len(groups) :]:
        axes.set_visible(False)
    positive = [row[wish.y] for row in rows if isinstance(row[wish.y], (int, float)) and row[wish.y] > 0.0]
    if wish.log and positive and not share:
        grid[0].set_yscale("log")
        wide = max(positive) > 100.0 * min(positive)
        grid[0].yaxis.set_major_locator(LogLocator(subs=(1.0,) if wide else (1.0, 2.0, 5.0)))
        grid[0].yaxis.set_major_formatter(FuncFormatter(lambda value, _: f"{value:g}"))
        grid[0].yaxis.set_minor_formatter(NullFormatter())
    else:
        grid[0].set_ylim(bottom=0.0, top=105.0 if share else None)
    text = textwrap.fill(f"{label} [{unit.symbol}]" if unit.symbol else label, WRAP)
    if panels is None:
        grid[0].set_xlabel(words(wish.x))
        grid[0].set_ylabel(text)
    else:
        figure.supxlabel(words(wish.x), fontsize="medium")
        figure.supylabel(text, fontsize="medium")
    if wish.lines is not None and grid[0].get_legend_handles_labels()[0]:
        handles, names = grid[0].get_legend_handles_labels()
        names[0] = f"{words(wish.lines)}: {names[0]}"
        # Above, where it hides no mark.
        figure.legend(handles, names, loc="outside upper right", ncols=min(len(names), COLUMNS))
    return figure


def words(level: Any) -> str:
    """A level or factor as it is written in a figure."""
    return str(level).replace("_", " ")


def _draw_lines(axes: Axes, rows: Sequence[Row], wish: Wish, factor: float, room: int) -> None:
    """All lines of one panel, which has room for so many characters of the levels beside each other."""
    share, levels = is_share(rows, wish.y), levels_of(rows, wish.x)
    numeric = all(isinstance(level, (int, float)) and not isinstance(level, bool) for level in levels)
    groups = levels_of(rows, wish.lines) if wish.lines is not None else [None]
    for number, group in enumerate(groups):
        chosen = [row for row in rows if wish.lines is None or row[wish.lines] == group]
        # Beside each other, so that intervals do not hide one another.
        step = 0.012 * (max(levels) - min(levels)) if numeric else 0.16
        shift = step * (number - (len(groups) - 1) / 2)
        label = None if group is None else words(group)
        found = []
        for index, level in enumerate(levels):
            here = [row for row in chosen if row[wish.x] == level]
            place = float(level) + shift if numeric else index + shift
            found.append((place, interval(here, wish.y)))
            if not share:
                values = [factor * row[wish.y] for row in here if isinstance(row[wish.y], (int, float))]
                at = np.full(len(values), place)
                # Beside the interval, whose bar and mark would hide them.
                aside = offset_copy(axes.transData, cast(Figure, axes.figure), x=-6.0, units="points")
                colour = series_colour(number)
                axes.plot(at, values, ".", color=colour, markersize=4, alpha=0.5, transform=aside, zorder=4)
        _draw_line(axes, found, factor, number, label, "-" if numeric else "none")
    if not numeric:
        names = [words(level) for level in levels]
        crowded = len(levels) > 6 or sum(map(len, names)) > room
        axes.set_xticks(
            range(len(levels)), names, rotation=45 if crowded else 0, ha="right" if crowded else "center"
        )


def _draw_line(
    axes: Axes,
    found: Sequence[tuple[float, Interval]],
    factor: float,
    number: int,
    label: str | None,
    style: str,
) -> None:
    """The means with their intervals, at places along the x axis; no bar where there is no interval."""
    known = [
        (
            place,
            one.value,
            one.value if one.low is None else one.low,
            one.value if one.high is None else one.high,
        )
        for place, one in found
        if one.value is not None
    ]
    if not known:
        return
    at, value, low, high = np.array(known).T
    whiskers = factor * np.maximum(np.stack([value - low, high - value]), 0.0)
    axes.errorbar(
        at,
        factor * value,
        yerr=whiskers,
        fmt=MARKERS[number % len(MARKERS)],
        linestyle=style,
        color=series_colour(number),
        capsize=3,
        label=label,
        zorder=3,
    )
