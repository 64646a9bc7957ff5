"""A world from above: its true map at the height of a lidar, with what that lidar cannot see."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

import numpy as np
from matplotlib.patches import Circle, Polygon

from turtlebag.datasets.grid import OccupancyGrid
from turtlebag.datasets.se2 import SE2, Array
from turtlebag.reports.figures.style import INK, ODOMETRY, SLAM, new_figure
from turtlebag.reports.metrics.map import occupied


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
    x_min, x_max, y_min, y_max = grid.extent()
    width = 10.0
    height = min(max(width * (y_max - y_min) / (x_max - x_min), 3.0), 20.0)
    figure = new_figure(height + 0.6, width_in=width)
    axes = figure.add_subplot()
    shades = np.where(grid.cells < 0, 0.75, np.where(occupied(grid), 0.0, 1.0))
    axes.imshow(
        shades, cmap="gray", vmin=0.0, vmax=1.0, origin="lower", extent=grid.extent(), interpolation="nearest"
    )
    for outline, center, radius in hidden:
        patch = Circle(center, radius) if radius > 0.0 else Polygon(outline)
        patch.set(facecolor=ODOMETRY, edgecolor=ODOMETRY, alpha=0.7)
        axes.add_patch(patch)
    for outline in keepout:
        axes.add_patch(Polygon(outline, fill=False, edgecolor=INK, linestyle="--"))
    x, y, yaw = spawn.xyt.tolist()
    axes.plot(x, y, "o", color=SLAM)
    axes.annotate(
        "spawn",
        (x + 0.6 * np.cos(yaw), y + 0.6 * np.sin(yaw)),
        (x, y),
        arrowprops={"arrowstyle": "->", "color": SLAM},
        color=SLAM,
        va="top",
    )
    axes.set(title=title, xlabel="x [m]", ylabel="y [m]")
    # Without metadata the PNG's bytes depend on the picture alone.
    figure.savefig(path, format="png", dpi=100, metadata={"Software": None})
