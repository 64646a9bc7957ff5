"""Maps, and what is drawn on them: paths, pose graphs, what a lidar cannot see."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any, NamedTuple, cast

import matplotlib
import numpy as np
from matplotlib.artist import Artist
from matplotlib.axes import Axes
from matplotlib.cm import ScalarMappable
from matplotlib.collections import LineCollection, PatchCollection
from matplotlib.colors import Normalize, to_rgb
from matplotlib.figure import Figure
from matplotlib.patches import Circle, Patch, Polygon
from matplotlib.patheffects import withStroke
from numpy.typing import NDArray

from turtlebag.datasets.grid import UNKNOWN, OccupancyGrid
from turtlebag.datasets.output_rules import PICTURE_MARK
from turtlebag.datasets.se2 import SE2, Array
from turtlebag.datasets.true_maps import TrueMap
from turtlebag.datasets.types import Trajectory
from turtlebag.reports.figures import style
from turtlebag.reports.g2o import LoopRecord, PoseGraph
from turtlebag.reports.metrics.map import map_error, occupied

Box = tuple[float, float, float, float]
ERROR_SCALE_M = 0.10
MARGIN_M = 0.3
MOST_PIXELS = 900


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
    width, extra = (style.WIDTH_IN - 1.35, 0.45) if bar else (style.WIDTH_IN - 0.5, 0.65)
    figure = style.new_figure(float(np.clip(shape * width, 2.0, 7.0)) + extra)
    axes = figure.add_subplot()
    frame(axes, box)
    return figure, axes


def faint_map(
    grid: OccupancyGrid | None, paths: Sequence[Trajectory | None], *, bar: bool = False
) -> tuple[Figure, Axes]:
    """A figure with room for the paths and the map, where there is one, in their background."""
    figure, axes = map_figure(view_box(grid, paths), bar=bar)
    if grid is not None:
        draw_grid(axes, grid, faint=True)
    return figure, axes


def frame(axes: Axes, box: Box) -> None:
    """Equal axes over the box, in metres."""
    style.bare(axes)
    axes.set_aspect("equal")
    axes.set_xlim(box[0], box[1])
    axes.set_ylim(box[2], box[3])
    axes.set_xlabel("x [m]")
    axes.set_ylabel("y [m]")


def draw_grid(axes: Axes, grid: OccupancyGrid, *, faint: bool = False) -> None:
    """Occupied ink, free paper, unknown ground; `faint` keeps it in the background of paths."""
    wall = "#9aa3ad" if faint else style.INK
    image = np.empty((*grid.shape, 3))
    image[:] = to_rgb(style.PAPER)
    image[grid.cells == UNKNOWN] = to_rgb(style.GROUND)
    image[occupied(grid)] = to_rgb(wall)
    image[round_cells(grid)] = to_rgb(style.PAPER)
    show_image(axes, image, grid)
    draw_circles(axes, grid, wall, style.GROUND)


def round_cells(grid: OccupancyGrid) -> NDArray[np.bool_]:
    """The cells (rows, cols) of the round solids of a true map, which `draw_circles` draws."""
    inside = np.zeros(grid.shape, dtype=bool)
    for *xy, radius in grid.circles.tolist() if isinstance(grid, TrueMap) else []:
        reach = radius + grid.resolution
        low, high = (grid.cell_of(np.add(xy, by)) for by in (-reach, reach))
        (row0, col0), (row1, col1) = np.clip([low, high + 1], 0, grid.shape)
        rows, cols = np.mgrid[row0:row1, col0:col1]
        off = np.abs(grid.center_of(np.stack([rows, cols], axis=-1)) - xy).max(axis=-1)
        inside[rows, cols] |= off <= reach
    return inside


def draw_circles(axes: Axes, grid: OccupancyGrid, edge: str, face: str) -> None:
    """The round solids of a true map, with an edge as wide as a cell inside their surface."""
    for x, y, radius in grid.circles.tolist() if isinstance(grid, TrueMap) else []:
        axes.add_patch(Circle((x, y), radius, facecolor=edge, edgecolor="none", zorder=0.5))
        if (hollow := radius - grid.resolution) > 0.0:
            axes.add_patch(Circle((x, y), hollow, facecolor=face, edgecolor="none", zorder=0.5))


def show_image(axes: Axes, image: NDArray[np.float64], grid: OccupancyGrid) -> None:
    """An image with one pixel a cell, row 0 lowest, where the grid lies."""
    by = -(-max(image.shape[:2]) // MOST_PIXELS)
    image, (x, _, y, _) = darkest(image, by), grid.extent()
    height, width = by * grid.resolution * np.array(image.shape[:2])
    extent = (x, x + width, y, y + height)
    artist = axes.imshow(np.clip(image, 0.0, 1.0), origin="lower", extent=extent, zorder=0.5)
    T = grid.T_map_grid
    if float(T.yaw) != 0.0:
        turn = matplotlib.transforms.Affine2D().rotate_around(float(T.x), float(T.y), float(T.yaw))
        artist.set_transform(turn + axes.transData)


def darkest(image: NDArray[np.float64], by: int) -> NDArray[np.float64]:
    """An image (rows, cols, 3 or 4) with a pixel for each block of `by` by `by`: the most opaque of them, of
    those the darkest, so that a wall of one cell stays in a picture that has no room for it."""
    if by == 1:
        return image
    rows, cols = (-(-n // by) * by for n in image.shape[:2])
    padded = np.pad(image, ((0, rows - image.shape[0]), (0, cols - image.shape[1]), (0, 0)), "edge")
    blocks = padded.reshape(rows // by, by, cols // by, by, -1).swapaxes(1, 2)
    blocks = blocks.reshape(rows // by, cols // by, by * by, -1)
    brightness = blocks[..., :3].sum(axis=-1) - (10.0 * blocks[..., 3] if blocks.shape[-1] == 4 else 0.0)
    return np.take_along_axis(blocks, brightness.argmin(axis=-1)[..., None, None], axis=2)[:, :, 0]


def draw_path(axes: Axes, trajectory: Trajectory | None, kind: str, **changes: Any) -> None:
    """A trajectory in its kind's colour and line."""
    if trajectory is not None and len(trajectory):
        axes.plot(trajectory.poses.x, trajectory.poses.y, zorder=2, **{**style.LINES[kind], **changes})


