"""Floor plans as segments and circles, carved out of solid, and rays through them."""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray
from scipy.ndimage import distance_transform_edt

from turtlebag.datasets.grid import FREE, OCCUPIED, UNKNOWN, OccupancyGrid
from turtlebag.datasets.kernels import njit
from turtlebag.datasets.se2 import SE2, Array

CELL = 0.05
BIN = 1.0


class FloorPlan:
    """Free space carved out of solid in 5 cm cells, with boxes and pillars put back."""

    def __init__(self, width: float, height: float) -> None:
        self.solid = np.ones((round(height / CELL), round(width / CELL)), dtype=bool)
        self.circles: list[tuple[float, float, float]] = []
        self.loose: list[tuple[float, float, float, float]] = []

    def carve(self, x0: float, y0: float, x1: float, y1: float) -> None:
        """Make a rectangle free."""
        self.solid[self._rows(y0, y1), self._rows(x0, x1)] = False

    def box(self, x0: float, y0: float, x1: float, y1: float) -> None:
        """Make a rectangle solid."""
        self.solid[self._rows(y0, y1), self._rows(x0, x1)] = True

    def pillar(self, x: float, y: float, radius: float) -> None:
        """A round obstacle."""
        self.circles.append((x, y, radius))

    def turned_box(self, x: float, y: float, length: float, width: float, yaw: float) -> None:
        """A box at any angle, drawn as four segments."""
        corners = SE2.from_xyt(x, y, yaw) @ (
            0.5 * np.array([[length, width], [-length, width], [-length, -width], [length, -width]])
        )
        for a, b in zip(corners, np.roll(corners, -1, axis=0), strict=True):
            self.loose.append((*a, *b))

    def segments(self) -> Array:
        """Outlines, (n, 4)."""
        return np.array([*_edges(self.solid, False), *_edges(self.solid.T, True), *self.loose])

    def clearance(self, xy: Array) -> Array:
        """Distance from points to the nearest solid, within about a cell [m]."""
        free = self._filled() == 0
        cells = np.floor(xy / CELL).astype(int)
        return distance_transform_edt(free)[cells[:, 1], cells[:, 0]] * CELL

    def grid(self) -> OccupancyGrid:
        """True map: walls one cell deep, unknown inside."""
        solid = self._filled() > 0
        inner = distance_transform_edt(solid) > 1.5
        cells = np.where(solid, np.where(inner, UNKNOWN, OCCUPIED), FREE).astype(np.int8)
        return OccupancyGrid(cells, CELL)

    def _filled(self) -> NDArray[np.int8]:
        out = self.solid.astype(np.int8)
        rows, cols = np.indices(out.shape)
        x, y = (cols + 0.5) * CELL, (rows + 0.5) * CELL
        for cx, cy, r in self.circles:
            out[(x - cx) ** 2 + (y - cy) ** 2 <= r * r] = 1
        for ax, ay, bx, by in self.loose:
            n = max(2, round(math.hypot(bx - ax, by - ay) / (0.5 * CELL)))
            t = np.linspace(0.0, 1.0, n)
            r, c = ((ay + t * (by - ay)) / CELL).astype(int), ((ax + t * (bx - ax)) / CELL).astype(int)
            out[r, c] = 1
        return out

    @staticmethod
    def _rows(a: float, b: float) -> slice:
        return slice(round(a / CELL), round(b / CELL))


def _edges(solid: NDArray[np.bool_], swapped: bool) -> list[tuple[float, float, float, float]]:
    """Boundaries between rows of cells as long segments."""
    out = []
    change = solid[1:] != solid[:-1]
    for row in np.flatnonzero(change.any(axis=1)):
        padded = np.concatenate([[False], change[row], [False]])
        # A run ends where solid changes sides, too: that is a corner.
        flips = np.flatnonzero(padded[1:] != padded[:-1])
        y = (row + 1) * CELL
        for a, b in zip(flips[::2] * CELL, flips[1::2] * CELL, strict=True):
            out.append((y, a, y, b) if swapped else (a, y, b, y))
    return out


