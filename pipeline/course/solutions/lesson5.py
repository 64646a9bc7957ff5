"""Lesson 5 solved: log odds, a scan after the other."""

from __future__ import annotations

import numpy as np

from turtlebag.datasets.se2 import Array

HIT, PASS, MOST = 0.85, -0.4, 6.0
RANGE_M = 3.5


class GridMapper:
    """Each scan adds to the cells that it hits, and takes from those that it passes."""

    def __init__(self, resolution: float, origin: Array, shape: Array) -> None:
        self.resolution, self.origin = resolution, origin
        self.rows, self.cols = shape.astype(int)

    def map(self, poses: Array, ranges: Array, angles: Array) -> Array:
        """The probability that each cell is occupied, (rows, cols)."""
        odds = np.zeros((self.rows, self.cols))
        along = np.arange(0.0, RANGE_M, self.resolution / 2)
        for (x, y, yaw), scan in zip(poses, ranges, strict=True):
            directions = np.stack([np.cos(yaw + angles), np.sin(yaw + angles)], axis=-1)
            before = along[:, None] < scan - self.resolution
            passed = self.cells(np.array([x, y]) + along[:, None, None] * directions, before)
            seen = np.isfinite(scan)
            hit = self.cells(np.array([x, y]) + np.where(seen, scan, 0.0)[:, None] * directions, seen)
            odds += np.where(hit, HIT, PASS * passed)
            odds = np.clip(odds, -MOST, MOST)
        return 1.0 / (1.0 + np.exp(-odds))

    def cells(self, points: Array, which: Array) -> Array:
        """A mask (rows, cols) of the cells in which these points lie."""
        col, row = np.floor((points[which] - self.origin) / self.resolution).astype(int).T
        inside = (row >= 0) & (row < self.rows) & (col >= 0) & (col < self.cols)
        mask = np.zeros((self.rows, self.cols), bool)
        mask[row[inside], col[inside]] = True
        return mask
