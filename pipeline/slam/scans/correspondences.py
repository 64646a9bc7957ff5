"""Correspondences between the points of a scan and the lines of key scans.

Correspondences are projective: a point is looked up by its bearing in the key scan, and the nearest
of the points around that bearing is taken. No search tree is needed, and points that the key scan could
not have seen (behind its walls) get no correspondence.
"""

from __future__ import annotations

import math
from typing import NamedTuple

from turtlebag.datasets.bearing import bearing
from turtlebag.datasets.kernels import njit
from turtlebag.datasets.point_to_line import Jacobian, linearise
from turtlebag.datasets.se2 import Array
from turtlebag.pipeline.slam.scans.clouds import Clouds

# The number of points of one scan among thousands.
MOST_POINTS = 400
# Gate and kernel are at least this many standard deviations of a point's noise wide.
SIGMAS = 3.0
# A point is searched within this many bearings to either side.
MAX_HALF_WINDOW = 10
# Surfaces whose normals agree by less than this (cosine) are different surfaces.
MIN_NORMAL_DOT = 0.6


class Limits(NamedTuple):
    """Points further apart than `gate` [m] are no partners; `sigma` [m] is the width of the robust kernel,
    where there is one. An alignment ends after `iterations`; with none, it returns the fit at the start.
    Scans with more than `most_points` are thinned to every second, third, ... point."""

    gate: float
    sigma: float
    iterations: int = 15
    most_points: int = 10**6

    @staticmethod
    def rough() -> Limits:
        """For rough poses."""
        return ROUGH

    @staticmethod
    def fine() -> Limits:
        """For good poses."""
        return FINE

    @staticmethod
    def between(progress: float) -> Limits:
        """From rough (0) to fine (1), by equal factors."""
        gate = ROUGH.gate * (FINE.gate / ROUGH.gate) ** progress
        return Limits(gate, ROUGH.sigma * (FINE.sigma / ROUGH.sigma) ** progress)

    def of_one_scan(self, iterations: int) -> Limits:
        """For one scan among thousands: so many iterations, with a part of its points."""
        return self._replace(iterations=iterations, most_points=MOST_POINTS)


ROUGH, FINE = Limits(0.3, 0.05), Limits(0.1, 0.03)


# Kernels called once per point are inlined: passing the arrays of Clouds on took 15 % of mapping. They make
# no arrays, so they need no reference counts (`_nrt`), which took another 12 %.


