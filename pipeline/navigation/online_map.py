"""Mapping while driving: `slam.mapper` fed with observations."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from turtlebag.datasets.grid import OccupancyGrid
from turtlebag.datasets.se2 import SE2
from turtlebag.datasets.types import Imu, MountedLidar, Observation, Recording, Scan, Trajectory
from turtlebag.pipeline.slam.mapper import SlamConfig
from turtlebag.pipeline.slam.online.mapper import Mapper

HERE_M = 0.15
"""Scans this close to where the robot pushes against something are not drawn (not measured)."""


class OnlineMap:
    """Maps the observations; `update` makes the current map. The map frame is the odometry's at the start."""

    def __init__(self, T_base_lidar: SE2, config: SlamConfig, lidars: Sequence[MountedLidar] = ()) -> None:
        """`T_base_lidar` is the only lidar's pose; `lidars` are all of a robot with several."""
        self.T_map_odom = SE2.identity()
        self.grid: OccupancyGrid | None = None
        self.mapper: Mapper | None = None
        """None before the first scan."""
        self._T_base_lidar, self._config, self._lidars = T_base_lidar, config, tuple(lidars)
        self._stamps: list[int] = []
        self._odometry: list[SE2] = []
        self._imu: list[Imu] = []

    def observe(self, observation: Observation) -> None:
        """Add the odometry, and place the scan if there is one."""
        self._stamps.append(observation.odometry.stamp_ns)
        self._odometry.append(observation.odometry.T_odom_base)
        self._imu += observation.imu
        scan = observation.scan
        if scan is None or (self.mapper is None and scan.stamp_ns < self._stamps[0]):
            return  # of a sweep that began before the map no one knows where
        self.add(scan, Trajectory(np.array(self._stamps), SE2.stack(self._odometry)), self._imu)
        self._stamps, self._odometry, self._imu = [], [], []

    def add(self, scan: Scan, odometry: SE2 | Trajectory | None, imu: Sequence[Imu] = ()) -> None:
        """Place a scan; see `Mapper.add`."""
        if self.mapper is None:
            first, *others = self._lidars or (MountedLidar(scan.lidar, self._T_base_lidar),)
            self.mapper = Mapper(first.spec, first.T_base_lidar, self._config, others=others)
        self.mapper.add(scan, odometry, imu)
        self.T_map_odom = self.mapper.T_map_odom

    def distrust(self) -> None:
        """The robot has been pushing against something here: its scans since it arrived are not drawn.

        Wheels that turn without moving the robot distort the deskewed sweeps.
        """
        if self.mapper is not None:
            self.mapper.distrust(HERE_M)

    @property
    def ready(self) -> bool:
        """Whether there is enough to map."""
        return self.mapper is not None and len(self.mapper) > 0

    def update(self) -> OccupancyGrid:
        """Draw the current map."""
        assert self.mapper is not None
        self.grid = self.mapper.map()
        return self.grid

    def finish(self) -> OccupancyGrid:
        """The map of everything seen, as the offline mapper makes it."""
        assert self.mapper is not None
        trajectory, self.grid = self.mapper.finish()
        T_odom_base = self.mapper.recording().T_odom_base
        assert T_odom_base is not None
        self.T_map_odom = trajectory.poses[-1] @ T_odom_base[len(trajectory) - 1].inverse()
        return self.grid

    def recording(self) -> Recording:
        """The scans that are mapped, as a log."""
        assert self.mapper is not None
        return self.mapper.recording()
