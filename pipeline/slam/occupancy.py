"""Occupancy grid from posed scans: hits and misses along every beam, also those without return.

Log-odds after Moravec and Elfes (1985). The cell of a return gains, the cells before it lose; a beam
without return (+inf) clears up to the lidar's range. Cells are rastered exactly (Amanatides and Woo
1987), so no cell a beam crosses is missed and none is touched twice.
"""

from __future__ import annotations

import math

import numpy as np
from numba import njit
from numpy.typing import NDArray
from pydantic import BaseModel, ConfigDict, Field

from datasets.errors import InputError
from datasets.grid import FREE, OCCUPIED, UNKNOWN, OccupancyGrid
from datasets.se2 import SE2, Array
from datasets.types import Recording
from pipeline.slam.clouds import sweep_motion

MAX_CELLS = 400_000_000


class OccupancyConfig(BaseModel):
    """The occupancy grid."""

    model_config = ConfigDict(extra="forbid", frozen=True)
    resolution_m: float = Field(default=0.05, gt=0.0, le=1.0)
    hit: float = Field(default=0.9, gt=0.0, description="log-odds of a return")
    miss: float = Field(default=0.35, gt=0.0, description="log-odds of a beam passing through")
    limit: float = Field(default=6.0, gt=0.0, description="log-odds are clamped to this")
    margin_m: float = Field(default=0.5, ge=0.0, description="border around what was seen")
    clear_without_return: bool = True


def make_grid(
    recording: Recording,
    T_map_base: SE2,
    config: OccupancyConfig,
    usable_range: float,
    motion: SE2 | None = None,
) -> OccupancyGrid:
    """Grid of all scans at poses (n,); rows of cells are aligned to multiples of the resolution."""
    lidar, resolution = recording.lidar, config.resolution_m
    limit = min(lidar.range_max, usable_range)
    ranges = np.asarray(recording.ranges)
    finite = np.where((ranges >= lidar.range_min) & (ranges <= limit), ranges, 0.0)
    reach = finite.max(axis=1)
    if config.clear_without_return:
        reach = np.maximum(reach, np.where(np.isposinf(ranges).any(axis=1), lidar.range_max, 0.0))
    T_map_lidar = T_map_base @ recording.T_base_lidar
    low = (T_map_lidar.xy - reach[:, None]).min(axis=0) - config.margin_m
    high = (T_map_lidar.xy + reach[:, None]).max(axis=0) + config.margin_m
    corner = np.floor(low / resolution)
    cols, rows = (np.ceil(high / resolution) - corner).astype(int)
    if rows * cols > MAX_CELLS:
        raise InputError(f"the map would have {rows} x {cols} cells; choose a larger grid.resolution_m")
    odds = np.zeros((rows, cols), dtype=np.float32)
    if motion is None and lidar.time_increment > 0.0:
        motion = sweep_motion(recording)
    _cast(
        odds,
        corner * resolution,
        resolution,
        ranges,
        lidar.angles,
        T_map_base.xyt,
        recording.T_base_lidar.xyt,
        np.zeros((0, 3)) if motion is None else motion.xyt,
        lidar.range_min,
        lidar.range_max,
        limit,
        config.hit,
        config.miss,
        config.limit,
        config.clear_without_return,
    )
    return _trimmed(odds, corner, resolution, config)


def _trimmed(
    odds: NDArray[np.float32], corner: Array, resolution: float, config: OccupancyConfig
) -> OccupancyGrid:
    cells = np.full(odds.shape, UNKNOWN, dtype=np.int8)
    cells[odds < 0.0] = FREE
    cells[odds > 0.0] = OCCUPIED
    known_rows, known_cols = np.flatnonzero((odds != 0).any(axis=1)), np.flatnonzero((odds != 0).any(axis=0))
    if len(known_rows) == 0:
        known_rows = known_cols = np.array([0])
    border = math.ceil(config.margin_m / resolution)
    r0, r1 = max(known_rows[0] - border, 0), known_rows[-1] + border + 1
    c0, c1 = max(known_cols[0] - border, 0), known_cols[-1] + border + 1
    origin = (corner + np.array([c0, r0])) * resolution
    return OccupancyGrid(cells[r0:r1, c0:c1].copy(), resolution, SE2.from_xyt(origin[0], origin[1], 0.0))


@njit(cache=True)
def _cast(
    odds: NDArray,
    corner: Array,
    resolution: float,
    ranges: NDArray,
    angles: Array,
    poses: Array,
    T_base_lidar: Array,
    motion: Array,
    range_min: float,
    range_max: float,
    usable: float,
    hit: float,
    miss: float,
    limit: float,
    clear: bool,
) -> None:
    n_scans, n_beams = ranges.shape
    for scan in range(n_scans):
        for beam in range(n_beams):
            r = float(ranges[scan, beam])
            returned = r >= range_min and r <= usable
            if not returned:
                if r > usable and r <= range_max:
                    length = usable
                elif clear and r == np.inf:
                    length = range_max
                else:
                    continue
            else:
                length = r
            x, y, yaw = poses[scan, 0], poses[scan, 1], poses[scan, 2]
            if len(motion) > 0 and n_beams > 1:
                f = beam / (n_beams - 1)
                c, s = math.cos(yaw), math.sin(yaw)
                x += f * (c * motion[scan, 0] - s * motion[scan, 1])
                y += f * (s * motion[scan, 0] + c * motion[scan, 1])
                yaw += f * motion[scan, 2]
            c, s = math.cos(yaw), math.sin(yaw)
            ox = x + c * T_base_lidar[0] - s * T_base_lidar[1]
            oy = y + s * T_base_lidar[0] + c * T_base_lidar[1]
            direction = yaw + T_base_lidar[2] + angles[beam]
            trace(
                odds,
                (ox - corner[0]) / resolution,
                (oy - corner[1]) / resolution,
                math.cos(direction),
                math.sin(direction),
                length / resolution,
                returned,
                hit,
                miss,
                limit,
            )


@njit(cache=True)
def trace(
    odds: NDArray,
    x: float,
    y: float,
    dx: float,
    dy: float,
    length: float,
    returned: bool,
    hit: float,
    miss: float,
    limit: float,
) -> None:
    """One beam from (x, y) along the unit vector (dx, dy), all in cells."""
    rows, cols = odds.shape
    col, row = math.floor(x), math.floor(y)
    end_col, end_row = math.floor(x + dx * length), math.floor(y + dy * length)
    step_c, step_r = (1 if dx > 0 else -1), (1 if dy > 0 else -1)
    big = 1e30
    next_c = ((col + (step_c > 0)) - x) / dx if dx != 0.0 else big
    next_r = ((row + (step_r > 0)) - y) / dy if dy != 0.0 else big
    delta_c = abs(1.0 / dx) if dx != 0.0 else big
    delta_r = abs(1.0 / dy) if dy != 0.0 else big
    while True:
        if col == end_col and row == end_row:
            break
        if 0 <= row < rows and 0 <= col < cols:
            odds[row, col] = max(odds[row, col] - miss, -limit)
        if next_c < next_r:
            if next_c > length:
                break
            col += step_c
            next_c += delta_c
        else:
            if next_r > length:
                break
            row += step_r
            next_r += delta_r
    if 0 <= end_row < rows and 0 <= end_col < cols:
        if returned:
            odds[end_row, end_col] = min(odds[end_row, end_col] + hit, limit)
        else:
            odds[end_row, end_col] = max(odds[end_row, end_col] - miss, -limit)
