"""A height slice of the 3D map as an occupancy grid.

A band above the floor: points in it are surfaces, and the part of every beam
within it is free. What lies above (lintels, table tops) or below (the floor) is not an obstacle.
"""

from __future__ import annotations

import math

import numpy as np
from pydantic import Field, model_validator

from turtlebag.datasets.errors import InputError
from turtlebag.datasets.grid import OccupancyGrid
from turtlebag.datasets.kernels import njit
from turtlebag.datasets.se2 import Array
from turtlebag.datasets.settings import Settings
from turtlebag.pipeline.slam.grid import MAX_COUNTED, Counts, OccupancyConfig, classify, trace, trimmed

SLICE_REACH_M = 20.0
"""Beams are used up to here."""


class SliceConfig(Settings):
    """The slice; heights over the floor."""

    low_m: float = Field(default=0.1, description="the floor and its noise lie below this")
    high_m: float = Field(default=0.3, description="higher points are not obstacles")
    grid: OccupancyConfig = OccupancyConfig()

    @model_validator(mode="after")
    def _in_order(self) -> SliceConfig:
        if not self.low_m < self.high_m:
            raise ValueError("low_m must be below high_m")
        return self


class SliceGrid:
    """Counts of returns and of beams passing, gathered cloud by cloud."""

    def __init__(self, config: SliceConfig, low: Array, high: Array) -> None:
        """The grid covers the corners low and high (2,) [m] of the map; InputError when that is too large."""
        self._config, resolution = config, config.grid.resolution_m
        self._corner = np.floor((low - config.grid.margin_m) / resolution)
        extent = np.ceil((high + config.grid.margin_m) / resolution) - self._corner
        if not np.prod(extent) <= MAX_COUNTED:
            cols, rows = extent.astype(int)
            raise InputError(
                f"the map would have {rows} x {cols} cells; choose a larger slice.grid.resolution_m"
            )
        self._counts = Counts.none(int(extent[1]), int(extent[0]))

    def add(self, points: Array, origin: Array, floor: float) -> None:
        """Count the beams from `origin` (3,) to points (n, 3), all in the map; `floor` is the floor's z."""
        config, resolution = self._config, self._config.grid.resolution_m
        corner = np.array([*(self._corner * resolution), 0.0])
        band = (floor + np.array([config.low_m, config.high_m])) / resolution
        start, ends = (origin - corner) / resolution, (points - corner) / resolution
        share = config.grid.occupied_share
        carve(self._counts, ends, start, band, SLICE_REACH_M / resolution, share)

    def grid(self) -> OccupancyGrid:
        """The current grid."""
        return trimmed(classify(self._counts, self._config.grid), self._corner, self._config.grid)


@njit(cache=True)
def carve(counts: Counts, ends: Array, start: Array, band: Array, most: float, share: float) -> None:
    """Trace the part within the band of each beam from start (3,) to ends (n, 3), all in cells.

    First the beams that end within the band, then those that only pass through it.
    """
    low, high = band[0], band[1]
    for with_return in (True, False):
        for i in range(ends.shape[0]):
            dx, dy, dz = ends[i, 0] - start[0], ends[i, 1] - start[1], ends[i, 2] - start[2]
            level = math.hypot(dx, dy)
            in_band = low <= ends[i, 2] <= high and level <= most
            if in_band != with_return or level == 0.0:
                continue
            enter, leave = 0.0, min(1.0, most / level)
            if dz == 0.0:
                if not low <= start[2] <= high:
                    continue
            else:
                a, b = (low - start[2]) / dz, (high - start[2]) / dz
                enter, leave = max(enter, min(a, b)), min(leave, max(a, b))
            if leave <= enter:
                continue
            x, y, length = start[0] + enter * dx, start[1] + enter * dy, (leave - enter) * level
            trace(counts, (x, y), (dx / level, dy / level), length, with_return, share)
