"""A world from above: its true map at the height of a lidar, with what that lidar cannot see."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

from matplotlib.patches import Circle, Polygon

from turtlebag.datasets.grid import OccupancyGrid
from turtlebag.datasets.se2 import SE2, Array
from turtlebag.reports.figures.maps import draw_grid, draw_start, map_figure
from turtlebag.reports.figures.style import INK, ODOMETRY, save_png, styled


def draw_world(
    path: Path,
    title: str,
    grid: OccupancyGrid,
    spawn: SE2,
    hidden: Sequence[tuple[Array, tuple[float, float], float]],
    keepout: Sequence[Array] = (),
) -> None:
    """Write a PNG.

    `hidden` are solids below the robot's height that the lidar plane misses: outline (n, 2) or, for a
    cylinder, an empty outline with centre and radius. `keepout` are outlines (n, 2). All in metres.
    """
    with styled():
        figure, axes = map_figure(grid.extent())
        draw_grid(axes, grid)
        for outline, center, radius in hidden:
            patch = Circle(center, radius) if radius > 0.0 else Polygon(outline)
            patch.set(facecolor=ODOMETRY, edgecolor=ODOMETRY, alpha=0.7)
            axes.add_patch(patch)
        for outline in keepout:
            axes.add_patch(Polygon(outline, fill=False, edgecolor=INK, linestyle="--"))
        draw_start(axes, spawn)
        axes.set_title(title)
        save_png(figure, path)
