"""Whether the robot's polygon fits at a pose: compiled checks against a clearance field.

Kernels take the grid frame's coordinates, the field (rows, cols) float32 [m] and its resolution.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from turtlebag.datasets.kernels import njit
from turtlebag.datasets.se2 import Array
from turtlebag.datasets.types import RobotModel

Field32 = NDArray[np.float32]


HALF_DIAGONAL = math.sqrt(0.5)
"""Largest distance of a point of a cell from its centre, in cells."""
PITCH_M = 0.03
"""Spacing of the footprint's points: less than a cell."""


class FootprintSamples(NamedTuple):
    """Points of the footprint (n, 2) in the base frame [m], of which the first `outline` lie on its outline,
    and its two radii [m]."""

    points: Array
    inscribed: float
    circumscribed: float
    outline: int


def sample_footprint(model: RobotModel, pitch: float = PITCH_M) -> FootprintSamples:
    """Outline points no further apart than `pitch`; the inner disc is checked by its centre."""
    corners = model.footprint
    sides = []
    for a, b in zip(corners, np.roll(corners, -1, axis=0), strict=True):
        count = max(1, math.ceil(float(np.linalg.norm(b - a)) / pitch))
        sides.append(a + (b - a) * (np.arange(count) / count)[:, None])
    outline = np.concatenate(sides)
    points = np.concatenate([outline, inner_points(corners, pitch)])
    return FootprintSamples(points, model.inscribed_radius, model.circumscribed_radius, len(outline))


def inner_points(corners: Array, pitch: float) -> Array:
    """A lattice inside the convex polygon, so that a thin post cannot hide within it."""
    low, high = corners.min(axis=0), corners.max(axis=0)
    xs = np.arange(low[0] + pitch / 2.0, high[0], pitch)
    ys = np.arange(low[1] + pitch / 2.0, high[1], pitch)
    points = np.stack(np.meshgrid(xs, ys), axis=-1).reshape(-1, 2)
    edges = np.roll(corners, -1, axis=0) - corners
    offset = points[:, None] - corners[None]
    left = edges[:, 0] * offset[..., 1] - edges[:, 1] * offset[..., 0]
    return points[np.all(left > 0.0, axis=1)]


@njit(cache=True)
def field_at(field: Field32, resolution: float, x: float, y: float) -> float:
    """Clearance at a point, bilinear between cell centres; 0 off the grid."""
    return field_at_cell(field, x / resolution - 0.5, y / resolution - 0.5)


@njit(cache=True)
def field_at_cell(field: Field32, u: float, v: float) -> float:
    """The same for a point by column and row, with fractions; (0, 0) is the centre of the first cell."""
    rows, cols = field.shape
    if u < -0.5 or v < -0.5 or u >= cols - 0.5 or v >= rows - 0.5:
        return 0.0
    u, v = min(max(u, 0.0), cols - 1.0), min(max(v, 0.0), rows - 1.0)
    col, row = int(u), int(v)
    du, dv = u - col, v - row
    col1, row1 = min(col + 1, cols - 1), min(row + 1, rows - 1)
    low = field[row, col] * (1.0 - du) + field[row, col1] * du
    high = field[row1, col] * (1.0 - du) + field[row1, col1] * du
    return low * (1.0 - dv) + high * dv


@njit(cache=True)
def footprint_clearance(
    field: Field32, resolution: float, footprint: FootprintSamples, x: float, y: float, yaw: float
) -> float:
    """Least clearance of the footprint at a pose [m]; a lower bound far from everything, <= 0 inside."""
    center = field_at(field, resolution, x, y)
    if center > footprint.circumscribed + 0.5:
        return center - footprint.circumscribed
    # In cells, as a division for each point takes longer than all else.
    points, least, per_metre = footprint.points, center - footprint.inscribed, 1.0 / resolution
    c, s = math.cos(yaw) * per_metre, math.sin(yaw) * per_metre
    u, v = x * per_metre - 0.5, y * per_metre - 0.5
    for k in range(len(points)):
        d = field_at_cell(
            field,
            u + c * points[k, 0] - s * points[k, 1],
            v + s * points[k, 0] + c * points[k, 1],
        )
        if d < least:
            least = d
            if least <= 0.0:
                return least
    return least


