"""Small animations, drawn straight into palette images: a map growing, a robot on its way.

Below each picture a strip with the simulated time and a scale bar.
"""

from __future__ import annotations

import io
import math
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
import scipy
from numpy.typing import NDArray
from PIL import Image, ImageColor, ImageDraw, ImageFont

from turtlebag.datasets.deskew import deskewed
from turtlebag.datasets.grid import OCCUPIED_FROM, UNKNOWN, OccupancyGrid
from turtlebag.datasets.se2 import SE2, Array
from turtlebag.datasets.types import Recording, Trajectory
from turtlebag.reports.figures import style
from turtlebag.reports.figures.maps import length_text, scale_length, view_box
from turtlebag.reports.metrics.navigation import placed_goals, truly_reached

WIDTH_PX, HEIGHT_PX, STRIP_PX = 380, 376, 22
FRAMES, FRAME_MS, HOLD_MS = 60, 90, 2500
SCANS = 1000
"""No more than about this many scans are drawn."""
FAN_M = 30.0
WALL_SHARE = 0.4
"""A cell is a wall when more than this share of the scans that saw it met something there. What happened in
it less than this often for each hit of a cell beside it does not count: noise is wider than walls."""
SUPER = 2
"""Drawn this much larger, then averaged: smooth lines from plain ones."""

UNSEEN, FREE, WALL, INK, BLUE, PURPLE, GREEN, ORANGE, SKY, GREY = range(10)
GROUNDS = ("#dadfe5", style.PAPER, "#3c444d")
MARKS = (style.INK, style.SLAM, style.ODOMETRY, style.GOOD, style.BAD, style.TRUTH, "#969ea8")
COLOURS = tuple(ImageColor.getrgb(colour) for colour in (*GROUNDS, *MARKS))


@dataclass(frozen=True)
class Canvas:
    """World metres to pixels of the enlarged frame; `size` is that of the picture above the strip."""

    x0: float
    y1: float
    scale: float
    size: tuple[int, int]

    @property
    def sheet(self) -> tuple[int, int]:
        """Size with the strip."""
        return self.size[0], self.size[1] + SUPER * STRIP_PX

    @staticmethod
    def over(box: tuple[float, float, float, float]) -> Canvas:
        """A canvas that holds the box (x0, x1, y0, y1) [m]."""
        width, height = box[1] - box[0], box[3] - box[2]
        scale = SUPER * min(WIDTH_PX / width, HEIGHT_PX / height)
        even = [SUPER * max(1, round(extent * scale / SUPER)) for extent in (width, height)]
        return Canvas(box[0], box[3], scale, (even[0], even[1]))

    def pixels(self, xy: Array) -> list[tuple[float, float]]:
        """Pixel positions of points (n, 2) [m]."""
        places = np.stack([(xy[:, 0] - self.x0) * self.scale, (self.y1 - xy[:, 1]) * self.scale], axis=1)
        return [(x, y) for x, y in places.tolist()]

    def blank(self) -> Image.Image:
        """An enlarged frame of unseen ground, and the empty strip."""
        image = Image.new("P", self.sheet, UNSEEN)
        ImageDraw.Draw(image).rectangle((0, self.size[1], *self.sheet), fill=FREE)
        return image

    def caption(self, draw: ImageDraw.ImageDraw, seconds: float) -> None:
        """The clock and the scale bar, in the strip."""
        left, middle = 6 * SUPER, self.size[1] + SUPER * STRIP_PX // 2
        draw.rectangle((0, self.size[1], *self.sheet), fill=FREE)
        font = ImageFont.load_default(13 * SUPER)
        draw.text((left, middle), f"{seconds:.1f} s", fill=INK, font=font, anchor="lm")
        length = scale_length(self.size[0] / self.scale)
        right = self.size[0] - left
        bar = (right - length * self.scale, middle - 2 * SUPER, right, middle + SUPER)
        draw.rectangle(bar, fill=INK)
        draw.text((bar[0] - left, middle), length_text(length), fill=INK, font=font, anchor="rm")


