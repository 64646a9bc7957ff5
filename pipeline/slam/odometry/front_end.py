"""The contract of a front end: it estimates the pose of each scan of a log, in order.

`tracker.Tracker` does what all share: it corrects the odometry's systematic errors, uses odometry until the
first scan that others can be matched with, selects the key scans, and keeps the `Track`.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Protocol

import numpy as np
from numpy.typing import NDArray

from turtlebag.datasets.se2 import Array
from turtlebag.pipeline.slam.scans.clouds import Clouds


@dataclass(frozen=True, eq=False)
class Placed:
    """The estimated pose of a scan, and its quality.

    `T_track_base` (3,) is the pose of the base at the scan's stamp: x, y [m], yaw [rad] in the frame of the
    track, which is the odometry's at the first scan (identity without odometry). `information` (3, 3) is that
    of the scan matching alone, in the base frame at that pose [1/m^2, 1/(m rad), 1/rad^2], with points taken
    as independent (`align.STEP_COVARIANCE_SCALE` allows for their shared errors): zero along unobservable
    directions, and without the odometry, which the graph adds. `overlap` is the share 0..1 of
    the scan's points that lie on surfaces seen before, `known` the share in space seen before, `rmse` the
    error of the match [m]. `source` is the start that won, an index into `track.HYPOTHESES`. If `sure` is
    False, the scan does not become a key scan. `revised` are earlier scans with improved poses (3,); they
    take over this scan's quality, except `source`. Poses of key scans are not revised.
    """

    T_track_base: Array
    information: Array
    overlap: float
    rmse: float = 0.0
    source: int = 0
    sure: bool = True
    revised: tuple[tuple[int, Array], ...] = ()
    known: float = 1.0

    @property
    def agreement(self) -> float:
        """The share of the points in known space that lie on known surfaces, 0..1."""
        return self.overlap / self.known if self.known > 0.0 else 1.0


class TrackedLog(Protocol):
    """The log tracked so far, for front ends to read. Poses (3,) are x, y [m], yaw [rad], as `T_track_base`.

    `scan` is being placed; `velocity` (3,) is the motion of the one before, in the base frame of its own
    predecessor. `clouds.of(k)` are the points (n, 2) [m] of scan k in its base frame, which has some if it
    is a key scan or the current one; `keys` are the key scans, at first one that has points.
    """

    clouds: Clouds
    scan: int
    velocity: Array
    keys: list[int]

    @property
    def pose(self) -> Array:
        """The pose (3,) of the scan placed last."""

    def last_keys(self, n: int = ...) -> tuple[NDArray[np.int64], Array]:
        """The last n key scans, (k,), and their poses, (k, 3)."""

    def fit(self, points: Array, pose: Array) -> float:
        """How well points (n, 2) [m] of a scan at a pose (3,) fit the last key scans, 0..1."""


class FrontEnd(Protocol):
    """Estimates the poses of a log's scans in order. It must not modify its inputs."""

    def __init__(self, tracker: TrackedLog) -> None:
        """`tracker` may be read at any step."""

    def step(self, points: Array, odometry_step: Array | None, wait_s: float) -> Placed:
        """The pose of the next scan.

        `points` (n, 2) are its returns [m] in the frame of the base at its stamp; n may be 0. `odometry_step`
        (3,) is the motion since the previous scan by the calibrated odometry, in that scan's base frame, None
        without odometry; `wait_s` is the time since then [s], negative if stamps go backwards. If the scan
        shows nothing, return the predicted pose with zero information.
        """
