"""3D SLAM from end to end: clouds in; a pose for each, a point cloud and a grid out."""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray
from pydantic import Field

from turtlebag.datasets import se3
from turtlebag.datasets.errors import InputError
from turtlebag.datasets.grid import OccupancyGrid
from turtlebag.datasets.se2 import Array
from turtlebag.datasets.se3 import SE3
from turtlebag.datasets.settings import Settings
from turtlebag.datasets.types import Recording3D, Trajectory
from turtlebag.pipeline.slam.graph.constraints import Constraint, Kind, Loop
from turtlebag.pipeline.slam.graph.pose_graph import carried_poses
from turtlebag.pipeline.slam.graph.refinement import RefineConfig
from turtlebag.pipeline.slam.mapper import Sensors
from turtlebag.pipeline.slam.odometry.calibration import ODOMETRY_SHARE
from turtlebag.pipeline.slam.progress import Progress, no_progress
from turtlebag.pipeline.slam3d.cloud_map import CloudMap, finished
from turtlebag.pipeline.slam3d.cloud_tracking import FrontEnd3d, Track3d, Tracker
from turtlebag.pipeline.slam3d.key_clouds import REACH, Places
from turtlebag.pipeline.slam3d.loops import Loop3dConfig, close_loops
from turtlebag.pipeline.slam3d.refine3d import refine, reregistered
from turtlebag.pipeline.slam3d.selfcheck3d import SelfCheck3d, check_map
from turtlebag.pipeline.slam3d.sensor_setup import SensorSetup, find_setup
from turtlebag.pipeline.slam3d.slices import SLICE_REACH_M, SliceConfig, SliceGrid
from turtlebag.pipeline.slam3d.surfels import COVARIANCE_SCALE, LEAST_OVERLAP, observable
from turtlebag.pipeline.slam3d.sweeps import Sweep, sweeps_of

HOLD = np.array([0.1, 0.1, 0.2, 0.3, 0.3, 0.3])
"""Standard deviations of a step that nothing measured: it keeps the graph in one piece [rad, m]."""
FLAT = 0.05
"""How much a floor may tilt or lift the robot from key to key, one standard deviation [rad, m]."""
MAP_VOXELS = 1.0 / 6.0
"""The voxel of the map, in voxels of the surfels."""


class Slam3dConfig(Settings):
    """Everything that shapes a 3D map."""

    sensors: Sensors = "both"
    front_end: FrontEnd3d = Field(
        default="surfels", description="estimates the clouds' poses: our surfels, KISS-ICP, or odometry"
    )
    deskew: bool = Field(default=True, description="deskew clouds that have times per point")
    voxel_m: float | None = Field(
        default=None,
        ge=0.01,
        le=10.0,
        description="size of the surfels, which all other lengths follow (default: chosen from the log)",
    )
    loops: Loop3dConfig = Loop3dConfig()
    refine: RefineConfig = RefineConfig(rounds=3)
    slice: SliceConfig = SliceConfig()


@dataclass(frozen=True, eq=False)
class Slam3dResult:
    """A pose (n, 4, 4) per cloud in file order, the point cloud (m, 3), the slice, and the graph."""

    T_map_base: Array
    trajectory: Trajectory
    points: Array
    grid: OccupancyGrid
    setup: SensorSetup
    track: Track3d
    T_map_keys: SE3
    constraints: list[Constraint]
    loops: list[Loop]
    recognised: list[Loop]
    check: SelfCheck3d

    @property
    def keys(self) -> NDArray[np.int64]:
        """Cloud index of each key."""
        return np.array(self.track.keys, dtype=np.int64)


def run_slam_3d(
    recording: Recording3D, config: Slam3dConfig, progress: Progress = no_progress
) -> Slam3dResult:
    """Map a recording offline, in two passes over its clouds. The map frame starts at the first odometry
    pose (identity without one), z at the base. InputError when there is nothing to map with."""
    recording, config = _with_sensors(recording, config)
    setup = find_setup(recording, config.voxel_m)

    def sweeps(text: str) -> Iterator[tuple[int, Sweep]]:
        clouds = sweeps_of(recording, setup.T_base_lidar, deskew=config.deskew)
        steps = progress(range(len(recording)), text, len(recording))
        return (sweep for _, sweep in zip(steps, clouds, strict=False))

    tracker = Tracker(recording, setup, config.front_end)
    for index, sweep in sweeps("matching clouds"):
        tracker.add(index, sweep)
    track = tracker.track
    if not track.keys:
        raise InputError(f"{recording.source}: no cloud has enough points for mapping")
    steps = step_constraints(track)
    T_keys, constraints, loops, recognised = track.T[track.keys], list(steps), list[Loop](), list[Loop]()
    if config.loops.enabled and len(track.keys) > 2:
        closed, recognised = close_loops(track.places, T_keys, steps, setup.voxel, config.loops)
        T_keys, loops, constraints = closed.T, closed.record, [*steps, *closed.loops]
    if config.refine.rounds > 0 and len(track.keys) > 2:
        # what was matched from key to key is matched again, where all keys have places that they are no part
        # of; loops stay as they were found
        again = len(track.keys) >= 2 * (REACH + 1)
        hold = [c for c in constraints if c.kind is not Kind.STEP or not again]
        T_keys, constraints = refine(track.places, T_keys, hold, setup.voxel, config.refine)
    T = carried_poses(SE3(track.T), np.array(track.keys), SE3(T_keys)).matrix
    T, cloud, grid = _drawn(sweeps("drawing the map"), track, T, setup, config)
    check = check_map(recording.stamps_ns, track, T_keys, constraints, setup.voxel)
    trajectory = Trajectory(recording.stamps_ns, se3.planar(T))
    return Slam3dResult(
        T, trajectory, finished(cloud), grid, setup, track, SE3(T_keys), constraints, loops, recognised, check
    )


