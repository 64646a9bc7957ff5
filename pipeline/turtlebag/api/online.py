"""Mapping and localising scan by scan, from the simulator's observations or your own arrays."""

from __future__ import annotations

import os
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any, Literal

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


class _Listener:
    """The laser's pose on the robot, and checks of what is passed in."""

    def __init__(self, robot: PathLike, laser: Pose | None) -> None:
        if laser is not None:
            self.T_base_lidar = given.pose(laser, "laser")
            self.lidars: tuple[types.MountedLidar, ...] = ()
        else:
            self.lidars = load_robot(os.fspath(robot)).mounted()
            self.T_base_lidar = self.lidars[0].T_base_lidar
        self.scan: Scan | None = None
        self._scans: dict[int, Scan] = {}
        self.odometry: SE2 | types.Trajectory | None = None
        self.observed_ns: int | None = None

    def heard(self, scan: Scan, odometry: Any) -> tuple[Scan, SE2 | types.Trajectory | None]:
        """A scan and its odometry, checked against the earlier ones; InputError names the problem."""
        checked = given.scan(scan, self._scans.get(scan.sensor))
        first = self.scan is None
        moved = given.odometry(odometry, self.odometry, first)
        self.scan = self._scans[scan.sensor] = checked
        self.odometry = moved
        return checked, moved

    def observed(self, observation: Observation) -> None:
        """InputError unless it is later than the last one."""
        if self.observed_ns is not None and observation.stamp_ns <= self.observed_ns:
            raise InputError(f"observation: stamp {observation.stamp_ns} is not after the previous one")
        self.observed_ns = observation.stamp_ns


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
        self._heard = _Listener(robot, laser)
        chosen = {**(settings or {}), **({} if front_end is None else {"front_end": front_end})}
        slam = load_config(SlamConfig, None if config is None else Path(config), chosen)
        lidars = self._heard.lidars if len(self._heard.lidars) > 1 else ()
        self._online = OnlineMap(self._heard.T_base_lidar, slam, lidars)

    def __len__(self) -> int:
        return 0 if self._online.mapper is None else len(self._online.mapper)

    def observe(self, observation: Observation) -> Array | None:
        """Take in what the simulator's robot sensed; the pose (3,) where that brought a scan, else None."""
        self._heard.observed(observation)
        before = len(self)
        self._online.observe(observation)
        return self.pose if len(self) > before else None

    def add(
        self, scan: Scan, odometry: Pose | types.Trajectory | None = None, imu: Sequence[Imu] = ()
    ) -> Array:
        """Place a scan: x, y [m] and yaw [rad] of the base in the map at its stamp, (3,).

        `odometry` is the pose of the base in the odometry's frame at that stamp, or a trajectory of it since
        the last scan's, to the end of the sweep; the same kind, or none, for every scan. `imu` are the
        samples since the last scan. InputError for stamps that do not increase, arrays of another shape,
        non-finite numbers and changing kinds; the scan is then not used.
        """
        samples = given.imu(imu)
        self._online.add(*self._heard.heard(scan, odometry), samples)
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
        self._heard = _Listener(robot, laser)
        self._config = load_localise_config(None if config is None else Path(config), settings or {})
        self._grid = map if isinstance(map, OccupancyGrid) else as_map(map).occupancy
        self._rng = stream(seed, "amcl")
        self._buffer = OdometryBuffer()
        self._localiser: AnyLocaliser | None = None
        self._T_odom_base = SE2.identity()

    def observe(self, observation: Observation) -> Array | None:
        """Take in what the simulator's robot sensed; the pose (3,) where that brought a scan, else None."""
        self._heard.observed(observation)
        self._buffer.add(observation.odometry.stamp_ns, observation.odometry.T_odom_base)
        scan = observation.scan
        if scan is None:
            return None
        return self._update(scan, self._buffer.at(scan.stamp_ns), self._buffer.at(sweep_end_ns(scan)))

    def add(self, scan: Scan, odometry: Pose, odometry_end: Pose | None = None) -> Array:
        """Update with a scan: x, y [m] and yaw [rad] of the base in the map at its stamp, (3,).

        `odometry` is the pose of the base in the odometry's frame at that stamp, `odometry_end` at the end of
        the sweep, for deskewing. InputError as for `Mapper.add`.
        """
        start = given.pose(odometry, "odometry")
        end = None if odometry_end is None else given.pose(odometry_end, "odometry_end")
        heard, _ = self._heard.heard(scan, start)
        return self._update(heard, start, end)

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
            lidars = self._heard.lidars[1:]
            first = types.MountedLidar(scan.lidar, self._heard.T_base_lidar)
            self._localiser = started(self._grid, (first, *lidars), self._told, self._config, self._rng)
        self._localiser.update(scan, T_odom_base, T_odom_base_end)
        self._T_odom_base = T_odom_base
        return self.pose

    @property
    def _started(self) -> AnyLocaliser:
        if self._localiser is None:
            raise InputError("no scan yet: observe or add one first")
        return self._localiser
