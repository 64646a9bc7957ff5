"""Maps and what was driven on them."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

import matplotlib
import numpy as np
from matplotlib.artist import Artist
from matplotlib.axes import Axes
from matplotlib.colors import Normalize, to_rgb
from matplotlib.figure import Figure
from matplotlib.lines import Line2D
from matplotlib.offsetbox import AnchoredText
from numpy.typing import NDArray

from datasets.grid import UNKNOWN, OccupancyGrid
from datasets.se2 import SE2, Array
from datasets.types import Trajectory
from reports.figures.style import (
    ACCENT,
    BAD,
    FINE_TO_BAD,
    GOOD,
    GROUND,
    INK,
    LINES,
    MUTED,
    PAPER,
    RULE,
    SLAM,
    WARN,
    WIDTH_IN,
    bare,
    new_figure,
)
from reports.metrics.map import map_error, occupied

RIVALS = (SLAM, BAD, GOOD, WARN, ACCENT, INK)
Box = tuple[float, float, float, float]
ERROR_SCALE_M = 0.10
MARGIN_M = 0.3
STATUS = {
    "reached": (GOOD, "o"),
    "timeout": (WARN, "s"),
    "unreachable": (BAD, "X"),
    "rejected": (MUTED, "X"),
    "collided": (BAD, "P"),
}


def view_box(grid: OccupancyGrid | None, trajectories: Sequence[Trajectory | None] = ()) -> Box:
    """(x0, x1, y0, y1) around occupied cells and paths, with a margin [m]."""
    points = [t.poses.xy for t in trajectories if t is not None and len(t)]
    if grid is not None:
        cells = np.argwhere(occupied(grid))
        points.append(grid.center_of(cells if len(cells) else np.array([[0, 0], grid.shape])))
    xy = np.concatenate(points)
    low, high = xy.min(axis=0) - MARGIN_M, xy.max(axis=0) + MARGIN_M
    return float(low[0]), float(high[0]), float(low[1]), float(high[1])


def map_figure(box: Box, *, bar: bool = False) -> tuple[Figure, Axes]:
    """A figure as tall as the box asks for, with bare, equal axes in metres; `bar`: room for a scale."""
    shape = (box[3] - box[2]) / max(box[1] - box[0], 1e-6)
    width, extra = (WIDTH_IN - 1.35, 0.45) if bar else (WIDTH_IN - 0.5, 0.65)
    figure = new_figure(float(np.clip(shape * width, 2.0, 7.0)) + extra)
    axes = figure.add_subplot()
    frame(axes, box)
    return figure, axes


def frame(axes: Axes, box: Box) -> None:
    """Equal axes over the box, in metres."""
    bare(axes)
    axes.set_aspect("equal")
    axes.set_xlim(box[0], box[1])
    axes.set_ylim(box[2], box[3])
    axes.set_xlabel("x [m]")
    axes.set_ylabel("y [m]")


def draw_grid(axes: Axes, grid: OccupancyGrid, *, faint: bool = False) -> None:
    """Occupied ink, free paper, unknown ground; `faint` keeps it in the background of paths."""
    image = np.empty((*grid.shape, 3))
    image[:] = to_rgb(PAPER)
    image[grid.cells == UNKNOWN] = to_rgb(GROUND)
    image[occupied(grid)] = to_rgb("#9aa3ad" if faint else INK)
    show_image(axes, image, grid)


def show_image(axes: Axes, image: NDArray[np.float64], grid: OccupancyGrid) -> None:
    """An image with one pixel a cell, row 0 lowest, where the grid lies."""
    artist = axes.imshow(np.clip(image, 0.0, 1.0), origin="lower", extent=grid.extent(), zorder=0.5)
    T = grid.T_map_grid
    if float(T.yaw) != 0.0:
        turn = matplotlib.transforms.Affine2D().rotate_around(float(T.x), float(T.y), float(T.yaw))
        artist.set_transform(turn + axes.transData)


def draw_path(axes: Axes, trajectory: Trajectory | None, kind: str, **changes: Any) -> None:
    """A trajectory in its kind's colour and line."""
    if trajectory is not None and len(trajectory):
        axes.plot(trajectory.poses.x, trajectory.poses.y, zorder=2, **{**LINES[kind], **changes})


def map_over_truth(grid: OccupancyGrid, true_grid: OccupancyGrid) -> Figure:
    """Mapped occupied cells, coloured by their distance to the true surface, on the true map."""
    figure, axes = map_figure(view_box(grid), bar=True)
    solid = np.full((*true_grid.shape, 3), to_rgb(PAPER))
    solid[occupied(true_grid)] = to_rgb("#ccd3db")
    show_image(axes, solid, true_grid)
    error = map_error(grid, true_grid)
    norm = Normalize(0.0, 100.0 * ERROR_SCALE_M)
    image = np.zeros((*grid.shape, 4))
    cells = grid.cell_of(error.xy_mapped)
    image[cells[:, 0], cells[:, 1]] = FINE_TO_BAD(norm(100.0 * np.minimum(error.error_m, ERROR_SCALE_M)))
    show_image(axes, image, grid)
    bar = figure.colorbar(
        matplotlib.cm.ScalarMappable(norm, FINE_TO_BAD),
        ax=axes,
        shrink=0.7,
        pad=0.02,
        extend="max",
        aspect=28,
    )
    bar.set_label("mapped cell to true surface [cm]")
    bar.outline.set_visible(False)  # type: ignore[operator]
    return figure


