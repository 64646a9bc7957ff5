"""A scan as the filter wants it: end points in the base frame at the scan's stamp, motion undone."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from datasets.se2 import SE2, Array
from datasets.types import Scan


@dataclass(frozen=True, eq=False)
class Beams:
    """The measured beams of one scan.

    `points` (n, 2) and `origins` (n, 2) are in the base frame at the scan's stamp [m]; `ranges` is (n,).
    `silent_directions` (k, 2) are the unit vectors of beams without return, `silent_origins` (k, 2).
    """

    points: Array
    origins: Array
    ranges: Array
    silent_directions: Array
    silent_origins: Array

    def __len__(self) -> int:
        return len(self.points)


def prepare(
    scan: Scan,
    T_base_lidar: SE2,
    T_start_end: SE2 | None = None,
    range_limits: tuple[float, float] | None = None,
) -> Beams:
    """Beams of a scan; `T_start_end` is the base's motion over the whole sweep, if known.

    With it, and a turning lidar, beam i is seen from where the base was i * time_increment after the
    stamp. NaN and -inf are dropped, +inf counts as "no return".
    """
    ranges = scan.ranges.astype(np.float64)
    low, high = range_limits or (scan.lidar.range_min, scan.lidar.range_max)
    hit = scan.valid() & (ranges >= low) & (ranges <= high)
    silent = np.isposinf(ranges)
    T_start_lidar = _lidar_poses(scan, T_base_lidar, T_start_end)
    directions = _rotate(T_start_lidar, scan.lidar.directions)
    origins = np.broadcast_to(T_start_lidar.xy, directions.shape)
    points = origins[hit] + directions[hit] * ranges[hit, None]
    return Beams(points, origins[hit].copy(), ranges[hit], directions[silent], origins[silent].copy())


def spread(count: int, most: int) -> NDArray[np.int64]:
    """At most `most` indices, evenly spaced over `count`."""
    if count <= most:
        return np.arange(count)
    return (np.arange(most) * count) // most


def arc(T_start_end: SE2, fractions: Array) -> SE2:
    """Poses at fractions of a motion of constant twist, (n,): the exponential of SE(2)."""
    x, y, yaw = (float(value) for value in T_start_end.xyt)
    half = 0.5 * yaw
    # Translation of the twist: V(yaw)^-1 t, in closed form; half / tan(half) -> 1 for small turns.
    shrink = 1.0 if abs(half) < 1e-9 else half / np.tan(half)
    ux, uy = shrink * x + half * y, -half * x + shrink * y
    angles = fractions * yaw
    sinc, cosc = fractions * np.sinc(angles / np.pi), fractions * _one_minus_cos_over(angles)
    return SE2.from_xyt(sinc * ux - cosc * uy, cosc * ux + sinc * uy, angles)


def _one_minus_cos_over(angle: Array) -> Array:
    return np.sin(0.5 * angle) * np.sinc(0.5 * angle / np.pi)


def _lidar_poses(scan: Scan, T_base_lidar: SE2, T_start_end: SE2 | None) -> SE2:
    lidar = scan.lidar
    if T_start_end is None or lidar.time_increment <= 0.0:
        return SE2(T_base_lidar.xyt[None])
    T_start_base = arc(T_start_end, np.arange(lidar.n_beams) / lidar.n_beams)
    return T_start_base @ SE2(T_base_lidar.xyt[None])


def _rotate(T_a_b: SE2, vectors_b: Array) -> Array:
    return SE2.from_xyt(np.zeros_like(T_a_b.x), np.zeros_like(T_a_b.x), T_a_b.yaw) @ vectors_b
