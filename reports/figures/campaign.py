"""Results of a campaign over a factor, with intervals."""

from __future__ import annotations

import textwrap
from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.ticker import FuncFormatter, LogLocator, NullFormatter

from turtlebag.reports.campaign import interval, is_share, levels_of
from turtlebag.reports.figures.style import MUTED, SERIES, new_figure
from turtlebag.reports.numbers import UNITS

Row = Mapping[str, Any]
COLUMNS = 3
WRAP = 32
"""Characters of a label in a line."""
MARKERS = ("o", "s", "^", "D", "v", "P")


def result_over_factor(
    rows: Sequence[Row],
    x: str,
    y: str,
    *,
    lines: str | None,
    panels: str | None,
    label: str,
    unit: str,
    log: bool,
    seed: int,
) -> Figure:
    """Median (or share) of `y` with its interval at each level of `x`; single cases as faint dots.

    One line for each level of `lines`; one panel, all to one scale, for each level of `panels`.
    """
    share = is_share(rows, y)
    symbol = "%" if share else UNITS[unit].symbol
    groups = levels_of(rows, panels) if panels is not None else [None]
    columns = min(len(groups), COLUMNS)
    lanes = -(-len(groups) // columns)
    figure = new_figure(3.2 if panels is None else 0.6 + 1.5 * lanes)
    grid = figure.subplots(lanes, columns, sharex=True, sharey=True, squeeze=False).ravel()
    for axes, group in zip(grid, groups, strict=False):
        chosen = [row for row in rows if panels is None or row[panels] == group]
        _draw_lines(axes, chosen, x, y, lines, "percent" if share else unit, seed, share)
        if group is not None:
            axes.set_title(words(group), fontsize="small")
    for axes in grid[len(groups) :]:
        axes.set_visible(False)
    if log and not share:
        grid[0].set_yscale("log")
        grid[0].yaxis.set_major_locator(LogLocator(subs=(1.0, 2.0, 5.0)))
        grid[0].yaxis.set_major_formatter(FuncFormatter(lambda value, _: f"{value:g}"))
        grid[0].yaxis.set_minor_formatter(NullFormatter())
    else:
        grid[0].set_ylim(bottom=0.0, top=105.0 if share else None)
    text = textwrap.fill(f"{label} [{symbol}]" if symbol else label, WRAP)
    if panels is None:
        grid[0].set_xlabel(words(x))
        grid[0].set_ylabel(text)
    else:
        figure.supxlabel(words(x), fontsize="medium")
        figure.supylabel(text, fontsize="medium")
    if lines is not None and grid[0].get_legend_handles_labels()[0]:
        handles, names = grid[0].get_legend_handles_labels()
        names[0] = f"{words(lines)}: {names[0]}"
        # Above, where it hides no mark.
        figure.legend(handles, names, loc="outside upper right", ncols=len(names))
    return figure


def words(level: Any) -> str:
    """A level or factor as it is written in a figure."""
    return str(level).replace("_", " ")


def _draw_lines(
    axes: Axes, rows: Sequence[Row], x: str, y: str, lines: str | None, unit: str, seed: int, share: bool
) -> None:
    """All lines of one panel."""
    levels = levels_of(rows, x)
    numeric = all(isinstance(level, (int, float)) and not isinstance(level, bool) for level in levels)
    groups = levels_of(rows, lines) if lines is not None else [None]
    for number, group in enumerate(groups):
        chosen = [row for row in rows if lines is None or row[lines] == group]
        # Beside each other, so that intervals do not hide one another.
        step = 0.012 * (max(levels) - min(levels)) if numeric else 0.16
        shift = step * (number - (len(groups) - 1) / 2)
        places = [float(level) + shift if numeric else index + shift for index, level in enumerate(levels)]
        label = None if group is None else words(group)
        factor = UNITS[unit].factor
        _draw_group(
            axes, chosen, x, y, levels, places, factor, seed, number, label, joined=numeric, dots=not share
        )
    if not numeric:
        crowded = len(levels) > 6
        names = [words(level) for level in levels]
        axes.set_xticks(
            range(len(levels)), names, rotation=30 if crowded else 0, ha="right" if crowded else "center"
        )


def _draw_group(
    axes: Axes,
    rows: Sequence[Row],
    x: str,
    y: str,
    levels: Sequence[Any],
    places: Sequence[float],
    factor: float,
    seed: int,
    number: int,
    label: str | None,
    *,
    joined: bool,
    dots: bool,
) -> None:
    colour, marker = SERIES[number % len(SERIES)], MARKERS[number % len(MARKERS)]
    centres: list[tuple[float, float, float, float]] = []
    for level, place in zip(levels, places, strict=True):
        here = [row for row in rows if row[x] == level]
        found = interval(here, y, seed, f"{x}={level} {label}")
        if dots:
            values = [factor * row[y] for row in here if isinstance(row[y], (int, float))]
            axes.plot(
                np.full(len(values), place), values, ".", color=MUTED, markersize=3, alpha=0.45, zorder=2
            )
        if found.value is not None and found.low is not None and found.high is not None:
            centres.append((place, factor * found.value, factor * found.low, factor * found.high))
    if not centres:
        return
    at, value, low, high = np.array(centres).T
    spread = np.maximum(np.stack([value - low, high - value]), 0.0)
    style = "-" if joined else "none"
    axes.errorbar(
        at, value, yerr=spread, fmt=marker, linestyle=style, color=colour, capsize=3, label=label, zorder=3
    )