@njit(cache=True)
def footprint_free(field: Field32, resolution: float, corners: Array, x: float, y: float, yaw: float) -> bool:
    """Whether no lethal cell's centre lies in the convex polygon `corners` (n, 2), base frame, at a pose.

    Exact, where samples of the outline can straddle a wall one cell thick; all beyond the grid is lethal.
    """
    rows, cols = field.shape
    reach2 = 0.0
    for k in range(len(corners)):
        reach2 = max(reach2, corners[k, 0] ** 2 + corners[k, 1] ** 2)
    reach = math.sqrt(reach2)
    row, col = math.floor(y / resolution), math.floor(x / resolution)
    if row < 0 or col < 0 or row >= rows or col >= cols:
        return False
    if field[row, col] > reach + HALF_DIAGONAL * resolution:
        return True
    c, s = math.cos(yaw), math.sin(yaw)
    low_x, high_x, low_y, high_y = x, x, y, y
    for k in range(len(corners)):
        px = x + c * corners[k, 0] - s * corners[k, 1]
        py = y + s * corners[k, 0] + c * corners[k, 1]
        low_x, high_x, low_y, high_y = min(low_x, px), max(high_x, px), min(low_y, py), max(high_y, py)
    if low_x < 0.0 or low_y < 0.0 or high_x >= cols * resolution or high_y >= rows * resolution:
        return False
    first_c, last_c = math.ceil(low_x / resolution - 0.5), math.floor(high_x / resolution - 0.5)
    first_r, last_r = math.ceil(low_y / resolution - 0.5), math.floor(high_y / resolution - 0.5)
    for r in range(first_r, last_r + 1):
        for q in range(first_c, last_c + 1):
            if 0 <= r < rows and 0 <= q < cols and field[r, q] > 0.0:
                continue
            dx, dy = (q + 0.5) * resolution - x, (r + 0.5) * resolution - y
            if in_polygon(corners, c * dx + s * dy, c * dy - s * dx):
                return False
    return True


@njit(cache=True)
def in_polygon(corners: Array, x: float, y: float) -> bool:
    """Whether a point lies in a convex polygon (n, 2), counter-clockwise, its edges included."""
    n = len(corners)
    for k in range(n):
        ax, ay = corners[k, 0], corners[k, 1]
        bx, by = corners[(k + 1) % n, 0], corners[(k + 1) % n, 1]
        if (bx - ax) * (y - ay) - (by - ay) * (x - ax) < 0.0:
            return False
    return True


@njit(cache=True)
def disc_segment_free(
    field: Field32, resolution: float, radius: float, x0: float, y0: float, x1: float, y1: float
) -> bool:
    """Whether a disc can move straight from (x0, y0) to (x1, y1) with clearance above `radius` throughout.

    Each step is as long as the field proves free, and at least half a cell.
    """
    length = math.hypot(x1 - x0, y1 - y0)
    if field_at(field, resolution, x1, y1) <= radius:
        return False
    if length == 0.0:
        return True
    ux, uy = (x1 - x0) / length, (y1 - y0) / length
    t = 0.0
    while t < length:
        d = field_at(field, resolution, x0 + t * ux, y0 + t * uy)
        if d <= radius:
            return False
        t += max(d - radius, 0.5 * resolution)
    return True


@njit(cache=True)
def path_clearance(
    field: Field32,
    resolution: float,
    footprint: FootprintSamples,
    poses: Array,
    x: float,
    y: float,
    ahead: float,
) -> float:
    """Least footprint clearance over the poses (n, 3) of a path, from the one nearest (x, y) on [m]."""
    first, best = 0, np.inf
    for k in range(len(poses)):
        d = math.hypot(poses[k, 0] - x, poses[k, 1] - y)
        if d < best:
            best, first = d, k
    least, driven = np.inf, 0.0
    for k in range(first + 1, len(poses)):
        driven += math.hypot(poses[k, 0] - poses[k - 1, 0], poses[k, 1] - poses[k - 1, 1])
        if driven > ahead:
            break
        d = footprint_clearance(field, resolution, footprint, poses[k, 0], poses[k, 1], poses[k, 2])
        least = min(least, d)
    return least
