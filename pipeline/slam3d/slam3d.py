"""The whole of 3D SLAM on one screen: clouds in; a pose for each, a point cloud and a grid out."""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray
from pydantic import BaseModel, ConfigDict

from turtlebag.datasets import se3
from turtlebag.datasets.errors import InputError
from turtlebag.datasets.grid import OccupancyGrid
from turtlebag.datasets.se2 import Array
from turtlebag.datasets.types import Recording3D, Trajectory
from turtlebag.pipeline.slam.factors import Constraint
from turtlebag.pipeline.slam.loop_closure import Progress
from turtlebag.pipeline.slam.slam import Sensors, no_progress
from turtlebag.pipeline.slam3d.cloud_map import CloudMap, CloudMapConfig, finished
from turtlebag.pipeline.slam3d.cloud_poses import Poser, Posing3dConfig, carried_poses
from turtlebag.pipeline.slam3d.cloud_tracking import Track3d, Tracker, Tracking3dConfig
from turtlebag.pipeline.slam3d.loops import Loop3d, Loop3dConfig, close_loops
from turtlebag.pipeline.slam3d.refine import Refine3dConfig, observable, refine
from turtlebag.pipeline.slam3d.selfcheck import SelfCheck3d, SelfCheck3dConfig, check_map
from turtlebag.pipeline.slam3d.sensor_setup import Setting, SettingConfig, find_setting
from turtlebag.pipeline.slam3d.slices import SliceConfig, SliceGrid
from turtlebag.pipeline.slam3d.sweeps import Sweep, SweepConfig, Sweeps

STEP_INFLATION = 50.0
"""The points of a cloud share their errors: a match is worth far less than the sum of its points."""
HOLD = np.array([0.1, 0.1, 0.2, 0.3, 0.3, 0.3])
"""Standard deviations of a step that nothing measured: it keeps the graph in one piece [rad, m]."""


class Slam3dConfig(BaseModel):
    """Everything that shapes a 3D map."""

    model_config = ConfigDict(extra="forbid", frozen=True)
    sensors: Sensors = "both"
    sweeps: SweepConfig = SweepConfig()
    setting: SettingConfig = SettingConfig()
    tracking: Tracking3dConfig = Tracking3dConfig()
    loops: Loop3dConfig = Loop3dConfig()
    refine: Refine3dConfig = Refine3dConfig()
    posing: Posing3dConfig = Posing3dConfig()
    self_check: SelfCheck3dConfig = SelfCheck3dConfig()
    slice: SliceConfig = SliceConfig()
    cloud: CloudMapConfig = CloudMapConfig()


@dataclass(frozen=True, eq=False)
class Slam3dResult:
    """A pose (n, 4, 4) per cloud in file order, the point cloud (m, 3), the slice, and the graph."""

    T_map_base: Array
    trajectory: Trajectory
    points: Array
    grid: OccupancyGrid
    setting: Setting
    track: Track3d
    T_map_keys: Array
    constraints: list[Constraint]
    loops: list[Loop3d]
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
    setting = find_setting(recording, config.setting)
    voxel, tracker = (
        setting.voxel,
        Tracker(recording, setting, config.sweeps.max_range_m, config.tracking),
    )
    sweeps = Sweeps(recording, setting.T_base_lidar, config.sweeps)
    track = tracker.run(_shown(sweeps, progress, "matching clouds", len(recording)))
    if not track.keys:
        raise InputError(f"{recording.source}: no cloud holds enough points to map with")
    steps = step_constraints(track)
    T_map_keys, constraints, loops = track.T[track.keys], list(steps), list[Loop3d]()
    if config.loops.enabled and len(track.keys) > 2:
        T_map_keys, closed, loops = close_loops(track.places, T_map_keys, steps, voxel, config.loops)
        constraints += closed
    if config.refine.rounds > 0 and len(track.keys) > 2:
        hold = [step for step in steps if step.kind == "odometry"]
        T_map_keys, constraints = refine(track.places, T_map_keys, hold, voxel, config.refine)
    shown = _shown(sweeps, progress, "drawing the map", len(recording))
    T, cloud, grid = _drawn(shown, track, T_map_keys, setting, config)
    check = check_map(track, T_map_keys, constraints, voxel, config.self_check)
    trajectory = Trajectory(recording.stamps_ns, se3.planar(T))
    points = finished(cloud, config.cloud)
    return Slam3dResult(T, trajectory, points, grid, setting, track, T_map_keys, constraints, loops, check)


