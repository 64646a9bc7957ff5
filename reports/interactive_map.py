"""A map that answers to the mouse: an SVG in world metres that the page's script reads coordinates from."""

from __future__ import annotations

import io
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from PIL import Image

from turtlebag.datasets.grid import FREE, FREE_TO, OccupancyGrid
from turtlebag.datasets.types import Trajectory
from turtlebag.reports.figures.album import data_address
from turtlebag.reports.metrics.map import occupied
from turtlebag.reports.metrics.navigation import placed_goals, truly_reached

PIXELS = {"occupied": 28, "unknown": 224, "free": 254}
SPACING_M = 0.02


@dataclass(frozen=True, eq=False)
class InteractiveMap:
    """What the template needs: image, its place, the view, the lines drawn over it, and goals with how they
    truly ended.
    """

    image: str
    grid: OccupancyGrid
    view: str
    width_m: float
    lines: list[tuple[str, str, str]]
    goals: list[tuple[float, float, int, str]]


def interactive_map(
    grid: OccupancyGrid,
    paths: Mapping[str, tuple[str, Trajectory | None]],
    goals: Sequence[Mapping[str, Any]],
) -> InteractiveMap:
    """The map with paths (label -> (css class, poses)) and goals, ready for the template."""
    x0, x1, y0, y1 = _known_box(grid)
    lines = [
        (label, kind, _points(path))
        for label, (kind, path) in paths.items()
        if path is not None and len(path)
    ]
    marks = [
        (float(x), float(y), number, "good" if truly_reached(goal) else "bad")
        for number, x, y, goal in placed_goals(goals)
    ]
    return InteractiveMap(
        image=_png(grid),
        grid=grid,
        view=f"{x0:.3f} {-y1:.3f} {x1 - x0:.3f} {y1 - y0:.3f}",
        width_m=x1 - x0,
        lines=lines,
        goals=marks,
    )


def _known_box(grid: OccupancyGrid) -> tuple[float, float, float, float]:
    """Bounds of everything known, with a margin [m]."""
    known = np.argwhere(grid.cells >= FREE)
    xy = grid.center_of(known if len(known) else np.array([[0, 0], grid.shape]))
    (x0, y0), (x1, y1) = xy.min(axis=0) - 0.25, xy.max(axis=0) + 0.25
    return float(x0), float(x1), float(y0), float(y1)


def _png(grid: OccupancyGrid) -> str:
    """The grid as a PNG in a data address, row 0 at the bottom."""
    pixels = np.full(grid.shape, PIXELS["unknown"], dtype=np.uint8)
    pixels[(grid.cells >= FREE) & (grid.cells <= FREE_TO)] = PIXELS["free"]
    pixels[occupied(grid)] = PIXELS["occupied"]
    buffer = io.BytesIO()
    Image.fromarray(pixels[::-1]).save(buffer, format="PNG", optimize=True)
    return data_address("png", buffer.getvalue())


def _points(path: Trajectory) -> str:
    """SVG points (y down) of a path, at least SPACING_M apart."""
    kept = [path.poses.xy[0]]
    for point in path.poses.xy[1:]:
        if np.hypot(*(point - kept[-1])) >= SPACING_M:
            kept.append(point)
    return " ".join(f"{x:.3f},{-y:.3f}" for x, y in kept)