def plain_map(grid: OccupancyGrid, paths: Mapping[str, Trajectory | None]) -> Figure:
    """A map with paths on it."""
    figure, axes = map_figure(view_box(grid))
    draw_grid(axes, grid)
    for kind, trajectory in paths.items():
        draw_path(axes, trajectory, kind)
    legend_above(axes)
    return figure


def trajectories(grid: OccupancyGrid | None, paths: Mapping[str, Trajectory | None]) -> Figure:
    """Paths of every kind given, over a faint map; start marked."""
    shown = {kind: path for kind, path in paths.items() if path is not None and len(path)}
    figure, axes = map_figure(view_box(grid, list(shown.values())))
    if grid is not None:
        draw_grid(axes, grid, faint=True)
    for kind, trajectory in shown.items():
        draw_path(axes, trajectory, kind)
    start = next(iter(shown.values())).poses[0]
    draw_pose(axes, start, INK)
    legend_above(axes)
    return figure


def plans(grid: OccupancyGrid | None, paths: Mapping[str, SE2]) -> Figure:
    """Several ways over one faint map, each in a colour and a line of its own; start and goal marked."""
    tracks = {name: Trajectory(np.arange(len(p), dtype=np.int64), p) for name, p in paths.items()}
    figure, axes = map_figure(view_box(grid, list(tracks.values())))
    if grid is not None:
        draw_grid(axes, grid, faint=True)
    for number, (name, track) in enumerate(tracks.items()):
        colour = RIVALS[number % len(RIVALS)]
        dashes = ("-", (0, (5, 2)), (0, (1, 1.5)))[number // len(RIVALS) % 3]
        axes.plot(track.poses.x, track.poses.y, color=colour, linestyle=dashes, linewidth=1.5, label=name)
    first = next(iter(tracks.values())).poses
    draw_pose(axes, first[0], INK)
    axes.plot(first.x[-1], first.y[-1], "o", color=INK, markersize=6, zorder=5)
    figure.legend(loc="outside lower center", ncol=3, fontsize=8.5)
    figure.set_figheight(figure.get_figheight() + 0.2 * -(-len(tracks) // 3))
    return figure


def legend_above(axes: Axes, handles: Sequence[Artist] | None = None) -> None:
    """A legend in one line above the axes."""
    options: dict[str, Any] = {
        "loc": "lower left",
        "bbox_to_anchor": (0.0, 1.0),
        "ncol": 4,
        "borderaxespad": 0.2,
    }
    if handles is None:
        axes.legend(**options)
    else:
        axes.legend(handles=list(handles), **options)


def draw_pose(axes: Axes, T_map_base: SE2, colour: str, length_m: float = 0.3) -> None:
    """An arrow at a pose."""
    tip = T_map_base @ np.array([length_m, 0.0])
    axes.annotate(
        "",
        xy=(float(tip[0]), float(tip[1])),
        xytext=(float(T_map_base.x), float(T_map_base.y)),
        arrowprops={"arrowstyle": "-|>", "color": colour, "linewidth": 1.4, "shrinkA": 0, "shrinkB": 0},
        zorder=4,
    )


def patrol(
    grid: OccupancyGrid | None,
    truth: Trajectory | None,
    estimate: Trajectory | None,
    goals: Sequence[Mapping[str, Any]],
    contacts_xy: Array,
) -> Figure:
    """What a run drove: true and estimated path on the map, goals numbered and coloured by status."""
    box = view_box(grid, [truth, estimate])
    figure, axes = map_figure(box)
    if grid is not None:
        draw_grid(axes, grid)
    draw_path(axes, truth, "truth", color="#56b4e9", linewidth=2.6, label="true path")
    draw_path(axes, estimate, "amcl", linewidth=1.0)
    used = _draw_goals(axes, goals)
    handles = [line for line in axes.get_lines() if not str(line.get_label()).startswith("_")]
    handles += [_marker(status) for status in STATUS if status in used]
    if len(contacts_xy):
        marks = axes.plot(*contacts_xy.T, "*", color=BAD, markersize=9, label="contact", zorder=6)
        handles += marks
    legend_above(axes, handles)
    return figure


def _draw_goals(axes: Axes, goals: Sequence[Mapping[str, Any]]) -> set[str]:
    used = set()
    for number, goal in enumerate(goals, start=1):
        x, y = goal.get("x"), goal.get("y")
        if not isinstance(x, (int, float)) or not isinstance(y, (int, float)):
            continue
        status = str(goal.get("status"))
        colour, marker = STATUS.get(status, (MUTED, "o"))
        used.add(status)
        axes.plot(x, y, marker, color=colour, markersize=13, markeredgecolor=PAPER, zorder=5)
        axes.annotate(
            str(number), (x, y), color=PAPER, fontsize=7.5, ha="center", va="center", weight="bold", zorder=6
        )
    return used


def _marker(status: str) -> Line2D:
    colour, marker = STATUS[status]
    return Line2D([], [], linestyle="none", marker=marker, color=colour, markersize=8, label=status)


def clearance_on_map(grid: OccupancyGrid | None, truth: Trajectory, clearance_m: Array) -> Figure:
    """The true path coloured by the footprint's clearance; the nearest place is named."""
    figure, axes = map_figure(view_box(grid, [truth]), bar=True)
    if grid is not None:
        draw_grid(axes, grid, faint=True)
    finite = np.where(np.isfinite(clearance_m), clearance_m, np.nan)
    points = axes.scatter(
        truth.poses.x,
        truth.poses.y,
        c=100.0 * finite,
        s=5,
        cmap=FINE_TO_BAD.reversed(),
        vmin=0.0,
        zorder=3,
        rasterized=True,
    )
    bar = figure.colorbar(points, ax=axes, shrink=0.7, pad=0.02, aspect=28)
    bar.set_label("clearance [cm]")
    bar.outline.set_visible(False)  # type: ignore[operator]
    if np.isfinite(finite).any():
        nearest = int(np.nanargmin(finite))
        axes.plot(truth.poses.x[nearest], truth.poses.y[nearest], "v", color=BAD, markersize=8, zorder=5)
        note = AnchoredText(
            f"▼ least: {100.0 * finite[nearest]:.1f} cm", "lower left", frameon=False, pad=0.2
        )
        axes.add_artist(note)
    return figure


def particles(
    grid: OccupancyGrid | None, clouds: Sequence[tuple[float, SE2]], truth: Trajectory | None
) -> Figure:
    """Snapshots of the particle cloud (seconds since the start, poses), each zoomed to its own spread."""
    whole = view_box(grid, [])
    columns = min(3, len(clouds))
    rows = -(-len(clouds) // columns)
    figure = new_figure((WIDTH_IN / columns + 0.25) * rows)
    for index, (time_s, cloud) in enumerate(clouds):
        axes = figure.add_subplot(rows, columns, index + 1)
        T_world_base = None
        if truth is not None:
            T_world_base = truth.at(np.array([round(time_s * 1e9) + int(truth.stamps_ns[0])]))[0]
        box = zoom_box(cloud, T_world_base, whole)
        frame(axes, box)
        axes.set(xlabel="", ylabel="", xticks=[], yticks=[])
        for spine in axes.spines.values():
            spine.set(visible=True, color=RULE)
        if grid is not None:
            draw_grid(axes, grid, faint=True)
        _draw_cloud(axes, cloud, box)
        if T_world_base is not None:
            draw_pose(axes, T_world_base, INK, 0.12 * (box[1] - box[0]))
            axes.plot(T_world_base.x, T_world_base.y, "o", color=INK, markersize=4, zorder=4)
        axes.set_title(f"{time_s:.0f} s · view {box[1] - box[0]:.1f} m wide", fontsize=8.5)
    return figure


def zoom_box(cloud: SE2, T_world_base: SE2 | None, whole: Box) -> Box:
    """A square around cloud and true pose, at least 1.6 m wide and at most as wide as the whole map."""
    xy = cloud.xy if T_world_base is None else np.concatenate([cloud.xy, T_world_base.xy[None]])
    low, high = xy.min(axis=0), xy.max(axis=0)
    widest = max(whole[1] - whole[0], whole[3] - whole[2])
    half = 0.5 * float(np.clip(1.3 * (high - low).max(), 1.6, max(widest, 1.6)))
    x, y = (low + high) / 2.0
    if 2.0 * half >= widest:
        x, y = (whole[0] + whole[1]) / 2.0, (whole[2] + whole[3]) / 2.0
    return float(x - half), float(x + half), float(y - half), float(y + half)


def _draw_cloud(axes: Axes, cloud: SE2, box: Box) -> None:
    """Particles as dots with a tail of heading, at most 300 of them."""
    few = cloud[:: max(1, len(cloud) // 300)]
    length = 0.03 * (box[1] - box[0])
    colour = LINES["amcl"]["color"]
    axes.quiver(
        few.x,
        few.y,
        length * np.cos(few.yaw),
        length * np.sin(few.yaw),
        angles="xy",
        scale_units="xy",
        scale=1.0,
        width=0.004,
        color=colour,
        alpha=0.6,
        zorder=3,
        rasterized=True,
    )
