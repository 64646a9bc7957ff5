"""The contract of a localiser: it estimates the robot's pose on a known map, scan by scan."""

from __future__ import annotations

from typing import Protocol

import numpy as np

from turtlebag.datasets.grid import OccupancyGrid
from turtlebag.datasets.parts import Answer
from turtlebag.datasets.se2 import SE2, Array
from turtlebag.datasets.types import LidarSpec, Scan
from turtlebag.pipeline.localisation.beams import Beams
from turtlebag.pipeline.localisation.parameters import AmclConfig


class Localiser(Protocol):
    """Where `odom` is on the map. It is told a pose, or to search for one, before its first scan."""

    searches: int
    """How often its pose came from a search over the whole map: then places that look alike are compared."""

    def __init__(
        self,
        grid: OccupancyGrid,
        lidar: LidarSpec,
        T_base_lidar: SE2,
        config: AmclConfig,
        rng: np.random.Generator,
    ) -> None:
        """On a map, for a lidar at a pose on the robot; the settings are those of the section `amcl`, and
        `rng` is all chance there may be. ValueError when there is nothing on the map to localise on."""
        ...

    def initialise(
        self, T_map_base: SE2, covariance: Array | None = None, T_odom_base: SE2 | None = None
    ) -> None:
        """Forget all and begin at a pose, so uncertain (3, 3); None: as the settings say.

        With `T_odom_base`, the odometry now, `T_map_odom` is set at once; else the pose holds at the next
        scan.
        """
        ...

    def initialise_globally(self) -> None:
        """Forget all: the robot may be anywhere on the map."""
        ...

    def update(self, scan: Scan, T_odom_base: SE2, T_odom_base_end: SE2 | None = None) -> bool:
        """Take in a scan with the odometry at its stamp and at the end of its sweep; whether it was used.

        One that tells nothing new need not be, as of a robot that stands. From the first scan on
        `T_map_odom` is known. It is called with whatever the lidar gave: no return at all is a scan too.
        """
        ...

    def contradicted(self, scan: Scan, T_odom_base: SE2, T_odom_base_end: SE2) -> bool:
        """Whether a scan speaks against where it takes the robot to be. Changes nothing."""
        ...

    @property
    def initialised(self) -> bool:
        """Whether it was told a pose, or to search."""
        ...

    @property
    def T_map_odom(self) -> SE2:
        """Odometry's frame on the map; ValueError before it is known."""
        ...

    @property
    def covariance(self) -> Array:
        """How uncertain the pose of the base was at the last scan used, (3, 3): x, y, yaw."""
        ...

    @property
    def particles(self) -> SE2:
        """The poses (n,) it thinks possible, one at least once initialised: drawn, and counted."""
        ...

    @property
    def converged(self) -> bool:
        """Whether it is sure of one place."""
        ...

    @property
    def agrees(self) -> bool:
        """Whether the scans of late agree with the map there."""
        ...

    @property
    def lost(self) -> bool:
        """Whether it is not sure of one place, or the scans do not agree with the map there."""
        ...

    @property
    def agreement(self) -> float:
        """The share 0..1 of the scans of late that the map explains there."""
        ...

    @property
    def pushes(self) -> int:
        """How often it has seen that someone pushed the standing robot; 0 for who does not look."""
        ...

    @property
    def beams(self) -> Beams | None:
        """The scan last used, for comparing places that look alike; None to do without."""
        ...


def require_estimate(localiser: Localiser) -> None:
    """InputError unless what it says after a scan is what it must be."""
    answer = Answer(localiser, "update")
    try:
        T_map_odom, covariance = localiser.T_map_odom, localiser.covariance
    except ValueError as error:
        raise answer.wrong(f"T_map_odom or covariance is not known after a scan: {error}") from None
    answer.require_a(SE2, T_map_odom)
    answer.require_finite("T_map_odom", T_map_odom.xyt, 3)
    answer.require_finite("covariance", covariance, 3, 3)
    for what in ("converged", "agrees", "lost"):
        answer.require_kind(what, getattr(localiser, what), bool, np.bool_)
    for what in ("pushes", "searches"):
        answer.require_kind(what, getattr(localiser, what), int, np.integer)
    answer.require_finite("agreement", localiser.agreement)
    if not -1e-6 <= localiser.agreement <= 1.0 + 1e-6:
        raise answer.wrong(f"agreement must be a share 0..1, not {localiser.agreement:g}")
    answer.require_kind("particles", localiser.particles, SE2)
    if localiser.particles.xyt.ndim != 2 or not len(localiser.particles):
        raise answer.wrong("particles must be poses (n,), at least one")