class Caster:
    """Rays through a floor plan, sped up by a grid of bins."""

    def __init__(self, plan: FloorPlan) -> None:
        self.segments = plan.segments()
        self.circles = np.array(plan.circles, dtype=float).reshape(-1, 3)
        ends = self.segments.reshape(-1, 2)
        self._corner = ends.min(axis=0) - BIN
        self._shape = tuple(np.ceil((ends.max(axis=0) + BIN - self._corner) / BIN).astype(int))
        self._starts, self._items = _bins(self.segments, self.circles, self._corner, *self._shape)

    def cast(self, origins: Array, angles: Array, limit: float) -> Array:
        """Range along each ray (n,), +inf beyond `limit`; origins (n, 2), world angles (n,)."""
        return _cast(
            origins, angles, self.segments, self.circles, self._corner,
            self._shape[0], self._shape[1], self._starts, self._items, limit,
        )  # fmt: skip


def _bins(
    segments: Array, circles: Array, corner: Array, nx: int, ny: int
) -> tuple[NDArray[np.int64], NDArray[np.int64]]:
    """Items (segments, then circles) of each bin: rows starts[b]:starts[b + 1]."""
    low = np.concatenate([np.minimum(segments[:, :2], segments[:, 2:]), circles[:, :2] - circles[:, 2:]])
    high = np.concatenate([np.maximum(segments[:, :2], segments[:, 2:]), circles[:, :2] + circles[:, 2:]])
    lo = np.clip(np.floor((low - 1e-6 - corner) / BIN).astype(int), 0, [nx - 1, ny - 1])
    hi = np.clip(np.floor((high + 1e-6 - corner) / BIN).astype(int), 0, [nx - 1, ny - 1])
    lists: list[list[int]] = [[] for _ in range(nx * ny)]
    for k, ((x0, y0), (x1, y1)) in enumerate(zip(lo, hi, strict=True)):
        for y in range(y0, y1 + 1):
            for x in range(x0, x1 + 1):
                lists[y * nx + x].append(k)
    counts = np.array([len(items) for items in lists])
    starts = np.concatenate([[0], np.cumsum(counts)]).astype(np.int64)
    return starts, np.array([k for items in lists for k in items], dtype=np.int64)


@njit(cache=True)
def _cast(
    origins: Array, angles: Array, segments: Array, circles: Array, corner: Array,
    nx: int, ny: int, starts: NDArray, items: NDArray, limit: float,
) -> Array:  # fmt: skip
    out = np.full(len(angles), np.inf)
    n_segments = len(segments)
    for i in range(len(angles)):
        ox, oy = origins[i, 0], origins[i, 1]
        dx, dy = math.cos(angles[i]), math.sin(angles[i])
        bx, by = int((ox - corner[0]) // BIN), int((oy - corner[1]) // BIN)
        sx, sy = (1 if dx > 0 else -1), (1 if dy > 0 else -1)
        tx = ((bx + (dx > 0)) * BIN + corner[0] - ox) / dx if dx != 0.0 else math.inf
        ty = ((by + (dy > 0)) * BIN + corner[1] - oy) / dy if dy != 0.0 else math.inf
        best = limit
        while 0 <= bx < nx and 0 <= by < ny:
            b = by * nx + bx
            for q in range(starts[b], starts[b + 1]):
                k = items[q]
                if k < n_segments:
                    ax, ay = segments[k, 0] - ox, segments[k, 1] - oy
                    ex, ey = segments[k, 2] - segments[k, 0], segments[k, 3] - segments[k, 1]
                    det = dx * ey - dy * ex
                    if det == 0.0:
                        continue
                    t, u = (ax * ey - ay * ex) / det, (ax * dy - ay * dx) / det
                    if 0.0 < t < best and 0.0 <= u <= 1.0:
                        best = t
                else:
                    c = k - n_segments
                    cx, cy, r = circles[c, 0] - ox, circles[c, 1] - oy, circles[c, 2]
                    along = cx * dx + cy * dy
                    inside = along * along - cx * cx - cy * cy + r * r
                    if inside >= 0.0 and 0.0 < along - math.sqrt(inside) < best:
                        best = along - math.sqrt(inside)
            t_out = min(tx, ty)
            if best <= t_out or t_out > limit:
                break
            if tx < ty:
                bx, tx = bx + sx, tx + BIN / abs(dx)
            else:
                by, ty = by + sy, ty + BIN / abs(dy)
        if best < limit:
            out[i] = best
    return out
