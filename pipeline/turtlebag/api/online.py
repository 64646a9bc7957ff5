"""Mapping and localising scan by scan, from the simulator's observations or your own arrays."""

from __future__ import annotations

import os
from collections.abc import Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any, Literal

import numpy as np

from turtlebag.api import given
from turtlebag.api.given import PathLike, Pose
from turtlebag.api.outputs import as_map
from turtlebag.api.tables import Trajectory
from turtlebag.datasets import types
from turtlebag.datasets.errors import InputError
from turtlebag.datasets.grid import OccupancyGrid
from turtlebag.datasets.se2 import SE2, Array
from turtlebag.datasets.seeds import stream
from turtlebag.datasets.types import Imu, Observation, Scan
from turtlebag.pipeline.localisation.localiser import Localiser as AnyLocaliser
from turtlebag.pipeline.navigation.online_map import OnlineMap
from turtlebag.pipeline.navigation.sensing import OdometryBuffer, sweep_end_ns
from turtlebag.pipeline.slam.mapper import SlamConfig
from turtlebag.pipeline.stages.localise import load_localise_config, started
from turtlebag.pipeline.stages.settings import load_config
from turtlebag.sim.robots import load_robot


def _lidars(robot: PathLike, laser: Pose | None) -> tuple[SE2, tuple[types.MountedLidar, ...]]:
    """Where the first laser sits on the robot, and all of the robot's; none where only that pose is known."""
    if laser is not None:
        return given.pose(laser, "laser"), ()
    lidars = load_robot(os.fspath(robot)).mounted()
    return lidars[0].T_base_lidar, lidars


class Mapper:
    """Maps while the robot drives: each scan is placed at once, and loops are closed step by step.

    Pass either the observations of a simulator (`observe`) or scans of your own (`add`), not both. `robot` or
    `laser` gives the laser's pose on the robot. The map's frame is the odometry's at the first scan; without
    odometry, the robot's. Settings are those of `map`; `front_end` is a name or a class. Work and memory grow
    with the area seen, not with the time driven.
    """

    def __init__(
        self,
        robot: PathLike = "burger",
        *,
        laser: Pose | None = None,
        front_end: str | type | None = None,
        config: PathLike | None = None,
        settings: Mapping[str, Any] | None = None,
    ) -> None:
        """InputError for an unknown robot or setting."""
        T_base_lidar, lidars = _lidars(robot, laser)
        chosen = {**(settings or {}), **({} if front_end is None else {"front_end": front_end})}
        slam = load_config(SlamConfig, None if config is None else Path(config), chosen)
        self._online = OnlineMap(T_base_lidar, slam, lidars if len(lidars) > 1 else ())

    def __len__(self) -> int:
        return 0 if self._online.mapper is None else len(self._online.mapper)

    def observe(self, observation: Observation) -> Array | None:
        """Take in what the simulator's robot sensed; the pose (3,) where that brought a scan, else None."""
        before = len(self)
        self._online.observe(observation)
        return self.pose if len(self) > before else None

    def add(
        self, scan: Scan, odometry: Pose | types.Trajectory | None = None, imu: Sequence[Imu] = ()
    ) -> Array:
        """Place a scan: x, y [m] and yaw [rad] of the base in the map at its stamp, (3,).

        `odometry` is the pose of the base in the odometry's frame at that stamp, or a trajectory of it since
        the last scan's, to the end of the sweep; the same kind, or none, for every scan. `imu` are the
        samples since the last scan. Stamps increase; ranges [m] may be inf or NaN (REP-117).
        """
        if odometry is not None and not isinstance(odometry, types.Trajectory):
            odometry = given.pose(odometry, "odometry")
        self._online.add(_single(scan), odometry, imu)
        return self.pose

    @property
    def pose(self) -> Array:
        """Current estimate of the newest scan's pose: x, y, yaw in the map, (3,)."""
        return self._mapper.T_map_base.xyt

    @property
    def T_map_odom(self) -> SE2:
        """The odometry's frame on the map."""
        return self._mapper.T_map_odom

    @property
    def lost(self) -> bool:
        """Whether the newest scans fit so badly that their poses are guesses."""
        return self._mapper.lost

    @property
    def trajectory(self) -> Trajectory:
        """Current estimates of the poses of all scans, (n, 3)."""
        return Trajectory.of(self._mapper.trajectory)

    def map(self) -> OccupancyGrid:
        """The current map: `cells` (rows, columns) int8, `resolution` [m], `T_map_grid`."""
        return self._mapper.map()

    def finish(self) -> tuple[Trajectory, OccupancyGrid]:
        """Poses and map as `map` makes them from all scans; it takes as long."""
        trajectory, grid = self._mapper.finish()
        return Trajectory.of(trajectory), grid

    @property
    def _mapper(self) -> Any:
        if self._online.mapper is None:
            raise InputError("no scan yet: observe or add one first")
        return self._online.mapper