@njit(cache=True, forceinline=True, _nrt=False)
def find_partner(x: float, y: float, key: int, clouds: Clouds, gate: float) -> int:
    """Row of the point of scan `key` nearest to (x, y) in that scan's base frame, or -1 beyond `gate`."""
    points, table, lidar = clouds.points, clouds.table, clouds.sensor[key]
    n_bins = clouds.bins[lidar]
    scale = n_bins / (2.0 * math.pi)
    dx, dy = x - clouds.origin[lidar, 0], y - clouds.origin[lidar, 1]
    r = math.sqrt(dx * dx + dy * dy)
    b = int((bearing(dy, dx) + math.pi) * scale)
    half = min(MAX_HALF_WINDOW, n_bins // 2)
    if r > gate:
        half = min(half, int(gate / r * scale) + 1)
    best, best_d2, away = -1, gate * gate, 0
    # Outwards, until all remaining points must be farther than the best: at an angle a, nothing is nearer
    # than r sin a. Of two at the same distance, the one at the smaller bearing counts.
    while away <= half:
        for side in range(2 if away > 0 else 1):
            k = b - away if side == 0 else b + away
            if k < 0:
                k += n_bins
            elif k >= n_bins:
                k -= n_bins
            row = table[key, k]
            if row < 0:
                continue
            ex, ey = points[row, 0] - x, points[row, 1] - y
            d2 = ex * ex + ey * ey
            if d2 < best_d2 or (d2 == best_d2 and side == 0 and best >= 0):
                best, best_d2 = row, d2
                if d2 < 0.25 * r * r:
                    sine = math.sqrt(d2) / r  # of an angle of less than sine + sine^3 / 5
                    half = min(half, 1 + int(sine * (1.0 + 0.2 * sine * sine) * scale))
        away += 1
    return best


@njit(cache=True, forceinline=True, _nrt=False)
def sees(x: float, y: float, key: int, clouds: Clouds, margin: float) -> bool:
    """Whether scan `key` had (x, y), in its base frame, in view: all beams around that bearing, at least two,
    reached it to within `margin` [m]."""
    points, table, lidar = clouds.points, clouds.table, clouds.sensor[key]
    n_bins, ox, oy = clouds.bins[lidar], clouds.origin[lidar, 0], clouds.origin[lidar, 1]
    dx, dy = x - ox, y - oy
    r = math.sqrt(dx * dx + dy * dy)
    b = int((bearing(dy, dx) + math.pi) * n_bins / (2.0 * math.pi))
    beams = 0
    for k in range(b - 1, b + 2):
        row = table[key, k % n_bins]
        if row < 0:
            continue
        if math.hypot(points[row, 0] - ox, points[row, 1] - oy) < r - margin:
            return False
        beams += 1
    return beams >= 2


@njit(cache=True, forceinline=True)
def relative_pose(poses: Array, i: int, j: int) -> tuple[float, float, float]:
    """T_i_j as x, y, yaw, of rows i and j of poses (n, 3)."""
    c, s = math.cos(poses[i, 2]), math.sin(poses[i, 2])
    dx, dy = poses[j, 0] - poses[i, 0], poses[j, 1] - poses[i, 1]
    return c * dx + s * dy, -s * dx + c * dy, poses[j, 2] - poses[i, 2]


@njit(cache=True, forceinline=True, _nrt=False)
def tolerance(clouds: Clouds, r: int, limits: Limits) -> tuple[float, float]:
    """How far point `r` may be off: 1 / sigma^2 of its robust kernel [1/m^2], and its gate [m]. Neither sigma
    nor gate is narrower than SIGMAS of its noise."""
    kernel2 = max(limits.sigma * limits.sigma, SIGMAS * SIGMAS * clouds.point_var[r])
    return 1.0 / kernel2, max(limits.gate, math.sqrt(kernel2))


@njit(cache=True, forceinline=True, _nrt=False)
def find_line(
    clouds: Clouds, r: int, key: int, T_key_scan: tuple[float, float, float, float], reach: float
) -> int:
    """Row of scan `key` whose line point `r` may lie on, or -1; T_key_scan is as in `linearise`."""
    tx, ty, c, s = T_key_scan
    px, py = clouds.points[r, 0], clouds.points[r, 1]
    row = find_partner(tx + c * px - s * py, ty + s * px + c * py, key, clouds, reach)
    return row if row >= 0 and clouds.line_ok[row] else -1


@njit(cache=True, forceinline=True, _nrt=False)
def equation(
    clouds: Clouds,
    r: int,
    row: int,
    T_key_scan: tuple[float, float, float, float],
    inv_s2: float,
    reach: float,
) -> tuple[float, float, Jacobian]:
    """`linearise` of point `r` and the line of a row: e, w/s^2, j. No weight where there is no line
    (-1), where the two surfaces face different ways, or where they are farther apart than `reach` [m]."""
    if row < 0:
        return 0.0, 0.0, (0.0, 0.0, 0.0)
    points, normals, centers = clouds.points, clouds.normals, clouds.centers
    line = (normals[row, 0], normals[row, 1], centers[row, 0], centers[row, 1])
    e, w, j = linearise(T_key_scan, (points[r, 0], points[r, 1]), line, inv_s2)
    if j[0] * normals[r, 0] + j[1] * normals[r, 1] < MIN_NORMAL_DOT or abs(e) > reach:
        return 0.0, 0.0, j
    return e, w * inv_s2, j


@njit(cache=True, forceinline=True, _nrt=False)
def partner_line(
    clouds: Clouds, r: int, key: int, T_key_scan: tuple[float, float, float, float], limits: Limits
) -> tuple[int, float, float, Jacobian]:
    """The line of scan `key` that point `r` lies on: row, or -1, and its `equation`."""
    inv_s2, reach = tolerance(clouds, r, limits)
    row = find_line(clouds, r, key, T_key_scan, reach)
    e, w, j = equation(clouds, r, row, T_key_scan, inv_s2, reach)
    return row if w > 0.0 else -1, e, w, j
