"""Parts that know the truth: which part causes an error is seen when one of them takes its place.

Only these read the truth; a command that uses one names it in its manifest.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from turtlebag.datasets.grid import OccupancyGrid
from turtlebag.datasets.ground_truth import true_pose
from turtlebag.datasets.se2 import SE2, Array
from turtlebag.datasets.types import LidarSpec, Scan
from turtlebag.pipeline.localisation.parameters import AmclConfig
from turtlebag.pipeline.slam.loops.matcher import Stretch
from turtlebag.pipeline.slam.loops.matchers import LineMatch
from turtlebag.pipeline.slam.odometry.front_end import Placed
from turtlebag.pipeline.slam.odometry.line_icp import Lines
from turtlebag.pipeline.slam.odometry.tracker import Tracker
from turtlebag.pipeline.slam.scans.align import Alignment
from turtlebag.pipeline.slam.scans.clouds import Clouds
from turtlebag.pipeline.slam.scans.correspondences import Limits

SURE = np.diag([5e7, 5e7, 5e7])
"""Information of a true loop [1/m^2, 1/(m rad), 1/rad^2], which the graph divides by `covariance_scale`: in
the end a millimetre and a thousandth of a radian."""


class TrueFrontEnd(Lines):
    """A `FrontEnd` that sees what `lines` sees, from where each scan truly is (`map --truth`)."""

    def __init__(self, tracker: Tracker) -> None:
        super().__init__(tracker)
        self._true = true_pose(self)

    def step(self, points: Array, odometry_step: Array | None, wait_s: float) -> Placed:
        """The true motion since the first scan, on from its pose in the track."""
        tracker, usual = self.tracker, super().step(points, odometry_step, wait_s)
        moved = self._true(0).inverse() @ self._true(tracker.scan)
        return replace(usual, T_track_base=(SE2(tracker.pose_of(0)) @ moved).xyt, revised=())


class TrueLoops(LineMatch):
    """A `LoopMatch` that says where `query` truly is as seen from `place` (`map --truth`)."""

    def __init__(self) -> None:
        super().__init__()
        self._true = true_pose(self)

    def match(
        self, clouds: Clouds, query: Stretch, place: Stretch, start: Array, limits: Limits
    ) -> Alignment:
        """The fit of the usual match, at the true pose."""
        usual = super().match(clouds, query, place, start, limits)
        T_place_query = self._true(place.about).inverse() @ self._true(query.about)
        return replace(usual, T_map_base=T_place_query, information=SURE)


class TrueLocaliser:
    """A `Localiser` that knows where the robot is in the simulation (`navigate`); the map is the world."""

    searches = 0
    converged = agrees = True
    lost = False
    agreement = 1.0
    beams = None

    def __init__(
        self,
        grid: OccupancyGrid,
        lidar: LidarSpec,
        T_base_lidar: SE2,
        config: AmclConfig,
        rng: np.random.Generator,
    ) -> None:
        del grid, lidar, T_base_lidar, config, rng
        self._true = true_pose(self)
        self.initialised = False
        self.covariance = np.zeros((3, 3))
        self.particles = SE2(np.zeros((1, 3)))
        self.T_map_odom = SE2.identity()

    def initialise(
        self, T_map_base: SE2, covariance: Array | None = None, T_odom_base: SE2 | None = None
    ) -> None:
        """The given pose counts until the first scan."""
        del covariance
        self.initialised = True
        self.particles = SE2(T_map_base.xyt[None])
        if T_odom_base is not None:
            self.T_map_odom = T_map_base @ T_odom_base.inverse()

    def initialise_globally(self) -> None:
        """There is nothing to search for."""
        self.initialised = True

    def update(self, scan: Scan, T_odom_base: SE2, T_odom_base_end: SE2 | None = None) -> bool:
        """The true pose, whatever the scan shows."""
        del scan, T_odom_base_end
        T_map_base = self._true(-1)
        self.particles = SE2(T_map_base.xyt[None])
        self.T_map_odom = T_map_base @ T_odom_base.inverse()
        return True

    def contradicted(self, scan: Scan, T_odom_base: SE2, T_odom_base_end: SE2) -> bool:
        """Never."""
        del scan, T_odom_base, T_odom_base_end
        return False