def map_over_truth(grid: OccupancyGrid, true_grid: OccupancyGrid) -> Figure:
    """Mapped occupied cells, coloured by their distance to the true surface, on the true map."""
    figure, axes = map_figure(view_box(grid), bar=True)
    solid = np.full((*true_grid.shape, 3), to_rgb(style.PAPER))
    solid[occupied(true_grid) & ~round_cells(true_grid)] = to_rgb("#ccd3db")
    show_image(axes, solid, true_grid)
    draw_circles(axes, true_grid, "#ccd3db", style.PAPER)
    error = map_error(grid, true_grid)
    norm = Normalize(0.0, 100.0 * ERROR_SCALE_M)
    image = np.zeros((*grid.shape, 4))
    cells = grid.cell_of(error.xy_mapped)
    image[cells[:, 0], cells[:, 1]] = style.FINE_TO_BAD(
        norm(100.0 * np.minimum(error.error_m, ERROR_SCALE_M))
    )
    show_image(axes, image, grid)
    add_scale(axes, ScalarMappable(norm, style.FINE_TO_BAD), "mapped cell to true surface [cm]", extend="max")
    return figure


def add_scale(axes: Axes, artist: ScalarMappable, label: str, *, extend: str = "neither") -> None:
    """A colour scale beside the axes."""
    figure = cast(Figure, axes.figure)
    bar = figure.colorbar(artist, ax=axes, shrink=0.7, pad=0.02, aspect=28, extend=extend)
    bar.set_label(label)
    bar.outline.set_visible(False)  # type: ignore[operator]


def plain_map(grid: OccupancyGrid, paths: Mapping[str, Trajectory | None]) -> Figure:
    """A map with paths on it."""
    figure, axes = map_figure(view_box(grid))
    draw_grid(axes, grid)
    for kind, trajectory in paths.items():
        draw_path(axes, trajectory, kind)
    if axes.get_lines():
        legend_above(axes)
    return figure


def trajectories(grid: OccupancyGrid | None, paths: Mapping[str, Trajectory | None]) -> Figure:
    """Paths of every kind given, over a faint map; start marked."""
    shown = {kind: path for kind, path in paths.items() if path is not None and len(path)}
    figure, axes = faint_map(grid, list(shown.values()))
    for kind, trajectory in shown.items():
        draw_path(axes, trajectory, kind)
    draw_start(axes, next(iter(shown.values())).poses[0])
    legend_above(axes)
    return figure


