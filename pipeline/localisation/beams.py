"""A scan as the filter wants it: end points in the base frame at the scan's stamp, motion undone."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from turtlebag.datasets.kernels import njit
from turtlebag.datasets.se2 import SE2, Array
from turtlebag.datasets.types import Scan


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

    @property
    def total(self) -> int:
        """Beams with a return and without."""
        return len(self.points) + len(self.silent_origins)


def prepare(
    scan: Scan,
    T_base_lidar: SE2,
    T_start_end: SE2 | None = None,
    range_limits: tuple[float, float] | None = None,
) -> Beams:
    """Beams of a scan; `T_start_end` is the base's motion over the whole sweep, if known.

    With it, and a turning lidar, beam i is seen from where the base was i * time_increment after the
    stamp. NaN and -inf are dropped, range_max and more counts as "no return".
    """
    ranges = scan.ranges.astype(np.float64)
    low, high = range_limits or (scan.lidar.range_min, scan.lidar.range_max)
    hit = np.flatnonzero(scan.valid() & (ranges >= low) & (ranges <= high))
    silent = np.flatnonzero(scan.lidar.silent(scan.ranges))
    sweep = np.zeros(3) if T_start_end is None or scan.lidar.time_increment == 0.0 else T_start_end.xyt
    lidar = T_base_lidar.xyt
    origins, directions = deskewed(scan.lidar.angles, lidar, sweep, hit)
    silent_origins, silent_directions = deskewed(scan.lidar.angles, lidar, sweep, silent)
    points = origins + directions * ranges[hit, None]
    return Beams(points, origins, ranges[hit], silent_directions, silent_origins)


def spread(count: int, most: int) -> NDArray[np.int64]:
    """At most `most` indices, evenly spaced over `count`."""
    if count <= most:
        return np.arange(count)
    return (np.arange(most) * count) // most


@njit(cache=True)
def deskewed(angles: Array, lidar: Array, sweep: Array, chosen: NDArray[np.int64]) -> tuple[Array, Array]:
    """Origins and unit directions of the chosen beams in the base frame at the scan's stamp, (n, 2) each.

    `lidar` is T_base_lidar, `sweep` the base's motion (x, y, yaw) over all beams. In between it moves
    on an arc of constant twist: the exponential of SE(2) and its inverse in closed form.
    """
    yaw, half, n = sweep[2], 0.5 * sweep[2], len(angles)
    # Translation part of the twist: V(yaw)^-1 t; half / tan(half) -> 1 for small turns.
    shrink = 1.0 if abs(half) < 1e-9 else half / np.tan(half)
    ux, uy = shrink * sweep[0] + half * sweep[1], shrink * sweep[1] - half * sweep[0]
    origins, directions = np.empty((len(chosen), 2)), np.empty((len(chosen), 2))
    for k in range(len(chosen)):
        f = chosen[k] / n
        turn = f * yaw
        a, b = (f, 0.5 * f * turn) if abs(turn) < 1e-9 else (np.sin(turn) / yaw, (1.0 - np.cos(turn)) / yaw)
        c, s = np.cos(turn), np.sin(turn)
        origins[k, 0] = a * ux - b * uy + c * lidar[0] - s * lidar[1]
        origins[k, 1] = b * ux + a * uy + s * lidar[0] + c * lidar[1]
        angle = turn + lidar[2] + angles[chosen[k]]
        directions[k, 0], directions[k, 1] = np.cos(angle), np.sin(angle)
    return origins, directions