def _with_sensors(recording: Recording3D, config: Slam3dConfig) -> tuple[Recording3D, Slam3dConfig]:
    """The recording and settings cut down to the witnesses asked for."""
    if config.sensors == "lidar":
        return replace(recording, T_odom_base=None, odometry=None), config
    if config.sensors == "odometry":
        if recording.T_odom_base is None:
            raise InputError(f"{recording.source}: no odometry to map with")
        off = {
            "tracking": config.tracking.model_copy(update={"believe": "odometry"}),
            "loops": config.loops.model_copy(update={"enabled": False}),
            "refine": config.refine.model_copy(update={"rounds": 0}),
            "posing": config.posing.model_copy(update={"enabled": False}),
        }
        return recording, config.model_copy(update=off)
    return recording, config


def _shown(sweeps: Sweeps, progress: Progress, text: str, total: int) -> Iterator[tuple[int, Sweep]]:
    for _, item in zip(progress(range(total), text, total), sweeps, strict=False):
        yield item


def step_constraints(track: Track3d) -> list[Constraint]:
    """Between successive keys: what the clouds saw, and what the odometry says.

    In a direction the clouds are blind in only the odometry holds; where both see, the clouds do.
    """
    T, constraints = track.T[track.keys], []
    for k in range(len(track.keys) - 1):
        step = se3.inverse(T[k]) @ T[k + 1]
        seen = observable(track.information[k + 1]) / STEP_INFLATION
        constraints.append(Constraint(k, k + 1, step, seen + np.diag(HOLD**-2), "step"))
        if track.T_odom is not None:
            a, b = track.T_odom[track.keys[k]], track.T_odom[track.keys[k + 1]]
            constraints.append(_odometry(k, se3.inverse(a) @ b))
        else:
            constraints.append(Constraint(k, k + 1, step, np.diag(HOLD**-2), "odometry"))
    return constraints


def _odometry(k: int, T: Array) -> Constraint:
    """Wheels: five per cent of way and turn, and a floor that is flat from key to key."""
    way, turn = np.linalg.norm(T[:3, 3]), np.linalg.norm(se3.log(T)[:3])
    along, yaw = 0.01 + 0.05 * way, 0.01 + 0.05 * turn
    sigmas = np.array([0.05, 0.05, yaw, along, along, 0.05])
    return Constraint(k, k + 1, T, np.diag(sigmas**-2), "odometry", soft=2.0)


def _drawn(
    sweeps: Iterable[tuple[int, Sweep]],
    track: Track3d,
    T_map_keys: Array,
    setting: Setting,
    config: Slam3dConfig,
) -> tuple[Array, CloudMap, OccupancyGrid]:
    """The second pass: every cloud's final pose (n, 4, 4), and what it adds to the maps."""
    T = carried_poses(track, T_map_keys)
    poser = Poser(track, T_map_keys, setting.voxel, config.posing)
    cloud = CloudMap(config.cloud.voxel_m or setting.voxel / 6.0, config.cloud.max_voxels)
    grid = SliceGrid(config.slice, *_extent(track, T_map_keys, config.slice.max_range_m))
    for index, sweep in sweeps:
        points = sweep.deskewed(track.twists[index])
        T[index] = poser.pose(index, points)
        if not track.usable[index] or track.overlap[index] < config.self_check.min_overlap:
            continue
        points_map = np.ascontiguousarray(se3.moved(T[index], points))
        cloud.add(points_map)
        floor = float(T[index][2, 3]) + setting.floor
        grid.add(points_map, (T[index] @ setting.T_base_lidar)[:3, 3].copy(), floor)
    return T, cloud, grid.grid()


def _extent(track: Track3d, T_map_keys: Array, reach: float) -> tuple[Array, Array]:
    """Corners (2,) of what the keys saw within reach [m]."""
    low, high = np.full(2, np.inf), np.full(2, -np.inf)
    for T, cloud in zip(T_map_keys, track.places.clouds, strict=True):
        near = cloud[np.hypot(cloud[:, 0], cloud[:, 1]) <= reach].astype(np.float64)
        xy = np.vstack([T[None, :2, 3], se3.moved(T, near)[:, :2]])
        low, high = np.minimum(low, xy.min(axis=0)), np.maximum(high, xy.max(axis=0))
    return low, high