def plans(grid: OccupancyGrid | None, paths: Mapping[str, SE2]) -> Figure:
    """Several ways over one faint map, each in a colour and a line of its own; start and goal marked."""
    tracks = {name: Trajectory.untimed(poses) for name, poses in paths.items()}
    figure, axes = faint_map(grid, list(tracks.values()))
    for number, (name, track) in enumerate(tracks.items()):
        colour = style.series_colour(number)
        dashes = ("-", (0, (5, 2)), (0, (1, 1.5)))[number // len(style.SERIES) % 3]
        axes.plot(track.poses.x, track.poses.y, color=colour, linestyle=dashes, linewidth=1.5, label=name)
    first = next(iter(tracks.values())).poses
    draw_start(axes, first[0])
    axes.plot(first.x[-1], first.y[-1], "o", color=style.INK, markersize=6, zorder=5)
    figure.legend(loc="outside lower center", ncol=3, fontsize=8.5)
    figure.set_figheight(figure.get_figheight() + 0.2 * -(-len(tracks) // 3))
    return figure


def cloud_from_above(points: Array) -> Figure:
    """The highest of the points (n, 3) in each pixel, by its height over the lowest [m]."""
    low, high = points.min(axis=0), points.max(axis=0)
    pixel = max(float((high - low)[:2].max()) / MOST_PIXELS, 0.04)
    box = (low[0] - MARGIN_M, high[0] + MARGIN_M, low[1] - MARGIN_M, high[1] + MARGIN_M)
    figure, axes = map_figure(box, bar=True)
    image = heights(points, low[:2], pixel)
    floor, top = np.percentile(points[:, 2], [1.0, 99.5])
    norm = Normalize(0.0, max(float(top - floor), 0.1))
    colours = matplotlib.colormaps["viridis"].with_extremes(bad=(0.0, 0.0, 0.0, 0.0))
    extent = (low[0], low[0] + pixel * image.shape[1], low[1], low[1] + pixel * image.shape[0])
    shown = np.ma.masked_invalid(image - floor)
    artist = axes.imshow(
        shown, origin="lower", extent=extent, cmap=colours, norm=norm, interpolation="nearest"
    )
    add_scale(axes, artist, "height [m]")
    return figure


def heights(points: Array, corner: Array, pixel: float) -> Array:
    """Greatest z in each pixel, (rows, cols) from the corner (2,); NaN where there is no point."""
    cols, rows = np.floor((points[:, :2] - corner) / pixel).astype(np.int64).T
    image = np.full((int(rows.max()) + 1, int(cols.max()) + 1), -np.inf)
    np.maximum.at(image, (rows, cols), points[:, 2])
    return np.where(np.isfinite(image), image, np.nan)


def pose_graph(graph: PoseGraph, grid: OccupancyGrid | None, record: LoopRecord) -> Figure:
    """Keys in order as a thin line, loops as lines from blue (agrees) to orange (strained)."""
    keys = Trajectory.untimed(graph.T_map_keys)
    figure, axes = faint_map(grid, [keys], bar=True)
    axes.plot(keys.poses.x, keys.poses.y, "-", color=style.MUTED, linewidth=0.8, zorder=2)
    axes.plot(keys.poses.x, keys.poses.y, ".", color=style.MUTED, markersize=3, zorder=3)
    pairs, residual_m = record.kept(len(keys))
    order = np.argsort(residual_m, kind="stable")
    norm = Normalize(0.0, 100.0 * ERROR_SCALE_M)
    lines = LineCollection(list(keys.poses.xy[pairs[order]]), cmap=style.FINE_TO_BAD, norm=norm, zorder=4)
    lines.set(linewidths=1.8, alpha=0.8, rasterized=len(order) > 1500, array=100.0 * residual_m[order])
    axes.add_collection(lines)
    add_scale(axes, ScalarMappable(norm, style.FINE_TO_BAD), "residual of the loop [cm]", extend="max")
    return figure


class WorldSketch(NamedTuple):
    """What stands in a world, as sections with a plane: segments (n, 4) of outlines and circles (m, 3), x, y
    and radius, of what the lidar sees (`seen`), of what it misses but the robot touches (`missed`), and of
    what moves along paths (n, 2) from where they begin; `keepout` are outlines (n, 2). All in metres."""

    seen: Sequence[tuple[Array, Array]]
    missed: Sequence[tuple[Array, Array]]
    moving: Sequence[tuple[tuple[Array, Array], Array]]
    keepout: Sequence[Array]


def draw_world(path: Path, title: str, floor: OccupancyGrid, spawn: SE2, sketch: WorldSketch) -> None:
    """Write a PNG that carries our mark; `floor` tells the floor that can be reached from the rest."""
    with style.styled():
        figure, axes = map_figure(floor.extent())
        shade = np.full((*floor.shape, 3), to_rgb(style.PAPER))
        shade[floor.cells == UNKNOWN] = to_rgb(style.GROUND)
        show_image(axes, shade, floor)
        kinds: list[tuple[Any, str, Sequence[tuple[Array, Array]]]] = [
            ({"facecolor": style.INK, "edgecolor": style.INK}, "seen by the lidar", sketch.seen),
            ({"color": style.ODOMETRY, "alpha": 0.7}, "too low or too high for it", sketch.missed),
            ({"color": style.GOOD, "alpha": 0.9}, "moves along the line", [one for one, _ in sketch.moving]),
        ]
        handles: list[Artist] = []
        for look, label, sections in kinds:
            for segments, circles in sections:
                axes.add_collection(PatchCollection(_patches(segments, circles), linewidth=0.8, **look))
            if sections:
                handles.append(Patch(**look, label=label))
        for _, way in sketch.moving:
            axes.plot(*way.T, color=style.GOOD, linewidth=1.0, linestyle=":")
        for outline in sketch.keepout:
            axes.add_patch(Polygon(outline, fill=False, edgecolor=style.INK, linestyle="--"))
        if sketch.keepout:
            handles.append(Patch(fill=False, edgecolor=style.INK, linestyle="--", label="keep-out area"))
        draw_start(axes, spawn)
        axes.set_title(title)
        figure.legend(handles=handles, loc="outside lower center", ncol=2)
        figure.set_figheight(figure.get_figheight() + 0.25 * -(-len(handles) // 2))
        style.save_png(figure, path, PICTURE_MARK)


def _patches(segments: Array, circles: Array) -> list[Patch]:
    """Sections as filled shapes: circles, and the polygon of segments (n, 4) that join end to end; of others,
    as of a mesh, each line."""
    shapes: list[Patch] = [Circle((x, y), r) for x, y, r in circles]
    if len(segments) and np.allclose(segments[:, 2:], np.roll(segments[:, :2], -1, axis=0)):
        return [*shapes, Polygon(segments[:, :2])]
    return [*shapes, *(Polygon(line.reshape(2, 2), closed=False) for line in segments)]


def legend_above(axes: Axes, handles: Sequence[Artist] | None = None) -> None:
    """A legend in one line above the axes: of the handles, or of what has a label."""
    shown = {} if handles is None else {"handles": list(handles)}
    axes.legend(loc="lower left", bbox_to_anchor=(0.0, 1.0), ncol=4, borderaxespad=0.2, **shown)


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


def draw_start(axes: Axes, T_map_base: SE2) -> None:
    """Where a robot set out: an arrow with the word."""
    draw_pose(axes, T_map_base, style.INK)
    left = np.cos(float(T_map_base.yaw)) > 0.0
    axes.annotate(
        "start",
        (float(T_map_base.x), float(T_map_base.y)),
        xytext=(-5 if left else 5, 0),
        textcoords="offset points",
        ha="right" if left else "left",
        va="center",
        fontsize=8.5,
        color=style.INK,
        zorder=6,
        path_effects=[withStroke(linewidth=2.5, foreground=style.PAPER)],
    )


def scale_length(width_m: float) -> float:
    """The longest of 1, 2, 5, 10 ... that is at most 0.3 of a width [m]."""
    most = 0.3 * width_m
    decade = 10.0 ** np.floor(np.log10(most))
    return float(max(step * decade for step in (1.0, 2.0, 5.0) if step * decade <= most * (1.0 + 1e-9)))


def length_text(metres: float) -> str:
    """A length of a scale bar: `5 cm`, `2 m`."""
    return f"{100.0 * metres:g} cm" if metres < 1.0 else f"{metres:g} m"
