"""Planar geometry in compiled loops: rays against outlines, and the distance from a footprint to them."""

from __future__ import annotations

import math

import numpy as np
from numba import njit

from datasets.se2 import Array


@njit(cache=True)
def cast(origins: Array, directions: Array, segments: Array, circles: Array, limit: float) -> tuple:
    """Distance to the first outline along each ray, and which outline that is.

    origins (n, 2), unit directions (n, 2), segments (s, 4), circles (c, 3), limit [m]. Returns
    ranges (n,), +inf beyond the limit, and indices (n,): 0..s-1 a segment, s..s+c-1 a circle, -1 none.
    """
    n = origins.shape[0]
    ranges = np.empty(n)
    hits = np.empty(n, dtype=np.int64)
    n_segments = segments.shape[0]
    for i in range(n):
        ox, oy, dx, dy = origins[i, 0], origins[i, 1], directions[i, 0], directions[i, 1]
        best, hit = limit, -1
        for k in range(n_segments):
            ax, ay = segments[k, 0] - ox, segments[k, 1] - oy
            ex, ey = segments[k, 2] - segments[k, 0], segments[k, 3] - segments[k, 1]
            det = dx * ey - dy * ex
            if det == 0.0:
                continue
            # a + u e = t d, by Cramer's rule.
            t = (ax * ey - ay * ex) / det
            if t < 0.0 or t > best:
                continue
            u = (ax * dy - ay * dx) / det
            if 0.0 <= u <= 1.0:
                best, hit = t, k
        for k in range(circles.shape[0]):
            cx, cy, r = circles[k, 0] - ox, circles[k, 1] - oy, circles[k, 2]
            along = cx * dx + cy * dy
            off = cx * cx + cy * cy - r * r
            inside = along * along - off
            if inside < 0.0:
                continue
            t = along - math.sqrt(inside)
            if t < 0.0:
                t = along + math.sqrt(inside)
            if 0.0 <= t <= best:
                best, hit = t, n_segments + k
        ranges[i] = best if hit >= 0 else math.inf
        hits[i] = hit
    return ranges, hits


@njit(cache=True)
def beam_rays(poses: Array, when: Array, lidar: Array, angles: Array) -> tuple:
    """Origins and directions of beams taken while the base moves.

    poses (k, 3) are base poses at equal steps over the sweep, `when` (n,) the place of each beam in
    it (0 the first pose, k - 1 the last), `lidar` (3,) the lidar in the base frame, `angles` (n,).
    Straight in position and the shortest way in yaw between poses.
    """
    n = angles.shape[0]
    origins = np.empty((n, 2))
    directions = np.empty((n, 2))
    for i in range(n):
        lo = int(when[i])
        if lo > poses.shape[0] - 2:
            lo = max(poses.shape[0] - 2, 0)
        hi = min(lo + 1, poses.shape[0] - 1)
        f = when[i] - lo
        turn = (poses[hi, 2] - poses[lo, 2] + math.pi) % (2.0 * math.pi) - math.pi
        x = poses[lo, 0] + f * (poses[hi, 0] - poses[lo, 0])
        y = poses[lo, 1] + f * (poses[hi, 1] - poses[lo, 1])
        yaw = poses[lo, 2] + f * turn
        c, s = math.cos(yaw), math.sin(yaw)
        origins[i, 0] = x + c * lidar[0] - s * lidar[1]
        origins[i, 1] = y + s * lidar[0] + c * lidar[1]
        angle = yaw + lidar[2] + angles[i]
        directions[i, 0], directions[i, 1] = math.cos(angle), math.sin(angle)
    return origins, directions


@njit(cache=True)
def _point_segment(px: float, py: float, ax: float, ay: float, bx: float, by: float) -> float:
    ex, ey = bx - ax, by - ay
    square = ex * ex + ey * ey
    u = 0.0 if square == 0.0 else min(1.0, max(0.0, ((px - ax) * ex + (py - ay) * ey) / square))
    return math.hypot(px - ax - u * ex, py - ay - u * ey)


@njit(cache=True)
def _inside(px: float, py: float, polygon: Array) -> bool:
    for i in range(polygon.shape[0]):
        j = (i + 1) % polygon.shape[0]
        ex, ey = polygon[j, 0] - polygon[i, 0], polygon[j, 1] - polygon[i, 1]
        if ex * (py - polygon[i, 1]) - ey * (px - polygon[i, 0]) < 0.0:
            return False
    return True


@njit(cache=True)
def distance_to_outlines(polygon: Array, segments: Array, circles: Array) -> float:
    """Distance from a convex counter-clockwise polygon (n, 2) to the nearest outline; 0 when they overlap.

    A polygon wholly inside a prism is not recognised: nothing drives there.
    """
    best = math.inf
    n = polygon.shape[0]
    for k in range(segments.shape[0]):
        ax, ay, bx, by = segments[k, 0], segments[k, 1], segments[k, 2], segments[k, 3]
        if _inside(ax, ay, polygon) or _inside(bx, by, polygon):
            return 0.0
        for i in range(n):
            px, py = polygon[i, 0], polygon[i, 1]
            qx, qy = polygon[(i + 1) % n, 0], polygon[(i + 1) % n, 1]
            # Two segments that cross have distance 0; else the nearest pair holds an end point.
            d1 = (bx - ax) * (py - ay) - (by - ay) * (px - ax)
            d2 = (bx - ax) * (qy - ay) - (by - ay) * (qx - ax)
            d3 = (qx - px) * (ay - py) - (qy - py) * (ax - px)
            d4 = (qx - px) * (by - py) - (qy - py) * (bx - px)
            if d1 * d2 < 0.0 and d3 * d4 < 0.0:
                return 0.0
            best = min(best, _point_segment(px, py, ax, ay, bx, by))
            best = min(best, _point_segment(ax, ay, px, py, qx, qy))
            best = min(best, _point_segment(bx, by, px, py, qx, qy))
    for k in range(circles.shape[0]):
        cx, cy, r = circles[k, 0], circles[k, 1], circles[k, 2]
        if _inside(cx, cy, polygon):
            return 0.0
        for i in range(n):
            j = (i + 1) % n
            edge = _point_segment(cx, cy, polygon[i, 0], polygon[i, 1], polygon[j, 0], polygon[j, 1])
            best = min(best, max(edge - r, 0.0))
    return best


@njit(cache=True)
def distance_to_point(x: float, y: float, segments: Array, circles: Array) -> float:
    """Distance from a point to the nearest outline [m]."""
    best = math.inf
    for k in range(segments.shape[0]):
        best = min(best, _point_segment(x, y, segments[k, 0], segments[k, 1], segments[k, 2], segments[k, 3]))
    for k in range(circles.shape[0]):
        best = min(best, abs(math.hypot(x - circles[k, 0], y - circles[k, 1]) - circles[k, 2]))
    return best
