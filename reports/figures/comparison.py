"""Two outputs in one picture: A purple, wide and below, B blue and above."""

from __future__ import annotations

from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.colors import to_rgb
from matplotlib.figure import Figure
from matplotlib.patches import Patch

from turtlebag.datasets.grid import OCCUPIED_FROM, OccupancyGrid
from turtlebag.datasets.se2 import Array
from turtlebag.datasets.types import Trajectory
from turtlebag.reports.figures.maps import draw_grid, legend_above, map_figure, show_image, view_box
from turtlebag.reports.figures.style import MUTED, ODOMETRY, SLAM, new_figure
from turtlebag.reports.metrics.map import occupied

COLOUR_A, COLOUR_B = ODOMETRY, SLAM
LINE_A: dict[str, Any] = {"color": COLOUR_A, "linewidth": 3.0, "label": "A"}
LINE_B: dict[str, Any] = {"color": COLOUR_B, "linewidth": 1.2, "label": "B"}


def maps(a: OccupancyGrid, b: OccupancyGrid) -> Figure:
    """Occupied cells: grey where both agree, coloured where only one has them."""
    figure, axes = map_figure(view_box(a))
    for grid, other, colour in ((a, b, COLOUR_A), (b, a, COLOUR_B)):
        image = np.zeros((*grid.shape, 4))
        cells = np.argwhere(occupied(grid))
        agreed = other.value_at(grid.center_of(cells)) >= OCCUPIED_FROM
        for chosen, shade in ((cells[agreed], MUTED), (cells[~agreed], colour)):
            image[chosen[:, 0], chosen[:, 1]] = (*to_rgb(shade), 1.0)
        show_image(axes, image, grid)
    handles = [
        Patch(color=colour, label=label)
        for colour, label in ((MUTED, "both"), (COLOUR_A, "only A"), (COLOUR_B, "only B"))
    ]
    legend_above(axes, handles)
    return figure


def paths(ground: OccupancyGrid | None, a: Trajectory, b: Trajectory) -> Figure:
    """Both paths over a faint map."""
    figure, axes = map_figure(view_box(ground, [a, b]))
    if ground is not None:
        draw_grid(axes, ground, faint=True)
    axes.plot(a.poses.x, a.poses.y, **LINE_A)
    axes.plot(b.poses.x, b.poses.y, **LINE_B)
    legend_above(axes)
    return figure


def errors(a: tuple[Array, Array], b: tuple[Array, Array]) -> Figure:
    """Errors (seconds, metres) of both."""
    figure, axes = _time_axes()
    axes.plot(a[0], 100.0 * a[1], **{**LINE_A, "linewidth": 1.6})
    axes.plot(b[0], 100.0 * b[1], **LINE_B)
    legend_above(axes)
    axes.set_ylabel("position error [cm]")
    axes.set_ylim(bottom=0.0)
    return figure


def apart(time_s: Array, distance_m: Array) -> Figure:
    """Distance between two estimates of the same instants."""
    figure, axes = _time_axes()
    axes.plot(time_s, 100.0 * distance_m, color=SLAM, linewidth=1.2)
    axes.set_ylabel("A to B [cm]")
    axes.set_ylim(bottom=0.0)
    return figure


def _time_axes() -> tuple[Figure, Axes]:
    figure = new_figure(2.6)
    axes = figure.add_subplot()
    axes.set_xlabel("time [s]")
    return figure, axes
