"""Correlative scan matching: the best pose within a window by exhaustive scoring on a smoothed field.

After Olson (2009), "Real-time correlative scan matching": the field holds, per cell, how near the
nearest reference point is; a pose's score is the mean of the field under the scan's points. What no
reference scan saw is neither hit nor miss: a robot that enters a room is not held back at its door.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from turtlebag.datasets.kernels import njit
from turtlebag.datasets.se2 import Array
from turtlebag.pipeline.slam.scans.clouds import Clouds

# The score of an unseen cell, 0..255.
HIT, UNSEEN = 255, 128
# The influence of a point, one cell wide as a Gaussian, ends after this many cells.
REACH = 3
# Turns of a coarse search [rad].
TURN_RAD = 0.03


class Field(NamedTuple):
    """Scores 0..255 by cell; row 0 has the lowest y. `corner` is the outer corner of cell (0, 0) [m]."""

    values: NDArray[np.uint8]
    corner: Array
    resolution: float


def make_field(clouds: Clouds, keys: NDArray[np.int64], T_map_keys: Array, resolution: float) -> Field:
    """Field of key scans at poses (k, 3), smoothed: a point's influence falls off by one cell."""
    points = points_in_map(clouds.points, clouds.starts, np.asarray(keys, dtype=np.int64), T_map_keys)
    if len(points) == 0:
        return Field(np.full((1, 1), UNSEEN, dtype=np.uint8), np.zeros(2), resolution)
    margin = (REACH + 2.0) * resolution
    corner = points.min(axis=0) - margin
    cols, rows = np.ceil((points.max(axis=0) + margin - corner) / resolution).astype(int) + 1
    offsets = np.arange(-REACH, REACH + 1)
    stamp = np.exp(-0.5 * (offsets[:, None] ** 2 + offsets[None, :] ** 2))
    values = np.full((rows, cols), UNSEEN, dtype=np.uint8)
    _see_through(values, clouds, np.asarray(keys, dtype=np.int64), T_map_keys, corner, resolution)
    _splat(values, points, corner, resolution, np.round(HIT * stamp).astype(np.uint8))
    return Field(values, corner, resolution)


def best_pose(
    field: Field, points: Array, center: Array, window_m: float, window_rad: float, step_rad: float = TURN_RAD
) -> tuple[Array, float]:
    """Best pose (3,) about `center` and its score (0..1); ties go to the pose nearest the centre.

    Exhaustive over translations in steps of the field's resolution and rotations of `step_rad`.
    """
    # One array layout only, because another would be compiled separately.
    return _search(
        field,
        np.ascontiguousarray(points),
        np.asarray(center),
        math.ceil(window_m / field.resolution),
        math.ceil(window_rad / step_rad),
        step_rad,
    )


@njit(cache=True)
def points_in_map(points: Array, starts: NDArray, keys: NDArray, poses: Array) -> Array:
    """Points of the scans `keys` at `poses` (k, 3), one after another, (m, 2)."""
    total = 0
    for key in keys:
        total += starts[key + 1] - starts[key]
    out = np.empty((total, 2))
    row = 0
    for k in range(len(keys)):
        c, s = math.cos(poses[k, 2]), math.sin(poses[k, 2])
        for i in range(starts[keys[k]], starts[keys[k] + 1]):
            out[row, 0] = poses[k, 0] + c * points[i, 0] - s * points[i, 1]
            out[row, 1] = poses[k, 1] + s * points[i, 0] + c * points[i, 1]
            row += 1
    return out


@njit(cache=True)
def _see_through(
    values: NDArray, clouds: Clouds, keys: NDArray, poses: Array, corner: Array, resolution: float
) -> None:
    """Clear the cells that beams of the scans `keys` passed."""
    rows, cols = values.shape
    for k in range(len(keys)):
        c, s = math.cos(poses[k, 2]), math.sin(poses[k, 2])
        lidar = clouds.sensor[keys[k]]
        lx, ly = clouds.origin[lidar, 0], clouds.origin[lidar, 1]
        ox = (poses[k, 0] + c * lx - s * ly - corner[0]) / resolution
        oy = (poses[k, 1] + s * lx + c * ly - corner[1]) / resolution
        for i in range(clouds.starts[keys[k]], clouds.starts[keys[k] + 1]):
            x, y = clouds.points[i, 0], clouds.points[i, 1]
            dx = (poses[k, 0] + c * x - s * y - corner[0]) / resolution - ox
            dy = (poses[k, 1] + s * x + c * y - corner[1]) / resolution - oy
            steps = int(max(abs(dx), abs(dy)))
            for step in range(steps):
                col, row = math.floor(ox + dx * step / steps), math.floor(oy + dy * step / steps)
                if 0 <= row < rows and 0 <= col < cols:
                    values[row, col] = 0


@njit(cache=True)
def _splat(values: NDArray, points: Array, corner: Array, resolution: float, stamp: NDArray) -> None:
    reach = stamp.shape[0] // 2
    done = np.zeros(values.shape, dtype=np.bool_)
    for i in range(len(points)):
        col = int((points[i, 0] - corner[0]) / resolution)
        row = int((points[i, 1] - corner[1]) / resolution)
        if done[row, col]:
            continue
        done[row, col] = True
        for dr in range(-reach, reach + 1):
            for dc in range(-reach, reach + 1):
                v = stamp[dr + reach, dc + reach]
                if v > values[row + dr, col + dc]:
                    values[row + dr, col + dc] = v


@njit(cache=True)
def _search(
    field: Field, points: Array, center: Array, n_xy: int, n_yaw: int, step_rad: float
) -> tuple[Array, float]:
    values, corner, resolution = field
    rows, cols = values.shape
    n = len(points)
    side = 2 * n_xy + 1
    best = -1.0
    pose = center.copy()
    sums = np.zeros((side, side), dtype=np.int64)
    for a in range(-n_yaw, n_yaw + 1):
        yaw = center[2] + a * step_rad
        c, s = math.cos(yaw), math.sin(yaw)
        sums[:] = n * UNSEEN
        for i in range(n):
            x = (center[0] + c * points[i, 0] - s * points[i, 1] - corner[0]) / resolution
            y = (center[1] + s * points[i, 0] + c * points[i, 1] - corner[1]) / resolution
            col, row = math.floor(x), math.floor(y)
            for dr in range(side):
                r = row + dr - n_xy
                if r < 0 or r >= rows:
                    continue
                for dc in range(side):
                    q = col + dc - n_xy
                    if 0 <= q < cols:
                        sums[dr, dc] += int(values[r, q]) - UNSEEN
        for dr in range(side):
            for dc in range(side):
                # a hair of preference for the centre, so that a flat score means "stay"
                off = abs(dr - n_xy) + abs(dc - n_xy) + abs(a)
                score = sums[dr, dc] - 1e-3 * max(n, 1) * off
                if score > best:
                    best = score
                    pose[0] = center[0] + (dc - n_xy) * resolution
                    pose[1] = center[1] + (dr - n_xy) * resolution
                    pose[2] = yaw
    return pose, max(best, 0.0) / (HIT * max(n, 1))
