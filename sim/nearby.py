"""Outlines by place: what is too far away to matter costs nothing."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np

from turtlebag.datasets.se2 import Array
from turtlebag.sim.raycast import distance_to_outlines, distance_to_point
from turtlebag.sim.shapes import Sections

TILE_M = 2.0
FEW = 200
"""So few outlines are looked at all together."""


class Nearby:
    """Outlines, looked up by the square tile of the floor that a place lies in."""

    def __init__(self, outlines: Sections, reach: float) -> None:
        """`reach` [m]: how far from a place what is looked up there may lie."""
        self.everything, self.reach = outlines, reach
        self._tiles: dict[tuple[int, int], Sections] = {}
        self._few = len(outlines.segments) + len(outlines.circles) <= FEW

    def at(self, x: float, y: float) -> Sections:
        """In their order the outlines of which any point is within reach of a place, and some more."""
        if self._few or not math.isfinite(x + y):
            return self.everything
        tile = math.floor(x / TILE_M), math.floor(y / TILE_M)
        if tile not in self._tiles:
            middle = (np.array(tile) + 0.5) * TILE_M
            self._tiles[tile] = _within(self.everything, middle, self.reach + TILE_M * math.sqrt(0.5))
        return self._tiles[tile]

    def clearance(self, polygon: Array) -> float:
        """Distance from a convex counter-clockwise polygon (n, 2) to the nearest outline; 0 on overlap."""
        if not self._few:
            middle = polygon.mean(axis=0)
            near = self.at(*middle.tolist())
            distance = distance_to_outlines(polygon, near.segments, near.circles)
            # Anything left out is farther than `reach` from the middle.
            if distance + float(np.hypot(*(polygon - middle).T).max()) <= self.reach:
                return float(distance)
        return float(distance_to_outlines(polygon, self.everything.segments, self.everything.circles))

    def room(self, x: float, y: float) -> float:
        """Distance from a point to the nearest outline, if that is within reach, else more than that [m]."""
        near = self.at(x, y)
        return float(distance_to_point(x, y, near.segments, near.circles))


def _within(outlines: Sections, middle: Array, reach: float) -> Sections:
    """Those of the outlines that come within `reach` [m] of a point (2,), in their order."""
    a, b = outlines.segments[:, :2] - middle, outlines.segments[:, 2:] - middle
    along = b - a
    square = np.maximum(np.sum(along * along, axis=1), 1e-18)
    share = np.clip(-np.sum(a * along, axis=1) / square, 0.0, 1.0)
    near = np.hypot(*(a + share[:, None] * along).T) <= reach
    far = np.hypot(*(outlines.circles[:, :2] - middle).T)
    round_ones = far - outlines.circles[:, 2] <= reach
    return replace(
        outlines,
        segments=outlines.segments[near],
        circles=outlines.circles[round_ones],
        segment_return=outlines.segment_return[near],
        circle_return=outlines.circle_return[round_ones],
    )
