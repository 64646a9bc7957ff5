"""SLAM while driving: the recording so far is mapped anew whenever a map is wanted."""

from __future__ import annotations

import numpy as np

from datasets.grid import OccupancyGrid
from datasets.se2 import SE2
from datasets.types import Observation, Recording, Scan, Trajectory
from pipeline.slam.slam import SlamConfig, run_slam

# A scan is kept when the robot has moved this far since the last one kept.
KEEP_M, KEEP_RAD = 0.04, 0.06
LEAST_SCANS = 3
# Odometry samples that reach back past the start of a sweep.
RECENT = 32


class OnlineMap:
    """Collects scans and odometry; `update` maps them. The map frame is odometry's at the start."""

    def __init__(self, T_base_lidar: SE2, config: SlamConfig) -> None:
        self.T_map_odom = SE2.identity()
        self.grid: OccupancyGrid | None = None
        self._T_base_lidar, self._config = T_base_lidar, config
        self._scans: list[Scan] = []
        self._kept: list[SE2] = []
        self._stamps: list[int] = []
        self._odometry: list[SE2] = []

    def observe(self, observation: Observation) -> None:
        """Take in odometry, and the scan if there is one."""
        self._stamps.append(observation.odometry.stamp_ns)
        self._odometry.append(observation.odometry.T_odom_base)
        scan = observation.scan
        if scan is None:
            return
        recent = Trajectory(np.array(self._stamps[-RECENT:]), SE2.stack(self._odometry[-RECENT:]))
        at = recent.at(np.array([scan.stamp_ns]))[0]
        if len(self._kept) >= LEAST_SCANS:
            x, y, yaw = (self._kept[-1].inverse() @ at).xyt
            if np.hypot(x, y) < KEEP_M and abs(yaw) < KEEP_RAD:
                return
        self._scans.append(scan)
        self._kept.append(at)

    @property
    def ready(self) -> bool:
        """Whether there is enough to map."""
        return len(self._scans) >= LEAST_SCANS

    def update(self) -> OccupancyGrid:
        """Map everything seen so far; also corrects `T_map_odom`."""
        result = run_slam(self.recording(), self._config)
        self.T_map_odom = result.trajectory.poses[-1] @ self._kept[-1].inverse()
        self.grid = result.grid
        return result.grid

    def recording(self) -> Recording:
        """What was kept, as a log."""
        return Recording(
            source="exploration",
            stamps_ns=np.array([scan.stamp_ns for scan in self._scans]),
            ranges=np.stack([scan.ranges for scan in self._scans]),
            lidar=self._scans[0].lidar,
            T_base_lidar=self._T_base_lidar,
            T_odom_base=SE2.stack(self._kept),
            odometry=Trajectory(np.array(self._stamps), SE2.stack(self._odometry)),
        )
