"""Results of a campaign over a factor, with intervals."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from reports.campaign import interval, is_share, levels_of
from reports.figures.style import ACCENT, AMCL, BAD, INK, MUTED, ODOMETRY, SLAM, new_figure
from reports.numbers import DISPLAY

COLOURS = (SLAM, BAD, AMCL, ODOMETRY, ACCENT, INK)
MARKERS = ("o", "s", "^", "D", "v", "P")


def result_over_factor(
    rows: Sequence[Mapping[str, Any]],
    x: str,
    y: str,
    *,
    lines: str | None,
    unit: str,
    log: bool,
    seed: int,
) -> Figure:
    """Median (or share) of `y` with its interval at each level of `x`; single cases as faint dots."""
    figure = new_figure(3.2)
    axes = figure.add_subplot()
    levels = levels_of(rows, x)
    numeric = all(isinstance(level, (int, float)) and not isinstance(level, bool) for level in levels)
    share = is_share(rows, y)
    factor, symbol, _ = (100.0, "%", 0) if share else DISPLAY[unit]
    groups = levels_of(rows, lines) if lines is not None else [None]
    for number, group in enumerate(groups):
        chosen = [row for row in rows if lines is None or row[lines] == group]
        # Beside each other, so that intervals do not hide one another.
        step = 0.012 * (max(levels) - min(levels)) if numeric else 0.5 / len(groups)
        shift = step * (number - (len(groups) - 1) / 2)
        places = [float(level) + shift if numeric else index + shift for index, level in enumerate(levels)]
        label = None if group is None else str(group)
        _draw_group(
            axes, chosen, x, y, levels, places, factor, seed, number, label, joined=numeric, dots=not share
        )
    if not numeric:
        axes.set_xticks(range(len(levels)), [str(level) for level in levels])
    axes.set_xlabel(x)
    axes.set_ylabel(f"{y} [{symbol}]" if symbol else y)
    if log and not share:
        axes.set_yscale("log")
    else:
        axes.set_ylim(bottom=0.0, top=105.0 if share else None)
    if lines is not None and axes.get_legend_handles_labels()[0]:
        axes.legend(loc="best", title=lines)
    return figure


def _draw_group(
    axes: Axes,
    rows: Sequence[Mapping[str, Any]],
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
    colour, marker = COLOURS[number % len(COLOURS)], MARKERS[number % len(MARKERS)]
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
