"""Sensor set-up from the first clouds of a log: the lidar's pose above the floor, and the voxel size."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from turtlebag.datasets import se3
from turtlebag.datasets.errors import InputError
from turtlebag.datasets.se2 import Array
from turtlebag.datasets.types import Recording3D
from turtlebag.pipeline.slam3d.floor import find_floor, levelled
from turtlebag.pipeline.slam3d.sweeps import MAX_RANGE_M

LOOKED_AT, LEAST_POINTS = 10, 100
VOXEL_SHARE, SMALLEST_VOXEL_M, LARGEST_VOXEL_M = 0.15, 0.25, 1.0
"""The voxel as a share of the median range, and its limits."""
MAX_SLOPE_RAD, ON_FLOOR_M = 0.1, 0.03
"""How far a floor may slope to a base frame that is known, or between two visits; and how far below it may be
the same."""
FLOOR_REACH = 4.0
"""The floor is searched within this many median ranges."""


@dataclass(frozen=True, eq=False)
class SensorSetup:
    """`T_base_lidar` (4, 4), the floor's z in the base frame [m], the voxel [m]; and notes for the user."""

    T_base_lidar: Array
    floor: float
    voxel: float
    notes: tuple[str, ...]


def find_setup(recording: Recording3D, voxel_m: float | None) -> SensorSetup:
    """Look at the first clouds that hold points; `voxel_m` is the user's. InputError when no cloud does."""
    looked: list[Array] = []
    for cloud in recording.clouds:
        near = cloud.points[np.abs(cloud.points).max(axis=1, initial=0.0) < MAX_RANGE_M]
        if len(near) >= LEAST_POINTS:
            looked.append(near)
        if len(looked) == LOOKED_AT:
            break
    if not looked:
        raise InputError(f"{recording.source}: no cloud has enough points for mapping")
    ranges = [np.median(np.linalg.norm(points, axis=1)) for points in looked]
    median = float(np.median(ranges))
    voxel = voxel_m or float(np.clip(VOXEL_SHARE * median, SMALLEST_VOXEL_M, LARGEST_VOXEL_M))
    reach = FLOOR_REACH * median
    T = recording.T_base_lidar if recording.mounted else np.eye(4)
    floors = (find_floor(se3.moved(T, points), reach) for points in looked)
    if not recording.mounted:
        for floor in (one for one in floors if one is not None):
            tilt = np.degrees(np.arccos(np.clip(floor.normal[2], -1.0, 1.0)))
            note = (
                f"the bag does not give the lidar's mounting: by the floor, {floor.height:.2f} m up and "
                f"tilted by {tilt:.1f} degrees; assuming that the base is below it"
            )
            return SensorSetup(levelled(floor), 0.0, voxel, (note,))
        note = (
            "the bag does not give the lidar's mounting, and no floor is visible: assuming it is at the base"
        )
        return SensorSetup(T, 0.0, voxel, (note,))
    # where the base frame is not on the floor (base_link, say), that lies below it
    for floor in (one for one in floors if one is not None and one.normal[2] > np.cos(MAX_SLOPE_RAD)):
        z = -floor.height / floor.normal[2]
        if abs(z) < ON_FLOOR_M:
            break
        return SensorSetup(T, float(z), voxel, (f"the floor lies {-z:.2f} m below the base frame",))
    return SensorSetup(T, 0.0, voxel, ())
