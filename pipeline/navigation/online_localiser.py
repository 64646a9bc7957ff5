"""A localiser in the closed loop: fed with sweeps and the odometry at their stamps; publishes its pose."""

from __future__ import annotations

from collections import deque
from typing import Literal

import numpy as np

from turtlebag.datasets.bags.writer import BagWriter
from turtlebag.datasets.se2 import SE2, Array
from turtlebag.datasets.types import Observation, Scan
from turtlebag.pipeline.localisation.localiser import Localiser
from turtlebag.pipeline.localisation.pose_hypotheses import Keyframe
from turtlebag.pipeline.navigation.sensing import OdometryBuffer, sweep_end_ns


class OnlineLocaliser:
    """The robot's pose on the map, tick by tick."""

    PARTICLES_EVERY_NS = 10**9
    PARTICLES_SHOWN = 500
    KEYFRAMES = 5

    def __init__(self, amcl: Localiser, odometry: OdometryBuffer, publisher: BagWriter) -> None:
        self.amcl = amcl
        self._publisher = publisher
        self._odometry = odometry
        self.T_map_odom: SE2 | None = None
        """The odometry frame on the map; None while it is unknown."""
        self.updates = 0
        """Scans that the filter used: those between which the robot moved."""
        self.keyframes: deque[Keyframe] = deque(maxlen=self.KEYFRAMES)
        """The last scans that the filter used, newest last."""
        self._seen: tuple[Scan, SE2, SE2] | None = None
        self._shown_ns = -self.PARTICLES_EVERY_NS
        self.scan_poses: list[tuple[int, SE2]] = []
        """(stamp [ns], T_map_base) at each sweep: the run's trajectory."""

    def tell(self, initial_pose: SE2 | Literal["start", "global"] | None, T_odom_base: SE2) -> None:
        """Set the pose estimate, or start global localisation; `start`: the true pose, where odometry
        starts."""
        if initial_pose == "global":
            self.amcl.initialise_globally()
        elif initial_pose is not None:
            T_map_base = T_odom_base if initial_pose == "start" else initial_pose
            self.amcl.initialise(T_map_base, None, T_odom_base)
            self.T_map_odom = self.amcl.T_map_odom

    @property
    def contradicted(self) -> bool:
        """Whether the newest scan contradicts the estimate."""
        return self._seen is not None and self.amcl.contradicted(*self._seen)

    def move(self, T_map_map: SE2, covariance: Array) -> None:
        """Move the estimate by this motion of the map, with this covariance (3, 3): the robot is
        elsewhere."""
        if self.keyframes and self.T_map_odom is not None:
            T_odom_base = self.keyframes[-1].T_odom_base
            self.amcl.initialise(T_map_map @ self.T_map_odom @ T_odom_base, covariance, T_odom_base)
            self.T_map_odom = self.amcl.T_map_odom

    def observe(self, observation: Observation) -> None:
        """Add an observation, which the odometry buffer has seen already."""
        scan = observation.scan
        if scan is None or not self.amcl.initialised:
            return
        T_odom_base = self._odometry.at(scan.stamp_ns)
        self._seen = (scan, T_odom_base, self._odometry.at(sweep_end_ns(scan)))
        updated = self.amcl.update(*self._seen)
        self.T_map_odom = self.amcl.T_map_odom
        T_map_base = self.T_map_odom @ T_odom_base
        self.scan_poses.append((scan.stamp_ns, T_map_base))
        now = observation.stamp_ns
        self._publisher.map_to_odom(now, self.T_map_odom)
        if updated:
            self.updates += 1
            if self.amcl.beams is not None:
                self.keyframes.append(Keyframe(self.amcl.beams, T_odom_base))
            self._publisher.amcl_pose(scan.stamp_ns, T_map_base, self.amcl.covariance)
            if now - self._shown_ns >= self.PARTICLES_EVERY_NS:
                self._shown_ns = now
                cloud = self.amcl.particles
                step = max(1, len(cloud) // self.PARTICLES_SHOWN)
                self._publisher.particles(scan.stamp_ns, cloud[np.arange(0, len(cloud), step)])

    def T_map_base(self, T_odom_base: SE2) -> SE2 | None:
        """The estimate now; None while there is none."""
        return None if self.T_map_odom is None else self.T_map_odom @ T_odom_base
