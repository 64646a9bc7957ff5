"""AMCL in closed loop: feeds it sweeps with the odometry that belongs to them, publishes what it says."""

from __future__ import annotations

from collections import deque
from typing import Protocol

import numpy as np

from datasets.se2 import SE2, Array
from datasets.types import Observation, Scan
from pipeline.localisation.amcl import Amcl


class Publisher(Protocol):
    """Where a driver says what it thinks: the bag of the run."""

    def amcl_pose(self, stamp_ns: int, T_map_base: SE2, covariance: Array) -> None:
        """The estimate with its covariance (3, 3)."""
        ...

    def map_to_odom(self, stamp_ns: int, T_map_odom: SE2) -> None:
        """The localiser's transform."""
        ...

    def particles(self, stamp_ns: int, T_map_base: SE2) -> None:
        """The cloud, (n,) poses."""
        ...

    def plan(self, stamp_ns: int, T_map_base: SE2) -> None:
        """A global path, (n,) poses."""
        ...

    def goal(self, stamp_ns: int, T_map_goal: SE2) -> None:
        """A goal that is pursued from now on."""
        ...


class OdometryBuffer:
    """The last odometry poses, to ask for one at a scan's stamp."""

    def __init__(self, length: int = 32) -> None:
        self._samples: deque[tuple[int, SE2]] = deque(maxlen=length)

    def add(self, stamp_ns: int, T_odom_base: SE2) -> None:
        """Append the newest pose."""
        self._samples.append((stamp_ns, T_odom_base))

    def at(self, stamp_ns: int) -> SE2:
        """Odometry at a stamp, interpolated; held at the ends of what is remembered."""
        newer = self._samples[-1]
        for sample in reversed(self._samples):
            if sample[0] <= stamp_ns:
                if newer[0] <= stamp_ns:
                    return newer[1]
                fraction = (stamp_ns - sample[0]) / (newer[0] - sample[0])
                return sample[1].interpolate(newer[1], fraction)
            newer = sample
        return newer[1]


def sweep_end_ns(scan: Scan) -> int:
    """Stamp of the end of a sweep [ns]."""
    return scan.stamp_ns + round(scan.lidar.n_beams * scan.lidar.time_increment * 1e9)


class Localiser:
    """Where the robot is on the map, tick by tick."""

    PARTICLES_EVERY_NS = 10**9
    PARTICLES_SHOWN = 500

    def __init__(self, amcl: Amcl, publisher: Publisher) -> None:
        self.amcl = amcl
        self._publisher = publisher
        self._odometry = OdometryBuffer()
        self._T_map_odom: SE2 | None = None
        self._shown_ns = -self.PARTICLES_EVERY_NS
        self.scan_poses: list[tuple[int, SE2]] = []
        """(stamp [ns], T_map_base) at each sweep taken in: the run's trajectory."""

    def initialise(self, T_map_base: SE2, T_odom_base: SE2) -> None:
        """The 2D pose estimate."""
        self.amcl.initialise(T_map_base, None, T_odom_base)
        self._T_map_odom = self.amcl.T_map_odom

    def initialise_globally(self) -> None:
        """Anywhere on the free floor."""
        self.amcl.initialise_globally()

    def observe(self, observation: Observation) -> None:
        """Take in one observation."""
        odometry = observation.odometry
        self._odometry.add(odometry.stamp_ns, odometry.T_odom_base)
        scan = observation.scan
        if scan is None or not self.amcl.initialised:
            return
        T_odom_base = self._odometry.at(scan.stamp_ns)
        updated = self.amcl.update(scan, T_odom_base, self._odometry.at(sweep_end_ns(scan)))
        self._T_map_odom = self.amcl.T_map_odom
        T_map_base = self._T_map_odom @ T_odom_base
        self.scan_poses.append((scan.stamp_ns, T_map_base))
        now = observation.stamp_ns
        self._publisher.map_to_odom(now, self._T_map_odom)
        if updated:
            self._publisher.amcl_pose(scan.stamp_ns, T_map_base, self.amcl.covariance)
        if now - self._shown_ns >= self.PARTICLES_EVERY_NS:
            self._shown_ns = now
            cloud = self.amcl.particles
            step = max(1, len(cloud) // self.PARTICLES_SHOWN)
            self._publisher.particles(scan.stamp_ns, cloud[np.arange(0, len(cloud), step)])

    def T_map_base(self, T_odom_base: SE2) -> SE2 | None:
        """The estimate now; None while there is none."""
        return None if self._T_map_odom is None else self._T_map_odom @ T_odom_base