class Localiser:
    """Localises the robot on a map, scan by scan (AMCL, or your own class with the setting `localiser`).

    `initial_pose` is its pose on the map at the first scan, or "global" to search the whole map. Pass either
    the observations of a simulator (`observe`) or scans of your own (`add`), not both. Settings and results
    are those of `localise`.
    """

    def __init__(
        self,
        map: PathLike | OccupancyGrid,
        robot: PathLike = "burger",
        *,
        initial_pose: Pose | Literal["global"],
        laser: Pose | None = None,
        seed: int = 1,
        config: PathLike | None = None,
        settings: Mapping[str, Any] | None = None,
    ) -> None:
        """InputError for an unknown robot or setting, or an unreadable map."""
        self._told: SE2 | str = "global"
        if not isinstance(initial_pose, str) or initial_pose != "global":
            self._told = given.pose(initial_pose, "initial_pose")
        self._T_base_lidar, self._lidars = _lidars(robot, laser)
        self._config = load_localise_config(None if config is None else Path(config), settings or {})
        self._grid = map if isinstance(map, OccupancyGrid) else as_map(map).occupancy
        self._rng = stream(seed, "amcl")
        self._buffer = OdometryBuffer()
        self._localiser: AnyLocaliser | None = None
        self._T_odom_base = SE2.identity()

    def observe(self, observation: Observation) -> Array | None:
        """Take in what the simulator's robot sensed; the pose (3,) where that brought a scan, else None."""
        self._buffer.add(observation.odometry.stamp_ns, observation.odometry.T_odom_base)
        scan = observation.scan
        if scan is None:
            return None
        return self._update(scan, self._buffer.at(scan.stamp_ns), self._buffer.at(sweep_end_ns(scan)))

    def add(self, scan: Scan, odometry: Pose, odometry_end: Pose | None = None) -> Array:
        """Update with a scan: x, y [m] and yaw [rad] of the base in the map at its stamp, (3,).

        `odometry` is the pose of the base in the odometry's frame at that stamp, `odometry_end` at the end of
        the sweep, for deskewing.
        """
        start = given.pose(odometry, "odometry")
        end = None if odometry_end is None else given.pose(odometry_end, "odometry_end")
        return self._update(_single(scan), start, end)

    @property
    def pose(self) -> Array:
        """Pose of the newest scan: x, y [m] and yaw [rad] in the map, (3,)."""
        return (self._started.T_map_odom @ self._T_odom_base).xyt

    @property
    def T_map_odom(self) -> SE2:
        """The odometry's frame on the map."""
        return self._started.T_map_odom

    @property
    def covariance(self) -> Array:
        """Covariance of x, y [m] and yaw [rad] at the last scan that was used, (3, 3)."""
        return self._started.covariance

    @property
    def particles(self) -> Array:
        """The poses considered possible: x, y, yaw, (n, 3)."""
        return self._started.particles.xyt

    @property
    def converged(self) -> bool:
        """Whether the estimate is narrowed down to one place."""
        return self._localiser is not None and self._localiser.converged

    @property
    def lost(self) -> bool:
        """Whether it is not narrowed down to one place, or the scans do not agree with the map there."""
        return self._localiser is None or self._localiser.lost

    def _update(self, scan: Scan, T_odom_base: SE2, T_odom_base_end: SE2 | None) -> Array:
        if self._localiser is None:
            lidars = types.MountedLidar(scan.lidar, self._T_base_lidar), *self._lidars[1:]
            self._localiser = started(self._grid, lidars, self._told, self._config, self._rng)
        self._localiser.update(scan, T_odom_base, T_odom_base_end)
        self._T_odom_base = T_odom_base
        return self.pose

    @property
    def _started(self) -> AnyLocaliser:
        if self._localiser is None:
            raise InputError("no scan yet: observe or add one first")
        return self._localiser


def _single(scan: Scan) -> Scan:
    """The scan with its ranges in single precision, as drivers give them."""
    return replace(scan, ranges=np.asarray(scan.ranges, dtype=np.float32))
