"""Small animations: a map growing, a robot on its way.

Below each picture a strip with the simulated time and a scale bar.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np
import scipy
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.colors import to_rgb
from matplotlib.figure import Figure
from matplotlib.patches import Polygon
from numpy.typing import NDArray
from PIL import Image, ImageDraw

from turtlebag.datasets.deskew import deskewed
from turtlebag.datasets.grid import OccupancyGrid
from turtlebag.datasets.se2 import SE2, Array
from turtlebag.datasets.types import Recording, Trajectory
from turtlebag.reports.figures import style
from turtlebag.reports.figures.maps import Box, draw_grid, length_text, scale_length, view_box
from turtlebag.reports.metrics.navigation import placed_goals, truly_reached

PICTURE_PX, STRIP_PX, DPI = 380, 22, 100
FRAMES, FPS, HOLD = 60, 10, 25
"""The last frame stays for so many more."""
SCANS = 1000
"""No more than about this many scans are drawn."""
PATH_POINTS = 2000
FAN_M = 30.0
WALL_SHARE = 0.4
"""A cell is a wall when more than this share of the scans that saw it met something there. What happened in
it less than this often for each hit of a cell beside it does not count: noise is wider than walls."""
UNSEEN, FREE, WALL = range(3)
GROUNDS = np.array([to_rgb(colour) for colour in (style.GROUND, style.PAPER, "#3c444d")])


class Screen:
    """A figure over a box of the world, with a robot in it, and the strip below."""

    def __init__(self, box: Box) -> None:
        width, height = box[1] - box[0], box[3] - box[2]
        self.scale = PICTURE_PX / max(width, height)
        """Pixels a metre."""
        self.box = box
        self.size = max(1, round(width * self.scale)), max(1, round(height * self.scale))
        """Width and height of the picture above the strip [pixels]."""
        whole = self.size[1] + STRIP_PX
        size = self.size[0] / DPI, whole / DPI
        self.figure = Figure(figsize=size, dpi=DPI, facecolor=style.PAPER)
        self._canvas = FigureCanvasAgg(self.figure)
        self.axes = self.figure.add_axes((0.0, STRIP_PX / whole, 1.0, self.size[1] / whole))
        self.axes.set(xlim=box[:2], ylim=box[2:], xticks=[], yticks=[], facecolor=style.GROUND)
        self.axes.grid(False)
        self.axes.spines[:].set_visible(False)
        self._robot = Polygon(np.zeros((1, 2)), facecolor=style.INK, zorder=6)
        self.axes.add_patch(self._robot)
        self._clock = self._strip(whole)

    def _strip(self, whole: int) -> Any:
        """The scale bar; returns the text of the clock."""
        pixel, middle = 1.0 / self.size[0], 0.5 * STRIP_PX / whole
        length = scale_length(self.box[1] - self.box[0])
        left, right = 6.0 * pixel, 1.0 - 6.0 * pixel
        begin, half = right - length * self.scale * pixel, 1.5 / whole
        told: dict[str, Any] = {"color": style.INK, "fontsize": 9, "va": "center"}
        low, high = middle - half, middle + half
        bar = Polygon([(begin, low), (right, low), (right, high), (begin, high)], facecolor=style.INK)
        bar.set_transform(self.figure.transFigure)
        self.figure.add_artist(bar)
        self.figure.text(begin - left, middle, length_text(length), ha="right", **told)
        return self.figure.text(left, middle, "", **told)

    def show(self, T_map_base: SE2, seconds: float) -> None:
        """The robot is there, a triangle that points where it looks, at that time since the start."""
        length = 0.03 * self.size[0] / self.scale
        shape = length * np.array([[1.0, 0.0], [-0.7, 0.6], [-0.4, 0.0], [-0.7, -0.6]])
        self._robot.set_xy(T_map_base @ shape)
        self._clock.set_text(f"{seconds:.1f} s")

    def write(self, path: Path, draw: Callable[[int], None], count: int) -> None:
        """A looping GIF of frames evenly over `count` samples, each drawn by its number; the last stays."""
        frames = []
        with style.styled():
            for k in np.linspace(0, count - 1, FRAMES).astype(int).tolist():
                draw(k)
                self._canvas.draw()
                frames.append(np.array(self._canvas.buffer_rgba())[:, :, :3])
        # one palette for all: finding one takes longer than drawing
        palette = Image.fromarray(np.concatenate(frames[:: -FRAMES // 5])).quantize()
        images = [Image.fromarray(f).quantize(palette=palette, dither=Image.Dither.NONE) for f in frames]
        ms = [1000 // FPS] * (FRAMES - 1) + [1000 // FPS * (1 + HOLD)]
        images[0].save(path, save_all=True, append_images=images[1:], duration=ms, loop=0)


def write_mapping(
    path: Path, recording: Recording, slam: Trajectory, odometry: Trajectory | None, grid: OccupancyGrid
) -> None:
    """A GIF of a map that grows scan by scan; SLAM's path blue, the odometry's purple."""
    screen = Screen(view_box(grid))
    seen = GrowingMap(screen.box, max(grid.resolution, 1.0 / screen.scale))
    picture = screen.axes.imshow(GROUNDS[seen.shades()], origin="lower", extent=screen.box, aspect="auto")
    [wheels] = screen.axes.plot([], [], color=style.ODOMETRY, linewidth=1.0)
    [own] = screen.axes.plot([], [], color=style.SLAM, linewidth=1.4)
    stride = max(2, len(recording) // SCANS)
    done = 0

    def draw(last: int) -> None:
        nonlocal done
        for k in range(done, last + 1, stride):
            seen.add(recording, k, beams_in_map(recording, slam, k))
        done = last + 1
        picture.set_data(GROUNDS[seen.shades()])
        if odometry is not None:
            until = int(np.searchsorted(odometry.stamps_ns, slam.stamps_ns[last], side="right"))
            wheels.set_data(*odometry.poses.xy[:until][:: max(1, until // PATH_POINTS)].T)
        own.set_data(*slam.poses.xy[: last + 1].T)
        screen.show(slam.poses[last], float(slam.stamps_ns[last] - slam.stamps_ns[0]) * 1e-9)

    screen.write(path, draw, len(recording))


def beams_in_map(recording: Recording, path: Trajectory, k: int) -> tuple[Array, Array]:
    """Origins and unit directions (n_beams, 2) of the scan at `path`'s pose k, in that path's frame.

    A lidar that turns while the robot does sees a turned room; the base moves on to the pose of scan k + 1.
    """
    mounted, T_map_base = recording.lidars[recording.lidar_of[k]], path.poses[k]
    lidar = mounted.spec
    motion, step_s = SE2.identity(1), math.inf
    if k + 1 < len(path) and path.stamps_ns[k + 1] > path.stamps_ns[k]:
        motion = T_map_base.inverse() @ path.poses[k + 1 : k + 2]
        step_s = float(path.stamps_ns[k + 1] - path.stamps_ns[k]) * 1e-9
    fractions = lidar.order * abs(lidar.time_increment) / step_s
    origins, directions = deskewed(lidar.directions, fractions, mounted.T_base_lidar.xyt, motion.xyt)
    return T_map_base @ origins, SE2.from_xyt(0.0, 0.0, T_map_base.yaw) @ directions


class GrowingMap:
    """How many scans hit each cell over a box, and how many saw through it; row 0 is lowest."""

    def __init__(self, box: Box, cell_m: float) -> None:
        self._corner, self._cell_m = np.array([box[0], box[2]]), cell_m
        columns, rows = (max(1, round((high - low) / cell_m)) for low, high in (box[:2], box[2:]))
        self._hits, self._free = (np.zeros((rows, columns), dtype=np.int32) for _ in range(2))

    def add(self, recording: Recording, k: int, beams: tuple[Array, Array]) -> None:
        """Count one scan. A beam is a wedge up to half a cell before its hit; a silent one says nothing."""
        scan, (origins, directions) = recording.scan(k), beams
        lidar, hit = scan.lidar, scan.valid()
        ranges = np.where(hit, np.minimum(np.nan_to_num(scan.ranges.astype(np.float64)), FAN_M), 0.0)
        rows, columns = self._hits.shape
        seen = Image.new("1", (columns, rows))
        reach = np.maximum(ranges - 0.5 * self._cell_m, 0.0)[:, None]
        half = 0.5 * lidar.angle_increment
        edges = [origins + (SE2.from_xyt(0.0, 0.0, turn) @ directions) * reach for turn in (-half, half)]
        fan = np.concatenate([origins[:1], np.stack(edges, axis=1).reshape(-1, 2)])
        ImageDraw.Draw(seen).polygon(list(map(tuple, self._cells(fan).tolist())), fill=1)
        ends = (origins + directions * ranges[:, None])[hit & (ranges < FAN_M)]
        column, row = np.floor(self._cells(ends)).astype(np.int64).T
        inside = (column >= 0) & (column < columns) & (row >= 0) & (row < rows)
        met = np.zeros_like(self._hits, dtype=bool)
        met[row[inside], column[inside]] = True
        self._hits += met
        self._free += np.asarray(seen) & ~met

    def _cells(self, xy: Array) -> Array:
        """Column and row of points (n, 2) [m], with fractions."""
        return (xy - self._corner) / self._cell_m

    def shades(self) -> NDArray[np.uint8]:
        """The map so far (rows, columns): UNSEEN, FREE or WALL."""
        hits, free = self._hits, self._free
        most = WALL_SHARE * scipy.ndimage.maximum_filter(hits, size=3)
        shades = np.where(free > most, FREE, UNSEEN).astype(np.uint8)
        shades[(hits > WALL_SHARE * (hits + free)) & (hits >= most)] = WALL
        return shades


def write_run(
    path: Path,
    grid: OccupancyGrid | None,
    truth: Trajectory,
    goal_index: NDArray[np.int64],
    goals: Sequence[Mapping[str, Any]],
    recording: Recording | None,
    scans_at: Trajectory | None,
) -> None:
    """A GIF of a drive: the true path so far, the goal pursued, the scan where `scans_at` puts it."""
    screen = Screen(view_box(grid, [truth]))
    if grid is None:
        screen.axes.set_facecolor(style.PAPER)
    else:
        draw_grid(screen.axes, grid)
    places = list(placed_goals(goals))
    radius = 0.04 * screen.size[0] * 72 / DPI
    marks = [screen.axes.plot(x, y, "o", markersize=radius, zorder=4, mew=0)[0] for _, x, y, _ in places]
    [driven] = screen.axes.plot([], [], color=style.TRUTH, linewidth=3.0)
    [scan] = screen.axes.plot([], [], "s", color=style.GOOD, markersize=1.3, mew=0, zorder=5)

    def draw(row: int) -> None:
        driven.set_data(*truth.poses.xy[: row + 1][::5].T)
        if recording is not None and scans_at is not None:
            scan.set_data(*_scan_ends(recording, scans_at, int(truth.stamps_ns[row])).T)
        so_far = int(goal_index[: row + 1].max())
        pursued = int(goal_index[row]) if row < len(truth) - 1 else -1
        for mark, (number, _, _, goal) in zip(marks, places, strict=True):
            mark.set_color(_goal_colour(number - 1, pursued, so_far, truly_reached(goal)))
        screen.show(truth.poses[row], float(truth.stamps_ns[row] - truth.stamps_ns[0]) * 1e-9)

    screen.write(path, draw, len(truth))


def _goal_colour(number: int, pursued: int, so_far: int, reached: bool) -> str:
    """Blue while it is pursued, then green, or orange when the robot was not there; grey before."""
    if number == pursued:
        return style.SLAM
    if number > so_far:
        return "#969ea8"
    return style.GOOD if reached else style.BAD


def _scan_ends(recording: Recording, scans_at: Trajectory, stamp_ns: int) -> Array:
    """Hits (n, 2) of the newest whole scan, placed by the poses in `scans_at` of the same stamps."""
    k = int(np.searchsorted(recording.stamps_ns, stamp_ns, side="right")) - 2
    pose = int(np.searchsorted(scans_at.stamps_ns, recording.stamps_ns[max(k, 0)]))
    if k < 0 or pose >= len(scans_at) or scans_at.stamps_ns[pose] != recording.stamps_ns[k]:
        return np.zeros((0, 2))
    scan = recording.scan(k)
    origins, directions = beams_in_map(recording, scans_at, pose)
    hit = scan.valid()
    ends: Array = origins[hit] + directions[hit] * scan.ranges[hit, None]
    return ends


def last_frame(path: Path) -> Image.Image:
    """The last frame of a GIF, for print and for readers who want no motion."""
    with Image.open(path) as image:
        image.seek(getattr(image, "n_frames", 1) - 1)
        return image.convert("RGB")
