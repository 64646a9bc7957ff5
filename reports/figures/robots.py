"""The data behind a robot's parameters, and real drives beside simulated ones."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from typing import Any

import numpy as np
from matplotlib.figure import Figure
from matplotlib.ticker import MaxNLocator
from pydantic import BaseModel

from turtlebag.datasets.grid import OccupancyGrid
from turtlebag.datasets.yaml_files import checked
from turtlebag.reports.figures import style
from turtlebag.reports.figures.album import Album
from turtlebag.reports.figures.maps import plain_map

MANY = 50
"""Of so many dots a few may be left out."""


EFFECTS_TOLD = "Cliff's delta, from -1 (smaller in the twin) to 1; grey: cannot be told apart."
DRAWN = 8
"""Quantities with a picture of their distributions: those that differ most."""


class DataPlot(BaseModel):
    """An entry of plots.json: x and y of each series, the axes' labels, and what it shows."""

    title: str
    caption: str
    x: str
    y: str
    points: dict[str, tuple[list[float], list[float]]]
    lines: dict[str, tuple[list[float], list[float]]]


def draw_plots(plots: Mapping[str, Any], album: Album) -> None:
    """A picture of each entry of plots.json; InputError for what is none."""
    for name, entry in plots.items():
        plot = checked(DataPlot, entry, where=f"plots.json: {name}")
        album.add(name, plot.title, plot.caption, data_plot, plot)


def data_plot(plot: DataPlot) -> Figure:
    """Dots of data and lines of what was fitted, in one colour where they have one name."""
    figure = style.new_figure(2.9)
    axes = figure.subplots()
    names = list(dict.fromkeys([*plot.points, *plot.lines]))
    colours = {name: style.series_colour(k) for k, name in enumerate(names)}
    for name, (x, y) in plot.points.items():
        axes.plot(x, y, "o", color=colours[name], markersize=2.5, alpha=0.7, label=name)
    for name, (x, y) in plot.lines.items():
        label = None if name in plot.points else name
        axes.plot(x, y, color=colours[name], linewidth=1.3, label=label)
    axes.set_xlim(_without_strays(axes.get_xlim(), (x for x, _ in plot.points.values())))
    axes.set_ylim(_without_strays(axes.get_ylim(), (y for _, y in plot.points.values())))
    axes.set_xlabel(plot.x)
    axes.set_ylabel(plot.y)
    if len(names) > 1:
        axes.legend()
    return figure


def _without_strays(ends: tuple[float, float], series: Iterable[Sequence[float]]) -> tuple[float, float]:
    """Ends of an axis that leave out the few dots that would squeeze all others."""
    values = np.concatenate([np.zeros(0), *series])
    if len(values) < MANY:
        return ends
    low, high = np.quantile(values, [0.02, 0.98]).tolist()
    return max(ends[0], 1.5 * low - 0.5 * high), min(ends[1], 1.5 * high - 0.5 * low)


def draw_twin(
    differences: Sequence[Any], real: OccupancyGrid, simulated: OccupancyGrid, album: Album
) -> None:
    """Distributions of what differs most, and both maps. A difference has its `quantity`, the values `real`
    (n,) and `simulated` (m,), and says a `sentence` of them."""
    found = {one.quantity.name: one.as_metrics() for one in differences}
    album.add("effects", "Real beside simulated", EFFECTS_TOLD, effects, found)
    for one in differences[:DRAWN]:
        name, label = one.quantity.name, one.quantity.label
        caption = f"Share of values up to each. {label[0].upper()}{label[1:]}: {one.sentence}."
        album.add(name, label[0].upper() + label[1:], caption, distributions, one)
    album.add("map_real", "Map of the real drive", "It is the twin's world.", plain_map, real, {})
    album.add(
        "map_simulated",
        "Map of the first simulated drive",
        "As the twin's robot maps it.",
        plain_map,
        simulated,
        {},
    )


def effects(quantities: Mapping[str, Mapping[str, Any]]) -> Figure:
    """Cliff's delta of each quantity, of the entries of metrics.json."""
    figure = style.new_figure(0.8 + 0.3 * len(quantities))
    axes = figure.subplots()
    entries = list(quantities.values())[::-1]
    colours = [style.series_colour(0) if one["told_apart"] else style.MUTED for one in entries]
    rows = np.arange(len(entries))
    axes.barh(rows, [one["cliffs_delta"] for one in entries], 0.4, color=colours)
    # above the bars: beside them, names as long as these leave none of the width
    for row, one in enumerate(entries):
        axes.text(-0.98, row + 0.22, one["label"], fontsize="x-small", verticalalignment="bottom")
    axes.set_yticks([])
    axes.set_xlim(-1.0, 1.0)
    axes.set_xlabel("Cliff's delta")
    return figure


def distributions(one: Any) -> Figure:
    """Cumulative distributions of both."""
    figure = style.new_figure(2.6)
    axes = figure.subplots()
    for number, (name, values) in enumerate((("real", one.real), ("simulated", one.simulated))):
        ordered = np.quantile(values, np.linspace(0.0, 1.0, 401))
        axes.plot(ordered, np.linspace(0.0, 1.0, 401), color=style.series_colour(number), label=name)
    both = np.concatenate([one.real, one.simulated])
    axes.set_xlim(float(both.min()), max(float(np.quantile(both, 0.995)), float(both.min()) + 1e-9))
    axes.set_xlabel(f"{one.quantity.label} [{one.quantity.unit}]")
    axes.set_ylabel("share of values")
    axes.xaxis.set_major_locator(MaxNLocator(5))
    axes.legend(loc="lower right")
    return figure
