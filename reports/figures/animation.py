"""Small animations: a map growing, a robot on its way.

Below each picture a strip with the simulated time and a scale bar. A frame has a few lines and dots on a map:
Pillow draws it ten times as fast as Matplotlib.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from functools import cache
from pathlib import Path
from typing import Any

import matplotlib
import numpy as np
import scipy
from numpy.typing import NDArray
from PIL import Image, ImageColor, ImageDraw, ImageFont

from turtlebag.datasets.grid import OCCUPIED_FROM, UNKNOWN, OccupancyGrid
from turtlebag.datasets.se2 import SE2, Array
from turtlebag.datasets.true_maps import TrueMap
from turtlebag.datasets.types import Recording, Trajectory
from turtlebag.reports.figures import style
from turtlebag.reports.figures.maps import Box, length_text, scale_length, view_box
from turtlebag.reports.metrics.map import walls
from turtlebag.reports.metrics.navigation import placed_goals, truly_reached

PICTURE_PX, STRIP_PX = 380, 22
FINE = 2
"""A picture is drawn so many times as large as it is shown, which smooths its lines."""
FRAMES, FPS, HOLD = 60, 10, 25
"""The last frame stays for so many more."""
SCANS = 600
"""No more than about this many scans are drawn."""
PATH_POINTS = 2000
FAN_M = 30.0
WALL_SHARE = 0.4
"""A cell is a wall when more than this share of the scans that saw it met something there. What happened in
it less than this often for each hit of a cell beside it does not count: noise is wider than walls."""
UNSEEN, FREE, WALL = range(3)
WALLS = "#3c444d"
GROUNDS = np.array([ImageColor.getrgb(c) for c in (style.GROUND, style.PAPER, WALLS)], dtype=np.uint8)
TRIANGLE = np.array([[1.0, 0.0], [-0.7, 0.6], [-0.4, 0.0], [-0.7, -0.6]])


class Canvas:
    """An image over a box of the world to draw on in metres; widths are in pixels as shown."""

    def __init__(self, image: Image.Image, box: Box) -> None:
        self.image, self._box = image, box
        self._draw = ImageDraw.Draw(image)
        self._scale = max(image.size) / max(box[1] - box[0], box[3] - box[2])

    def copy(self) -> Canvas:
        """Another one to draw over it."""
        return Canvas(self.image.copy(), self._box)

    def pixels(self, xy: Array) -> Array:
        """Columns and rows of points (n, 2)."""
        x, y = self._scale * (xy - (self._box[0], self._box[3])).T
        return np.stack([x, -y], axis=1)

    def line(self, xy: Array, colour: str, width_px: float) -> None:
        """Along points (n, 2)."""
        if len(xy) > 1:
            self._draw.line(self.pixels(xy).ravel().tolist(), colour, round(FINE * width_px), "curve")

    def disc(self, xy: Array, radius_m: float, colour: str) -> None:
        """Around a point (2,)."""
        [[column, row]], radius = self.pixels(xy[None]).tolist(), radius_m * self._scale
        self._draw.ellipse((column - radius, row - radius, column + radius, row + radius), colour)

    def dots(self, xy: Array, colour: str, width_px: float) -> None:
        """Small squares around points (n, 2)."""
        corner, width = np.floor(self.pixels(xy) - 0.5 * FINE * width_px), round(FINE * width_px)
        for step in np.ndindex(width, width):
            self._draw.point((corner + step).ravel().tolist(), colour)

    def robot(self, T_map_base: SE2) -> None:
        """A triangle that points where it looks."""
        shape = 0.03 * self.image.width / self._scale * TRIANGLE
        self._draw.polygon(self.pixels(T_map_base @ shape).ravel().tolist(), style.INK)


class Screen:
    """What a film shows: a picture of a box of the world, and the strip below."""

    def __init__(self, box: Box) -> None:
        width, height = box[1] - box[0], box[3] - box[2]
        self.scale = PICTURE_PX / max(width, height)
        """Pixels a metre."""
        self.box = box
        self.size = max(1, round(width * self.scale)), max(1, round(height * self.scale))
        """Width and height of the picture above the strip [pixels]."""
        self._empty = Image.new("RGB", (self.size[0], self.size[1] + STRIP_PX), style.PAPER)
        length, right = scale_length(width), self.size[0] - 6
        left, middle = right - length * self.scale, self.size[1] + STRIP_PX // 2
        draw = ImageDraw.Draw(self._empty)
        draw.line((left, middle, right, middle), style.INK, 3)
        draw.text((left - 6, middle), length_text(length), style.INK, _font(), "rm")

    def canvas(self, colours: NDArray[np.uint8]) -> Canvas:
        """The picture with colours (rows, columns, 3) all over it, row 0 lowest."""
        fine = FINE * self.size[0], FINE * self.size[1]
        return Canvas(Image.fromarray(colours[::-1]).resize(fine, Image.Resampling.NEAREST), self.box)

    def ground(self, grid: OccupancyGrid | None) -> Canvas:
        """The picture with a map on it: each wall takes a pixel at least."""
        if grid is None:
            return self.canvas(GROUNDS[np.full((1, 1), FREE)])
        (left, _, low, _), step = self.box, 1.0 / (FINE * self.scale)
        x, y = (
            from_m + step * (np.arange(FINE * n) + 0.5)
            for from_m, n in zip((left, low), self.size, strict=True)
        )
        values = grid.value_at(np.stack(np.meshgrid(x, y), axis=-1))
        shades = np.select([values == UNKNOWN, values < OCCUPIED_FROM], [UNSEEN, FREE], WALL)
        canvas = self.canvas(GROUNDS[shades])
        canvas.dots(walls(grid), WALLS, 1 / FINE)
        for x, y, radius in grid.circles if isinstance(grid, TrueMap) else ():
            for colour, by in ((style.PAPER, 1.5), (WALLS, 0.0), (style.GROUND, -1.0)):
                canvas.disc(np.array([x, y]), max(radius + by * grid.resolution, 0.0), colour)
        return canvas

    def write(self, path: Path, draw: Callable[[int], tuple[Canvas, float]], count: int) -> Image.Image:
        """A looping GIF of frames evenly over `count` samples, the last of which stays; returns that.

        `draw` has a sample's picture and its seconds since the start.
        """
        frames = [self._frame(*draw(k)) for k in np.linspace(0, count - 1, FRAMES).astype(int).tolist()]
        # one palette for all: finding one takes longer than drawing
        palette = Image.fromarray(
            np.concatenate([np.asarray(f)[::2, ::2] for f in frames[:: -FRAMES // 5]])
        ).quantize()
        images = [frame.quantize(palette=palette, dither=Image.Dither.NONE) for frame in frames]
        ms = [1000 // FPS] * (FRAMES - 1) + [1000 // FPS * (1 + HOLD)]
        images[0].save(path, save_all=True, append_images=images[1:], duration=ms, loop=0)
        return images[-1]

    def _frame(self, canvas: Canvas, seconds: float) -> Image.Image:
        frame = self._empty.copy()
        frame.paste(canvas.image.reduce(FINE))
        middle = self.size[1] + STRIP_PX // 2
        ImageDraw.Draw(frame).text((6, middle), f"{seconds:.1f} s", style.INK, _font(), "lm")
        return frame


@cache
def _font() -> ImageFont.FreeTypeFont:
    return ImageFont.truetype(Path(matplotlib.get_data_path(), "fonts", "ttf", "DejaVuSans.ttf"), 12.5)


def write_mapping(
    path: Path, recording: Recording, slam: Trajectory, odometry: Trajectory | None, grid: OccupancyGrid
) -> Image.Image:
    """A GIF of a map that grows scan by scan, SLAM's path blue, the odometry's purple; returns its end."""
    screen = Screen(view_box(grid))
    seen = GrowingMap(screen.box, max(grid.resolution, 1.0 / screen.scale))
    stride = max(2, len(recording) // SCANS)
    done = 0

    def draw(last: int) -> tuple[Canvas, float]:
        nonlocal done
        for k in range(done, last + 1, stride):
            seen.add(recording, k, beams_in_map(recording, slam, k))
        done = last + 1
        canvas = screen.canvas(GROUNDS[seen.shades()])
        if odometry is not None:
            until = int(np.searchsorted(odometry.stamps_ns, slam.stamps_ns[last], side="right"))
            canvas.line(odometry.poses.xy[:until][:: max(1, until // PATH_POINTS)], style.ODOMETRY, 1.5)
        canvas.line(slam.poses.xy[: last + 1], style.SLAM, 2.0)
        canvas.robot(slam.poses[last])
        return canvas, float(slam.stamps_ns[last] - slam.stamps_ns[0]) * 1e-9

    return screen.write(path, draw, len(recording))


def beams_in_map(recording: Recording, path: Trajectory, k: int) -> tuple[Array, Array]:
    """Origins and unit directions (n_beams, 2) of the scan at `path`'s pose k, in that path's frame.

    A lidar that turns while the robot does sees a turned room; the base moves on to the pose of scan k + 1.
    """
    mounted, T_map_base = recording.lidars[recording.lidar_of[k]], path.poses[k]
    lidar = mounted.spec
    T_map_later, step_s = T_map_base, math.inf
    if k + 1 < len(path) and path.stamps_ns[k + 1] > path.stamps_ns[k]:
        T_map_later, step_s = path.poses[k + 1], float(path.stamps_ns[k + 1] - path.stamps_ns[k]) * 1e-9
    fractions = lidar.order * abs(lidar.time_increment) / step_s
    T_map_lidar = T_map_base.interpolate(T_map_later, fractions) @ mounted.T_base_lidar
    return T_map_lidar.xy, SE2.from_xyt(0.0, 0.0, T_map_lidar.yaw) @ lidar.directions


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
        seen = Image.new("L", (columns, rows))
        reach = np.maximum(ranges - 0.5 * self._cell_m, 0.0)[:, None]
        half = 0.5 * lidar.angle_increment
        edges = [origins + (SE2.from_xyt(0.0, 0.0, turn) @ directions) * reach for turn in (-half, half)]
        fan = np.concatenate([origins[:1], np.stack(edges, axis=1).reshape(-1, 2)])
        ImageDraw.Draw(seen).polygon(self._cells(fan).ravel().tolist(), fill=1)
        ends = (origins + directions * ranges[:, None])[hit & (ranges < FAN_M)]
        column, row = np.floor(self._cells(ends)).astype(np.int64).T
        inside = (column >= 0) & (column < columns) & (row >= 0) & (row < rows)
        free, met = np.asarray(seen).copy(), (row[inside], column[inside])
        self._hits[met] += 1  # once however many beams met it
        free[met] = 0
        self._free += free

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
) -> Image.Image:
    """A GIF of a drive: the true path so far, the goal pursued, the scan where `scans_at` puts it.

    Returns its end.
    """
    screen = Screen(view_box(grid, [truth]))
    ground = screen.ground(grid)
    places = list(placed_goals(goals))
    radius_m = 0.02 * screen.size[0] / screen.scale
    done = 0

    def draw(row: int) -> tuple[Canvas, float]:
        nonlocal done
        ground.line(truth.poses.xy[max(done - 1, 0) : row + 1], style.TRUTH, 4.0)
        done, canvas = row, ground.copy()
        so_far = int(goal_index[: row + 1].max())
        pursued = int(goal_index[row]) if row < len(truth) - 1 else -1
        for number, x, y, goal in places:
            colour = _goal_colour(number - 1, pursued, so_far, truly_reached(goal))
            canvas.disc(np.array([x, y]), radius_m, colour)
        if recording is not None and scans_at is not None:
            canvas.dots(_scan_ends(recording, scans_at, int(truth.stamps_ns[row])), style.GOOD, 2.0)
        canvas.robot(truth.poses[row])
        return canvas, float(truth.stamps_ns[row] - truth.stamps_ns[0]) * 1e-9

    return screen.write(path, draw, len(truth))


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
