"""The page about a twin: each quantity of the real drive beside that of the simulated ones."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np
from matplotlib.figure import Figure

from turtlebag.datasets.grid import OccupancyGrid
from turtlebag.datasets.se2 import Array
from turtlebag.reports.figures import style
from turtlebag.reports.figures.album import Album
from turtlebag.reports.figures.maps import plain_map
from turtlebag.reports.page import fill

DRAWN = 8
"""Quantities with a picture of their distributions: those that differ most."""


def draw_twin(
    differences: Sequence[Any], real: OccupancyGrid, simulated: OccupancyGrid, album: Album
) -> None:
    """Distributions of what differs most, and both maps. A difference has its `quantity`, the values `real`
    (n,) and `simulated` (m,), and says a `sentence` of them."""
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
    axes.legend(loc="lower right")
    return figure


def twin_page(
    source: str, about: Mapping[str, Any], differences: Sequence[Any], pictures: Sequence[object]
) -> str:
    """The page as HTML text; `about` has `base`, `shown`, `total` and `drives`."""
    return fill(
        "twin.html.j2",
        source=source,
        about=about,
        apart=[one for one in differences if one.differs],
        alike=[one for one in differences if not one.differs],
        rows=[(one, _spread(one.real), _spread(one.simulated)) for one in differences],
        pictures=pictures,
    )


def _spread(values: Array) -> str:
    low, middle, high = np.quantile(values, [0.05, 0.5, 0.95])
    return f"{middle:.3g} ({low:.3g} to {high:.3g})"
