"""Path smoothing: shorter and rounder paths with the same clearance."""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np

from turtlebag.datasets.kernels import njit
from turtlebag.datasets.se2 import SE2, Array
from turtlebag.planners.footprint import Field32, disc_segment_free, field_at

SPACING_M = 0.05
"""Distance between a path's poses."""


@njit(cache=True)
def shortcut(field: Field32, resolution: float, radius: float, path: Array) -> Array:
    """Pull a polyline (n, 2) tight: greedy longest free chords, from both ends alternately."""
    points = path
    for _ in range(2):
        kept = np.empty_like(points)
        kept[0] = points[0]
        count, at, last = 1, 0, len(points) - 1
        while at < last:
            target = last
            while target > at + 1 and not disc_segment_free(
                field,
                resolution,
                radius,
                points[at, 0],
                points[at, 1],
                points[target, 0],
                points[target, 1],
            ):
                target -= 1
            kept[count] = points[target]
            count += 1
            at = target
        points = kept[:count][::-1].copy()
    return points


@njit(cache=True)
def densify(path: Array, spacing: float) -> Array:
    """The polyline (n, 2) with points no further apart than `spacing`; corners stay."""
    total = 1
    for k in range(len(path) - 1):
        length = math.hypot(path[k + 1, 0] - path[k, 0], path[k + 1, 1] - path[k, 1])
        total += max(1, math.ceil(length / spacing))
    out = np.empty((total, 2))
    out[0] = path[0]
    count = 1
    for k in range(len(path) - 1):
        length = math.hypot(path[k + 1, 0] - path[k, 0], path[k + 1, 1] - path[k, 1])
        steps = max(1, math.ceil(length / spacing))
        for i in range(1, steps + 1):
            f = i / steps
            out[count, 0] = path[k, 0] + f * (path[k + 1, 0] - path[k, 0])
            out[count, 1] = path[k, 1] + f * (path[k + 1, 1] - path[k, 1])
            count += 1
    return out


class Band(NamedTuple):
    """How an elastic band pulls and pushes.

    Each point is drawn to the middle of its neighbours (`pull`) and, nearer than `reach` [m] to an obstacle,
    up the clearance's gradient (`push`) by the inflated cost exp(-fade * (d - radius)), relative to its value
    at `reach`.
    """

    reach: float
    fade: float
    pull: float
    push: float
    iterations: int


@njit(cache=True)
def relax(field: Field32, resolution: float, radius: float, path: Array, band: Band) -> Array:
    """Elastic band (Quinlan and Khatib 1993) over a dense polyline (n, 2) with fixed ends. A move that brings
    a point to `radius` is not made."""
    reach, fade, pull, push, iterations = band
    out = path.copy()
    h = resolution
    for _ in range(iterations):
        for k in range(1, len(out) - 1):
            x, y = out[k, 0], out[k, 1]
            dx = pull * (0.5 * (out[k - 1, 0] + out[k + 1, 0]) - x)
            dy = pull * (0.5 * (out[k - 1, 1] + out[k + 1, 1]) - y)
            d = field_at(field, resolution, x, y)
            if d < reach:
                gx = field_at(field, resolution, x + h, y) - field_at(field, resolution, x - h, y)
                gy = field_at(field, resolution, x, y + h) - field_at(field, resolution, x, y - h)
                norm = math.hypot(gx, gy)
                if norm > 0.0:
                    cost = (math.exp(-fade * (d - radius)) - math.exp(-fade * (reach - radius))) / fade
                    dx += push * cost * gx / norm
                    dy += push * cost * gy / norm
            moved = field_at(field, resolution, x + dx, y + dy)
            if moved > radius or moved > d:
                out[k, 0], out[k, 1] = x + dx, y + dy
    return out


def path_length(points: Array) -> float:
    """Length of a polyline (n, 2) [m]."""
    return float(np.linalg.norm(np.diff(points, axis=0), axis=1).sum())


def with_headings(points: Array, start_yaw: float, goal_yaw: float) -> SE2:
    """Poses along a polyline (n, 2), each heading along the path; start and goal keep their yaw."""
    yaw = np.empty(len(points))
    steps = np.diff(points, axis=0)
    yaw[:-1] = np.arctan2(steps[:, 1], steps[:, 0])
    yaw[0], yaw[-1] = start_yaw, goal_yaw
    return SE2.from_xyt(points[:, 0], points[:, 1], yaw)
