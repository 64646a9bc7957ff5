"""Two outputs in one picture: A purple, wide and below, B blue and above."""

from __future__ import annotations

from typing import Any

import numpy as np
from matplotlib.figure import Figure
from numpy.typing import NDArray

from turtlebag.datasets.grid import OCCUPIED_FROM, OccupancyGrid
from turtlebag.datasets.se2 import Array
from turtlebag.datasets.types import Trajectory
from turtlebag.reports.figures.maps import faint_map, legend_above, view_box, walls_of_both
from turtlebag.reports.figures.series import stacked
from turtlebag.reports.figures.style import MUTED, ODOMETRY, SLAM

COLOUR_A, COLOUR_B = ODOMETRY, SLAM
LINE_A: dict[str, Any] = {"color": COLOUR_A, "linewidth": 3.0, "label": "A"}
LINE_B: dict[str, Any] = {"color": COLOUR_B, "linewidth": 1.2, "label": "B"}


def maps(a: OccupancyGrid, b: OccupancyGrid) -> Figure:
    """Occupied cells: grey where both agree, coloured where only one has them."""

    def agree(points: Array, other: OccupancyGrid) -> NDArray[np.bool_]:
        return other.value_at(points) >= OCCUPIED_FROM

    words = (MUTED, "both"), (COLOUR_A, "only A"), (COLOUR_B, "only B")
    return walls_of_both([(a, b, COLOUR_A), (b, a, COLOUR_B)], agree, view_box(a), words)


def paths(ground: OccupancyGrid | None, a: Trajectory, b: Trajectory) -> Figure:
    """Both paths over a faint map."""
    figure, axes = faint_map(ground, [a, b])
    axes.plot(a.poses.x, a.poses.y, **LINE_A)
    axes.plot(b.poses.x, b.poses.y, **LINE_B)
    legend_above(axes)
    return figure


def errors(a: tuple[Array, Array], b: tuple[Array, Array]) -> Figure:
    """Errors (seconds, metres) of both."""
    figure, (axes,) = stacked(1, 2.6)
    axes.plot(a[0], 100.0 * a[1], **{**LINE_A, "linewidth": 1.6})
    axes.plot(b[0], 100.0 * b[1], **LINE_B)
    legend_above(axes)
    axes.set_ylabel("position error [cm]")
    axes.set_ylim(bottom=0.0)
    return figure


def apart(time_s: Array, distance_m: Array) -> Figure:
    """Distance between two estimates of the same instants."""
    figure, (axes,) = stacked(1, 2.6)
    axes.plot(time_s, 100.0 * distance_m, color=SLAM, linewidth=1.2)
    axes.set_ylabel("A to B [cm]")
    axes.set_ylim(bottom=0.0)
    return figure
