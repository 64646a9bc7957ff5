"""A scan as input of the filter: deskewed end points in the base frame at the scan's stamp."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from turtlebag.datasets.deskew import deskewed
from turtlebag.datasets.se2 import SE2, Array
from turtlebag.datasets.types import Scan


@dataclass(frozen=True, eq=False)
class Beams:
    """The measured beams of one scan.

    `points` (n, 2) and `origins` (n, 2) are in the base frame at the scan's stamp [m].
    `silent_directions` (k, 2) are the unit vectors of beams without return, `silent_origins` (k, 2).
    """

    points: Array
    origins: Array
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

    With it, and a turning lidar, each beam starts from the base's pose at its own time. NaN
    and -inf are dropped, range_max and more counts as "no return".
    """
    ranges = scan.ranges.astype(np.float64)
    low, high = range_limits or (scan.lidar.range_min, scan.lidar.range_max)
    hit = scan.valid() & (ranges >= low) & (ranges <= high)
    silent = scan.lidar.silent(scan.ranges)
    still = scan.lidar.time_increment == 0.0
    motion = np.zeros((1, 3)) if T_start_end is None or still else T_start_end.xyt[None]
    beams = scan.lidar.directions
    origins, directions = deskewed(beams, scan.lidar.order / len(beams), T_base_lidar.xyt, motion)
    points = origins[hit] + directions[hit] * ranges[hit, None]
    return Beams(points, origins[hit], directions[silent], origins[silent])


def evenly_spaced(count: int, most: int) -> NDArray[np.int64]:
    """At most `most` indices, evenly spaced over `count`."""
    if count <= most:
        return np.arange(count)
    return (np.arange(most) * count) // most
