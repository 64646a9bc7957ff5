"""Compiled 2D ray casting against outlines, and the distance from a footprint to them."""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

from turtlebag.datasets.kernels import njit
from turtlebag.datasets.se2 import Array


@njit(cache=True)
def _point_segment(px: float, py: float, ax: float, ay: float, bx: float, by: float) -> float:
    ex, ey = bx - ax, by - ay
    square = ex * ex + ey * ey
    u = 0.0 if square == 0.0 else min(1.0, max(0.0, ((px - ax) * ex + (py - ay) * ey) / square))
    return math.hypot(px - ax - u * ex, py - ay - u * ey)


@njit(cache=True)
def _to_segment(ox: float, oy: float, dx: float, dy: float, segment: Array) -> float:
    """Distance along a ray to a segment, +inf when it misses: a + u e = t d, by Cramer's rule."""
    ax, ay = segment[0] - ox, segment[1] - oy
    ex, ey = segment[2] - segment[0], segment[3] - segment[1]
    det = dx * ey - dy * ex
    if det == 0.0:
        return math.inf
    t = (ax * ey - ay * ex) / det
    u = (ax * dy - ay * dx) / det
    return t if t >= 0.0 and 0.0 <= u <= 1.0 else math.inf


@njit(cache=True)
def through_circle(ox: float, oy: float, dx: float, dy: float, circle: Array) -> tuple:
    """Where a ray enters and leaves a circle, in > out when it misses. From within, `in` is negative."""
    cx, cy, r = circle[0] - ox, circle[1] - oy, circle[2]
    along = cx * dx + cy * dy
    inside = along * along - (cx * cx + cy * cy - r * r)
    if inside < 0.0:
        return math.inf, -math.inf
    root = math.sqrt(inside)
    return along - root, along + root


def cast(
    origins: Array, directions: Array, bearings: Array, outlines: tuple[Array, Array], limit: float
) -> tuple[Array, NDArray[np.int64]]:
    """Distance to the first outline along each ray, and which outline that is.

    The rays fan out from nearly one place. origins (n, 2), unit directions (n, 2) and their angles (n,), not
    wrapped; outlines are segments (s, 4) and circles (c, 3); limit [m]. Returns ranges (n,), +inf beyond the
    limit, and indices (n,): 0..s-1 a segment, s..s+c-1 a circle, -1 none.
    """
    if np.all(bearings[1:] >= bearings[:-1]):
        return _cast(origins, directions, bearings, *outlines, limit)  # type: ignore[no-any-return]
    # The robot spins against the lidar as fast as that turns.
    order = np.argsort(bearings, kind="stable")
    ranges, hits = _cast(origins[order], directions[order], bearings[order], *outlines, limit)
    back = np.argsort(order)
    return ranges[back], hits[back]


@njit(cache=True)
def _cast(
    origins: Array, directions: Array, bearings: Array, segments: Array, circles: Array, limit: float
) -> tuple:
    """Rays by rising bearings. Each outline is tried only on those whose bearing it can meet: as seen from
    the middle of the origins, widened by how far the origins stray from there."""
    n, n_segments = origins.shape[0], segments.shape[0]
    ranges = np.full(n, math.inf)
    hits = np.full(n, -1, dtype=np.int64)
    if n == 0:
        return ranges, hits
    mx, my = 0.5 * (origins[0, 0] + origins[n - 1, 0]), 0.5 * (origins[0, 1] + origins[n - 1, 1])
    stray = 0.0
    for i in range(n):
        stray = max(stray, math.hypot(origins[i, 0] - mx, origins[i, 1] - my))
    for k in range(n_segments + circles.shape[0]):
        if k < n_segments:
            ax, ay, bx, by = (
                segments[k, 0] - mx,
                segments[k, 1] - my,
                segments[k, 2] - mx,
                segments[k, 3] - my,
            )
            near = _point_segment(0.0, 0.0, ax, ay, bx, by)
            half = 0.5 * abs(math.atan2(ax * by - ay * bx, ax * bx + ay * by))
            # The middle of the bearings of two ends less than half a turn apart.
            fa, fb = math.hypot(ax, ay), math.hypot(bx, by)
            middle = math.atan2(ay * fb + by * fa, ax * fb + bx * fa)
            blur = stray
        else:
            cx, cy = circles[k - n_segments, 0] - mx, circles[k - n_segments, 1] - my
            near, half, middle = math.hypot(cx, cy), 0.0, math.atan2(cy, cx)
            blur = stray + circles[k - n_segments, 2]
        if near - blur > limit + stray:
            continue
        half = math.pi if near <= 1.01 * blur + 1e-9 else half + math.asin(blur / near) + 1e-9
        # Every whole turn that brings the interval over the fan.
        turn = math.floor((bearings[0] - middle - half) / (2.0 * math.pi))
        start = 0
        while start < n:
            low, high = middle - half + turn * 2.0 * math.pi, middle + half + turn * 2.0 * math.pi
            if low > bearings[n - 1]:
                break
            i = max(start, np.searchsorted(bearings, low))
            while i < n and bearings[i] <= high:
                ox, oy, dx, dy = origins[i, 0], origins[i, 1], directions[i, 0], directions[i, 1]
                if k < n_segments:
                    t = _to_segment(ox, oy, dx, dy, segments[k])
                else:
                    t, leave = through_circle(ox, oy, dx, dy, circles[k - n_segments])
                    if t < 0.0:
                        t = leave if leave >= 0.0 else math.inf
                if t < ranges[i] and t <= limit:
                    ranges[i], hits[i] = t, k
                i += 1
            start = i
            turn += 1
    return ranges, hits


