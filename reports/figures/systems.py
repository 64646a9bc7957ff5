"""Several systems in one picture: ours blue, each other in a colour of its own."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import numpy as np
from matplotlib.colors import to_rgb
from matplotlib.figure import Figure
from matplotlib.patches import Patch

from turtlebag.datasets.grid import OccupancyGrid
from turtlebag.datasets.other_systems import gaps
from turtlebag.datasets.se2 import Array
from turtlebag.datasets.types import Stamps, Trajectory
from turtlebag.reports.figures import maps
from turtlebag.reports.figures.series import error_axis, stacked
from turtlebag.reports.figures.style import MUTED, series_colour
from turtlebag.reports.metrics.map import occupied, walls_in


def paths(
    ground: OccupancyGrid | None, truth: Trajectory | None, systems: Mapping[str, Trajectory]
) -> Figure:
    """Paths over a faint map, the truth as a wide band beneath."""
    figure, axes = maps.faint_map(ground, [*systems.values(), truth])
    maps.draw_path(axes, truth, "truth")
    for number, (name, path) in enumerate(systems.items()):
        xy = _broken(path.stamps_ns, path.poses.xy)
        width = 2.0 if number == 0 and truth is None else 1.2
        axes.plot(xy[:, 0], xy[:, 1], color=series_colour(number), linewidth=width, label=name, zorder=2)
    maps.legend_above(axes)
    return figure


def errors(systems: Mapping[str, tuple[Stamps, Array]], names: Sequence[str], label: str) -> Figure:
    """Distances over the time since the first of all stamps; `names` give each system its colour."""
    figure, (axes,) = stacked(1, 2.8, legend=True)
    start = min(int(stamps[0]) for stamps, _ in systems.values())
    for name, (stamps, distance) in systems.items():
        line = _broken(stamps, np.stack([(stamps - start) * 1e-9, 100.0 * distance], axis=1))
        axes.plot(line[:, 0], line[:, 1], color=series_colour(names.index(name)), linewidth=1.2, label=name)
    axes.set_ylabel(label)
    error_axis(axes)
    maps.legend_above(axes)
    return figure


def walls(a: OccupancyGrid, b: OccupancyGrid, names: tuple[str, str], number: int = 1) -> Figure:
    """Occupied cells of both: grey where the other has one within a cell, else in the system's colour; that
    of the second by its number."""
    x0, x1, y0, y1 = zip(maps.view_box(a), maps.view_box(b), strict=True)
    figure, axes = maps.map_figure((min(x0), max(x1), min(y0), max(y1)))
    of_a, of_b = series_colour(0), series_colour(number)
    for grid, other, colour in ((b, a, of_b), (a, b, of_a)):
        image = np.zeros((*grid.shape, 4))
        cells, shared = np.argwhere(occupied(grid)), walls_in(grid, other)
        for chosen, shade in ((cells[shared], MUTED), (cells[~shared], colour)):
            image[chosen[:, 0], chosen[:, 1]] = (*to_rgb(shade), 1.0)
        maps.show_image(axes, image, grid)
    words = ("both", MUTED), (f"only {names[0]}", of_a), (f"only {names[1]}", of_b)
    maps.legend_above(axes, [Patch(color=colour, label=word) for word, colour in words])
    return figure


def _broken(stamps_ns: Stamps, values: Array) -> Array:
    """Points of a line, (n, 2), with a break in every gap of its stamps."""
    order = np.argsort(stamps_ns, kind="stable")
    stamps, values = stamps_ns[order], values[order].astype(np.float64)
    ends = [int(np.searchsorted(stamps, end)) for _, end in gaps(stamps)]
    return np.insert(values, ends, np.nan, axis=0)
