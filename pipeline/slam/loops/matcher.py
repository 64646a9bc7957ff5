"""The contract of a loop matcher: it aligns a stretch of key scans with a place they may have returned to.

Loops by distance and recognised places use the same matcher. A search provides the initial pose, and the
callers judge the result by their own limits (`min_overlap`).
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Protocol

import numpy as np
from numpy.typing import NDArray

from turtlebag.datasets.se2 import Array
from turtlebag.pipeline.slam.scans.align import Alignment
from turtlebag.pipeline.slam.scans.clouds import Clouds
from turtlebag.pipeline.slam.scans.correlative import points_in_map
from turtlebag.pipeline.slam.scans.correspondences import Limits


@dataclass(frozen=True, eq=False)
class Stretch:
    """Scans (n,) of a log with their poses (n, 3) in the base frame of one of them, `about`."""

    about: int
    scans: NDArray[np.int64]
    T_about_scans: Array

    def points(self, clouds: Clouds) -> Array:
        """All their points (m, 2), in that frame."""
        return points_in_map(clouds.points, clouds.starts, self.scans, self.T_about_scans)


class LoopMatch(Protocol):
    """Aligns two stretches of a log. It must not modify its inputs."""

    def __init__(self) -> None:
        """A new matcher is made for each log."""
        ...

    def match(
        self, clouds: Clouds, query: Stretch, place: Stretch, start: Array, limits: Limits
    ) -> Alignment:
        """The pose of `query` relative to `place`, starting from `start` (3,).

        `T_map_base` of the result is the base of `query.about` in the frame of `place.about`; `information`
        (3, 3) is in the frame of the former, zero along unobservable directions; `overlap` is the share 0..1
        of the query's points with a correspondence, `rmse` their distance [m].
        """
        ...
