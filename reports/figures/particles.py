"""Snapshots of the particle cloud, each zoomed to the cloud."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.patheffects import withStroke

from turtlebag.datasets.grid import OccupancyGrid
from turtlebag.datasets.se2 import SE2, Array
from turtlebag.datasets.types import Trajectory
from turtlebag.reports.figures import maps
from turtlebag.reports.figures.style import BAD, INK, LINES, PAPER, RULE, WIDTH_IN, new_figure

LEAST_M = 0.2
"""A view is at least this wide."""
MIDDLE = (2.0, 98.0)
"""Percentiles of the particles that a view holds: one that strayed does not widen it."""
NEAR = 3.0
"""A true pose this many half views from the cloud's middle is taken into view."""
MOST_DRAWN = 400


def particles(
    grid: OccupancyGrid | None, clouds: Sequence[tuple[float, SE2]], truth: Trajectory | None
) -> Figure:
    """Snapshots of the cloud (seconds since the start, poses); the true pose as an arrow, or where it is."""
    whole = maps.view_box(grid, [truth])
    columns = min(3, len(clouds))
    rows = -(-len(clouds) // columns)
    figure = new_figure((WIDTH_IN / columns + 0.25) * rows)
    for index, (time_s, cloud) in enumerate(clouds):
        axes = figure.add_subplot(rows, columns, index + 1)
        T_world_base = None
        if truth is not None:
            T_world_base = truth.at(np.array([round(time_s * 1e9) + int(truth.stamps_ns[0])]))[0]
        box = zoom_box(cloud, T_world_base, whole)
        maps.frame(axes, box)
        axes.set(xlabel="", ylabel="", xticks=[], yticks=[])
        for spine in axes.spines.values():
            spine.set(visible=True, color=RULE)
        if grid is not None:
            maps.draw_grid(axes, grid, faint=True)
        _draw_cloud(axes, cloud, box)
        if T_world_base is not None:
            _draw_truth(axes, T_world_base, box)
        _scale_bar(axes, box)
        axes.set_title(f"{time_s:.0f} s", fontsize=9)
    return figure


def zoom_box(cloud: SE2, T_world_base: SE2 | None, whole: maps.Box) -> maps.Box:
    """A square around the cloud, and the true pose when that is near; at most as wide as the whole map."""
    low, high = np.percentile(cloud.xy, MIDDLE, axis=0)
    middle = (low + high) / 2.0
    half = max(0.7 * float((high - low).max()), 0.5 * LEAST_M)
    if T_world_base is not None:
        away = float(np.abs(T_world_base.xy - middle).max())
        half = max(half, 1.3 * away) if away <= NEAR * half else half
    widest = max(whole[1] - whole[0], whole[3] - whole[2])
    if 2.0 * half >= widest:
        half, middle = 0.5 * widest, np.array([whole[0] + whole[1], whole[2] + whole[3]]) / 2.0
    x, y = middle.tolist()
    return x - half, x + half, y - half, y + half


def _draw_cloud(axes: Axes, cloud: SE2, box: maps.Box) -> None:
    """Particles as dots with a tail of heading, at most MOST_DRAWN of them."""
    few = cloud[:: -(-len(cloud) // MOST_DRAWN)]
    length = 0.06 * (box[1] - box[0])
    axes.quiver(
        few.x,
        few.y,
        length * np.cos(few.yaw),
        length * np.sin(few.yaw),
        angles="xy",
        scale_units="xy",
        scale=1.0,
        width=0.005,
        color=LINES["amcl"]["color"],
        alpha=0.6,
        zorder=3,
        rasterized=True,
    )


def _draw_truth(axes: Axes, T_world_base: SE2, box: maps.Box) -> None:
    """The true pose; where it lies out of view, an arrow at the border that says how far it is."""
    width = box[1] - box[0]
    middle = np.array([box[0] + box[1], box[2] + box[3]]) / 2.0
    if np.abs(T_world_base.xy - middle).max() <= 0.5 * width:
        maps.draw_pose(axes, T_world_base, INK, 0.18 * width)
        axes.plot(T_world_base.x, T_world_base.y, "o", color=INK, markersize=4, zorder=4)
        return
    away: Array = T_world_base.xy - middle
    distance = float(np.linalg.norm(away))
    yaw = float(np.arctan2(away[1], away[0]))
    towards = SE2.from_xyt(float(middle[0]), float(middle[1]), yaw)
    maps.draw_pose(axes, towards @ SE2.from_xyt(0.25 * width, 0.0, 0.0), BAD, 0.2 * width)
    _note(axes, 0.95, f"truth {distance:.1f} m away", "top", BAD)


def _scale_bar(axes: Axes, box: maps.Box) -> None:
    """A bar with its length in the lower left corner."""
    width = box[1] - box[0]
    length = maps.scale_length(width)
    x, y = box[0] + 0.05 * width, box[2] + 0.05 * width
    outline = [withStroke(linewidth=4.0, foreground=PAPER)]
    axes.plot(
        [x, x + length],
        [y, y],
        color=INK,
        linewidth=2.0,
        solid_capstyle="butt",
        path_effects=outline,
        zorder=6,
    )
    _note(axes, 0.08, maps.length_text(length), "bottom", INK)


def _note(axes: Axes, height: float, text: str, side: str, colour: str) -> None:
    axes.text(
        0.05,
        height,
        text,
        transform=axes.transAxes,
        va=side,
        fontsize=8,
        color=colour,
        zorder=6,
        path_effects=[withStroke(linewidth=2.5, foreground=PAPER)],
    )
