"""The contract of a localiser: it estimates the robot's pose on a known map, scan by scan."""

from __future__ import annotations

from typing import Protocol

import numpy as np

from turtlebag.datasets.grid import OccupancyGrid
from turtlebag.datasets.se2 import SE2, Array
from turtlebag.datasets.types import LidarSpec, Scan
from turtlebag.pipeline.localisation.deskewed_beams import Beams
from turtlebag.pipeline.localisation.parameters import AmclConfig


class Localiser(Protocol):
    """Estimates `T_map_odom`. It is initialised, with a pose or globally, before its first scan."""

    searches: int
    """How often its pose came from a search; after each, pose hypotheses are compared."""

    def __init__(
        self,
        grid: OccupancyGrid,
        lidar: LidarSpec,
        T_base_lidar: SE2,
        config: AmclConfig,
        rng: np.random.Generator,
    ) -> None:
        """`config` are the settings `amcl`, `rng` is the only source of randomness. ValueError if there is
        nothing on the map to localise with."""
        ...

    def initialise(
        self, T_map_base: SE2, covariance: Array | None = None, T_odom_base: SE2 | None = None
    ) -> None:
        """Restart at a pose with this covariance (3, 3); None: the settings'.

        With `T_odom_base`, the current odometry, `T_map_odom` is set at once; otherwise the pose is that of
        the next scan.
        """
        ...

    def initialise_globally(self) -> None:
        """Restart with global localisation: the robot may be anywhere on the map."""
        ...

    def update(self, scan: Scan, T_odom_base: SE2, T_odom_base_end: SE2 | None = None) -> bool:
        """Update with a scan and the odometry at its stamp and at the end of its sweep; whether it was used.

        A scan without new information need not be used, such as that of a standing robot. `T_map_odom` is
        known from the first scan on. Every scan is passed, even one without any return.
        """
        ...

    def contradicted(self, scan: Scan, T_odom_base: SE2, T_odom_base_end: SE2) -> bool:
        """Whether a scan contradicts the current estimate. Changes nothing."""
        ...

    @property
    def initialised(self) -> bool:
        """Whether it was initialised, with a pose or globally."""
        ...

    @property
    def T_map_odom(self) -> SE2:
        """The odometry frame on the map; ValueError before it is known."""
        ...

    @property
    def covariance(self) -> Array:
        """Covariance of the base pose at the last used scan, (3, 3): x, y, yaw."""
        ...

    @property
    def particles(self) -> SE2:
        """Possible poses (n,), at least one once initialised; for display and statistics."""
        ...

    @property
    def converged(self) -> bool:
        """Whether the estimate is narrowed down to one place."""
        ...

    @property
    def agrees(self) -> bool:
        """Whether recent scans agree with the map at the estimate."""
        ...

    @property
    def lost(self) -> bool:
        """Whether it has not converged, or recent scans disagree with the map."""
        ...

    @property
    def agreement(self) -> float:
        """The share 0..1 of recent scans that the map explains."""
        ...

    @property
    def beams(self) -> Beams | None:
        """The last used scan, for comparing pose hypotheses; None disables that."""
        ...