def mapping(
    recording: Recording, slam: Trajectory, odometry: Trajectory | None, grid: OccupancyGrid
) -> Iterator[Image.Image]:
    """Frames of a map that grows scan by scan; SLAM's path blue, the odometry's purple."""
    canvas = Canvas.over(view_box(grid))
    tally = _Tally(canvas, max(grid.resolution, SUPER / canvas.scale))
    steps = np.linspace(0, len(recording) - 1, FRAMES).astype(int)
    stride = max(2, len(recording) // SCANS)
    done = 0
    for last in steps:
        for k in range(done, int(last) + 1, stride):
            tally.add(recording, k, beams_in_map(recording, slam, k))
        done = int(last) + 1
        frame = canvas.blank()
        frame.paste(tally.picture())
        draw = ImageDraw.Draw(frame)
        if odometry is not None:
            until = int(np.searchsorted(odometry.stamps_ns, slam.stamps_ns[last], side="right"))
            _path(draw, canvas, odometry.poses.xy[:until][:: max(1, until // 2000)], PURPLE, 2)
        _path(draw, canvas, slam.poses.xy[: last + 1], BLUE, 3)
        _robot(draw, canvas, slam.poses[int(last)])
        canvas.caption(draw, float(slam.stamps_ns[last] - slam.stamps_ns[0]) * 1e-9)
        yield frame


def beams_in_map(recording: Recording, path: Trajectory, k: int) -> tuple[Array, Array]:
    """Origins and unit directions (n_beams, 2) of the scan at `path`'s pose k, in that path's frame.

    A lidar that turns while the robot does sees a turned room; the base moves on to the pose of scan k + 1.
    """
    lidar, T_map_base = recording.lidar, path.poses[k]
    motion, step_s = SE2.identity(1), math.inf
    if k + 1 < len(path) and path.stamps_ns[k + 1] > path.stamps_ns[k]:
        motion = T_map_base.inverse() @ path.poses[k + 1 : k + 2]
        step_s = float(path.stamps_ns[k + 1] - path.stamps_ns[k]) * 1e-9
    fractions = np.arange(lidar.n_beams) * lidar.time_increment / step_s
    origins, directions = deskewed(lidar.directions, fractions, recording.T_base_lidar.xyt, motion.xyt)
    return T_map_base @ origins, SE2.from_xyt(0.0, 0.0, T_map_base.yaw) @ directions


class _Tally:
    """How many scans hit each cell of the picture, and how many saw through it."""

    def __init__(self, canvas: Canvas, cell_m: float) -> None:
        self._picture = canvas.size
        columns, rows = (max(1, round(extent / (canvas.scale * cell_m))) for extent in canvas.size)
        self._cells = Canvas(canvas.x0, canvas.y1, columns * canvas.scale / canvas.size[0], (columns, rows))
        self._hits, self._free = (np.zeros((rows, columns), dtype=np.int32) for _ in range(2))

    def add(self, recording: Recording, k: int, beams: tuple[Array, Array]) -> None:
        """Count one scan. A beam is a wedge up to half a cell before its hit; a silent one says nothing."""
        lidar, cells, (origins, directions) = recording.lidar, self._cells, beams
        hit = lidar.returns(recording.ranges[k])
        ranges = np.where(hit, np.minimum(np.nan_to_num(recording.ranges[k].astype(np.float64)), FAN_M), 0.0)
        seen = Image.new("1", cells.size)
        reach = np.maximum(ranges - 0.5 / cells.scale, 0.0)[:, None]
        half = 0.5 * lidar.angle_increment
        edges = [origins + (SE2.from_xyt(0.0, 0.0, turn) @ directions) * reach for turn in (-half, half)]
        fan = np.concatenate([origins[:1], np.stack(edges, axis=1).reshape(-1, 2)])
        ImageDraw.Draw(seen).polygon(cells.pixels(fan), fill=1)
        ends = (origins + directions * ranges[:, None])[hit & (ranges < FAN_M)]
        column, row = np.floor(np.array(cells.pixels(ends)).reshape(-1, 2).T).astype(np.int64)
        inside = (column >= 0) & (column < cells.size[0]) & (row >= 0) & (row < cells.size[1])
        met = np.zeros_like(self._hits, dtype=bool)
        met[row[inside], column[inside]] = True
        self._hits += met
        self._free += np.asarray(seen) & ~met

    def picture(self) -> Image.Image:
        """The map so far, as large as the picture."""
        hits, free = self._hits, self._free
        most = WALL_SHARE * scipy.ndimage.maximum_filter(hits, size=3)
        shades = np.where(free > most, FREE, UNSEEN)
        shades[(hits > WALL_SHARE * (hits + free)) & (hits >= most)] = WALL
        return Image.fromarray(shades.astype(np.uint8), mode="P").resize(
            self._picture, Image.Resampling.NEAREST
        )


def run(
    grid: OccupancyGrid | None,
    truth: Trajectory,
    goal_index: NDArray[np.int64],
    goals: Sequence[Mapping[str, Any]],
    recording: Recording | None,
    scans_at: Trajectory | None,
) -> Iterator[Image.Image]:
    """Frames of a drive: the true path so far, the goal pursued, the scan where `scans_at` puts it."""
    canvas = Canvas.over(view_box(grid, [truth]))
    ground = _ground(canvas, grid)
    for row in np.linspace(0, len(truth) - 1, FRAMES).astype(int):
        frame = ground.copy()
        draw = ImageDraw.Draw(frame)
        _path(draw, canvas, truth.poses.xy[: row + 1][::5], SKY, 7)
        if recording is not None and scans_at is not None:
            _scan(draw, canvas, recording, scans_at, int(truth.stamps_ns[row]))
        so_far = int(goal_index[: row + 1].max())
        pursued = int(goal_index[row]) if row < len(truth) - 1 else -1
        for number, x, y, goal in placed_goals(goals):
            colour = _goal_colour(number - 1, pursued, so_far, truly_reached(goal))
            [place] = canvas.pixels(np.array([[x, y]]))
            draw.circle(place, 0.02 * canvas.size[0], fill=colour)
        _robot(draw, canvas, truth.poses[int(row)])
        canvas.caption(draw, float(truth.stamps_ns[row] - truth.stamps_ns[0]) * 1e-9)
        yield frame


def _goal_colour(number: int, pursued: int, so_far: int, reached: bool) -> int:
    """Blue while it is pursued, then green, or orange when the robot was not there; grey before."""
    if number == pursued:
        return BLUE
    if number > so_far:
        return GREY
    return GREEN if reached else ORANGE


def _ground(canvas: Canvas, grid: OccupancyGrid | None) -> Image.Image:
    """The map in the canvas: each pixel takes the cell under it."""
    if grid is None:
        return Image.new("P", canvas.sheet, FREE)
    columns, rows = canvas.size
    x = canvas.x0 + (np.arange(columns) + 0.5) / canvas.scale
    y = canvas.y1 - (np.arange(rows) + 0.5) / canvas.scale
    points = np.stack(np.meshgrid(x, y), axis=-1)
    values = grid.value_at(points)
    shades = np.where(values == UNKNOWN, UNSEEN, FREE)
    shades[values >= OCCUPIED_FROM] = WALL
    frame = canvas.blank()
    frame.paste(Image.fromarray(shades.astype(np.uint8), mode="P"))
    return frame


def _scan(
    draw: ImageDraw.ImageDraw, canvas: Canvas, recording: Recording, scans_at: Trajectory, stamp_ns: int
) -> None:
    """Hits of the newest whole scan, placed by the poses in `scans_at` of the same stamps."""
    k = int(np.searchsorted(recording.stamps_ns, stamp_ns, side="right")) - 2
    pose = int(np.searchsorted(scans_at.stamps_ns, recording.stamps_ns[max(k, 0)]))
    if k < 0 or pose >= len(scans_at) or scans_at.stamps_ns[pose] != recording.stamps_ns[k]:
        return
    scan = recording.scan(k)
    origins, directions = beams_in_map(recording, scans_at, pose)
    hit = scan.valid()
    for x, y in canvas.pixels(origins[hit] + directions[hit] * scan.ranges[hit, None]):
        draw.rectangle((x - 1, y - 1, x + 2, y + 2), fill=GREEN)


def _path(draw: ImageDraw.ImageDraw, canvas: Canvas, xy: Array, colour: int, width: int) -> None:
    if len(xy) > 1:
        draw.line(canvas.pixels(xy), fill=colour, width=width, joint="curve")


def _robot(draw: ImageDraw.ImageDraw, canvas: Canvas, T_map_base: SE2) -> None:
    """A triangle that points where the robot looks."""
    length = 0.03 * canvas.size[0] / canvas.scale
    shape = length * np.array([[1.0, 0.0], [-0.7, 0.6], [-0.4, 0.0], [-0.7, -0.6]])
    draw.polygon(canvas.pixels(T_map_base @ shape), fill=INK)


def gif(frames: Iterator[Image.Image]) -> bytes:
    """The frames, reduced to their final size, as a looping GIF; the last one stays longer."""
    reduced = [_reduce(frame) for frame in frames]
    shared = _shared_palette()
    flat = [frame.quantize(palette=shared, dither=Image.Dither.NONE) for frame in reduced]
    durations = [FRAME_MS] * (len(flat) - 1) + [HOLD_MS]
    buffer = io.BytesIO()
    flat[0].save(
        buffer,
        format="GIF",
        save_all=True,
        append_images=flat[1:],
        duration=durations,
        loop=0,
        optimize=False,
        disposal=1,
    )
    return buffer.getvalue()


def _reduce(frame: Image.Image) -> Image.Image:
    frame.putpalette([part for colour in COLOURS for part in colour])
    return frame.convert("RGB").reduce(SUPER)


def _shared_palette() -> Image.Image:
    """The colours and their blends with the three grounds, the same for every animation."""
    parts = np.array(COLOURS, dtype=np.float64)
    blends = [
        tuple(np.round(share * one + (1.0 - share) * parts[ground]).astype(int))
        for one in parts
        for ground in (UNSEEN, FREE, WALL)
        for share in (0.75, 0.5, 0.25)
    ]
    colours = list(dict.fromkeys([*COLOURS, *blends]))
    image = Image.new("P", (1, 1))
    image.putpalette([int(part) for colour in colours for part in colour])
    return image


def last_frame(data: bytes) -> bytes:
    """The last frame of a GIF as PNG, for print and for readers who want no motion."""
    with Image.open(io.BytesIO(data)) as image:
        image.seek(getattr(image, "n_frames", 1) - 1)
        buffer = io.BytesIO()
        image.convert("RGB").save(buffer, format="PNG", optimize=True)
    return buffer.getvalue()