def _with_sensors(recording: Recording3D, config: Slam3dConfig) -> tuple[Recording3D, Slam3dConfig]:
    """The recording and settings cut down to the sensors asked for."""
    if config.sensors == "lidar":
        return replace(recording, T_odom_base=None, odometry=None), config
    if config.sensors == "odometry":
        if recording.T_odom_base is None:
            raise InputError(f"{recording.source}: no odometry to map with")
        off = {
            "front_end": "odometry",
            "loops": config.loops.model_copy(update={"enabled": False}),
            "refine": config.refine.model_copy(update={"rounds": 0}),
        }
        return recording, config.model_copy(update=off)
    return recording, config


def step_constraints(track: Track3d) -> list[Constraint]:
    """Constraints between successive keys, from the clouds and from the odometry.

    In a direction the clouds are blind in only the odometry holds; where both see, the clouds do.
    """
    T, constraints = track.T[track.keys], []
    for k in range(len(track.keys) - 1):
        step = se3.inverse(T[k]) @ T[k + 1]
        seen = observable(track.information[k + 1]) / COVARIANCE_SCALE
        constraints.append(Constraint(k, k + 1, step, seen + np.diag(HOLD**-2), Kind.STEP))
        if track.T_odom is not None:
            a, b = track.T_odom[track.keys[k]], track.T_odom[track.keys[k + 1]]
            constraints.append(_odometry(k, se3.inverse(a) @ b))
        else:
            constraints.append(Constraint(k, k + 1, step, np.diag(HOLD**-2), Kind.WHEELS))
    return constraints


def _odometry(k: int, T: Array) -> Constraint:
    """Wheels: ODOMETRY_SHARE of way and turn, and a floor that is flat from key to key."""
    way, turn = np.linalg.norm(T[:3, 3]), np.linalg.norm(se3.log(T)[:3])
    along, yaw = 0.01 + ODOMETRY_SHARE * way, 0.01 + ODOMETRY_SHARE * turn
    sigmas = np.array([FLAT, FLAT, yaw, along, along, FLAT])
    return Constraint(k, k + 1, T, np.diag(sigmas**-2), Kind.WHEELS, cauchy=Constraint.CAUCHY)


def _drawn(
    sweeps: Iterable[tuple[int, Sweep]],
    track: Track3d,
    T_carried: Array,
    setup: SensorSetup,
    config: Slam3dConfig,
) -> tuple[Array, CloudMap, OccupancyGrid]:
    """The second pass: every cloud's final pose (n, 4, 4), and what it adds to the maps."""
    cloud, T = CloudMap(MAP_VOXELS * setup.voxel), T_carried.copy()
    places = Places(track.places, T[track.keys], setup.voxel)
    grid = SliceGrid(config.slice, *_extent(track, T[track.keys]))
    for index, sweep in sweeps:
        if not track.usable[index]:
            continue
        points = sweep.deskewed(track.twists[index])
        if config.refine.rounds > 0 and index not in track.keys:
            T[index] = reregistered(places, points, T[index])
        if track.overlap[index] < LEAST_OVERLAP:
            continue
        points = np.ascontiguousarray(se3.moved(T[index], points))
        cloud.add(points)
        floor = float(T[index][2, 3]) + setup.floor
        grid.add(points, (T[index] @ setup.T_base_lidar)[:3, 3].copy(), floor)
    return T, cloud, grid.grid()


def _extent(track: Track3d, T_map_keys: Array) -> tuple[Array, Array]:
    """Corners (2,) of what the keys saw within reach of the slice [m]."""
    low, high = np.full(2, np.inf), np.full(2, -np.inf)
    for T, cloud in zip(T_map_keys, track.places.clouds, strict=True):
        near = cloud[np.hypot(cloud[:, 0], cloud[:, 1]) <= SLICE_REACH_M].astype(np.float64)
        xy = np.vstack([T[None, :2, 3], se3.moved(T, near)[:, :2]])
        low, high = np.minimum(low, xy.min(axis=0)), np.maximum(high, xy.max(axis=0))
    return low, high