@njit(cache=True)
def beam_rays(poses: Array, when: Array, lidar: Array, angles: Array) -> tuple:
    """Origins (n, 2), directions (n, 2) and bearings (n,) of beams taken while the base moves.

    poses (k, 3) are base poses at equal steps over the sweep, `when` (n,) the place of each beam in
    it (0 the first pose, k - 1 the last), `lidar` (3,) the lidar in the base frame, `angles` (n,).
    Straight in position and the shortest way in yaw between poses.
    """
    n = angles.shape[0]
    origins = np.empty((n, 2))
    directions = np.empty((n, 2))
    bearings = np.empty(n)
    # Yaw without its jumps, so that bearings rise.
    yaws = poses[:, 2].copy()
    for k in range(1, yaws.shape[0]):
        yaws[k] = yaws[k - 1] + (poses[k, 2] - poses[k - 1, 2] + math.pi) % (2.0 * math.pi) - math.pi
    for i in range(n):
        lo = int(when[i])
        if lo > poses.shape[0] - 2:
            lo = max(poses.shape[0] - 2, 0)
        hi = min(lo + 1, poses.shape[0] - 1)
        f = when[i] - lo
        x = poses[lo, 0] + f * (poses[hi, 0] - poses[lo, 0])
        y = poses[lo, 1] + f * (poses[hi, 1] - poses[lo, 1])
        yaw = yaws[lo] + f * (yaws[hi] - yaws[lo])
        c, s = math.cos(yaw), math.sin(yaw)
        origins[i, 0] = x + c * lidar[0] - s * lidar[1]
        origins[i, 1] = y + s * lidar[0] + c * lidar[1]
        angle = yaw + lidar[2] + angles[i]
        directions[i, 0], directions[i, 1] = math.cos(angle), math.sin(angle)
        bearings[i] = angle
    return origins, directions, bearings


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


@njit(cache=True)
def keeps_clear(line: Array, need: float, segments: Array, circles: Array) -> bool:
    """Whether every point of a line (n, 2) is farther than `need` [m] from the nearest outline."""
    n = line.shape[0]
    mx, my = 0.5 * (line[0, 0] + line[n - 1, 0]), 0.5 * (line[0, 1] + line[n - 1, 1])
    reach = need + 1e-9
    for i in range(n):
        reach = max(reach, math.hypot(line[i, 0] - mx, line[i, 1] - my) + need + 1e-9)
    for k in range(segments.shape[0] + circles.shape[0]):
        j = max(k - segments.shape[0], 0)
        one = segments[k : k + 1], circles[j : j + (k >= segments.shape[0])]
        if distance_to_point(mx, my, *one) > reach:
            continue
        for i in range(n):
            if not distance_to_point(line[i, 0], line[i, 1], *one) > need:
                return False
    return True


@njit(cache=True)
def first_with_room(points: Array, need: float, segments: Array, circles: Array) -> int:
    """Number of the first of the points (n, 2) that is farther than `need` [m] from every outline; without
    one, of the first that is farthest."""
    best, farthest = 0, -1.0
    for k in range(points.shape[0]):
        room = distance_to_point(points[k, 0], points[k, 1], segments, circles)
        if room > farthest:
            best, farthest = k, room
        if room > need:
            break
    return best


@njit(cache=True)
def _near_outlines(x: float, y: float, reach: float, segments: Array, circles: Array) -> tuple:
    """The outlines of which one is the nearest for every point within `reach` [m] of a place."""
    n, m = segments.shape[0], circles.shape[0]
    room = np.empty(n + m)
    for k in range(n):
        room[k] = distance_to_point(x, y, segments[k : k + 1], circles[:0])
    for k in range(m):
        room[n + k] = distance_to_point(x, y, segments[:0], circles[k : k + 1])
    # A step changes no distance by more than its own length.
    near = room <= (room.min() if n + m else 0.0) + 2.0 * reach + 1e-9
    return segments[near[:n]], circles[near[n:]]


BLOCK = 16
"""Cells on a side that look for their nearest outline among the same few."""


@njit(cache=True)
def roomiest(x: Array, y: Array, half: float, need: float, segments: Array, circles: Array) -> tuple:
    """In each cell about (x[c], y[r]) the middle or, where that has barely less room than needed, the best.

    `half` is half a cell [m]; the best of nine points counts. Returns distances to the nearest
    outline (r, c) and the points (r, c, 2).
    """
    room = np.empty((y.shape[0], x.shape[0]))
    points = np.empty((y.shape[0], x.shape[0], 2))
    for r0 in range(0, y.shape[0], BLOCK):
        for c0 in range(0, x.shape[0], BLOCK):
            r1, c1 = min(r0 + BLOCK, y.shape[0]), min(c0 + BLOCK, x.shape[0])
            mx, my = 0.5 * (x[c0] + x[c1 - 1]), 0.5 * (y[r0] + y[r1 - 1])
            reach = math.hypot(x[c1 - 1] - mx + half, y[r1 - 1] - my + half)
            near, round_ones = _near_outlines(mx, my, reach, segments, circles)
            for r in range(r0, r1):
                for c in range(c0, c1):
                    best = _roomiest_point(x[c], y[r], half, need, near, round_ones)
                    room[r, c], points[r, c, 0], points[r, c, 1] = best
    return room, points


@njit(cache=True)
def _roomiest_point(x: float, y: float, half: float, need: float, segments: Array, circles: Array) -> tuple:
    """Room of one cell [m], and where."""
    room, best_x, best_y = distance_to_point(x, y, segments, circles), x, y
    if need - 1.5 * half < room <= need:
        for k in range(9):
            px, py = x + (k % 3 - 1) * half * 0.8, y + (k // 3 - 1) * half * 0.8
            d = distance_to_point(px, py, segments, circles)
            if d > room:
                room, best_x, best_y = d, px, py
    return room, best_x, best_y
