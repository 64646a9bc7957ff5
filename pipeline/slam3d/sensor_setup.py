"""What the first clouds say of the log: how the lidar sits over the floor, and how far things are."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from pydantic import BaseModel, ConfigDict, Field

from turtlebag.datasets import se3
from turtlebag.datasets.errors import InputError
from turtlebag.datasets.se2 import Array
from turtlebag.datasets.types import Recording3D
from turtlebag.pipeline.slam3d.floor import Floor, find_floor, levelled

LOOKED_AT = 10
LEAST_POINTS = 100
SMALLEST_VOXEL_M, LARGEST_VOXEL_M = 0.25, 1.0


class SettingConfig(BaseModel):
    """What is derived from the log unless given."""

    model_config = ConfigDict(extra="forbid", frozen=True)
    voxel_m: float | None = Field(default=None, gt=0.0, description="of the surfels; all lengths follow it")
    voxel_share: float = Field(default=0.15, gt=0.0, description="of the median range, where not given")
    floor_reach: float = Field(
        default=4.0, gt=0.0, description="floor is looked for within, in median ranges"
    )


@dataclass(frozen=True, eq=False)
class Setting:
    """`T_base_lidar` (4, 4), the floor's z in the base frame [m], the voxel [m]; and notes for the user."""

    T_base_lidar: Array
    floor: float
    voxel: float
    notes: tuple[str, ...]


def find_setting(recording: Recording3D, config: SettingConfig) -> Setting:
    """Look at the first clouds that hold points; InputError when none of the log does."""
    looked: list[Array] = []
    for cloud in recording.clouds:
        near = cloud.points[np.abs(cloud.points).max(axis=1, initial=0.0) < 1000.0]
        if len(near) >= LEAST_POINTS:
            looked.append(near)
        if len(looked) == LOOKED_AT:
            break
    if not looked:
        raise InputError(f"{recording.source}: no cloud holds enough points to map with")
    ranges = [np.median(np.linalg.norm(points, axis=1)) for points in looked]
    median = float(np.median(ranges))
    voxel = config.voxel_m or float(np.clip(config.voxel_share * median, SMALLEST_VOXEL_M, LARGEST_VOXEL_M))
    reach = config.floor_reach * median
    if recording.mounted:
        return _mounted(recording, looked, reach, voxel)
    for points in looked:
        floor = find_floor(points, reach)
        if floor is not None:
            tilt = np.degrees(np.arccos(np.clip(floor.normal[2], -1.0, 1.0)))
            note = (
                f"the bag does not say where the lidar sits: by the floor it sees, {floor.height:.2f} m up "
                f"and tilted by {tilt:.1f} degrees; the base is taken to be below it"
            )
            return Setting(levelled(floor), 0.0, voxel, (note,))
    note = "the bag does not say where the lidar sits, and no floor is seen: it is taken to be the base"
    return Setting(np.eye(4), 0.0, voxel, (note,))


def _mounted(recording: Recording3D, looked: list[Array], reach: float, voxel: float) -> Setting:
    """Where the base frame is not on the floor (base_link, say), the floor is looked for below it."""
    T = recording.T_base_lidar
    for points in looked:
        floor: Floor | None = find_floor(se3.moved(T, points), reach)
        if floor is not None and floor.normal[2] > np.cos(0.1):
            z = -floor.height / floor.normal[2]
            if abs(z) < 0.03:
                return Setting(T, 0.0, voxel, ())
            note = f"the floor lies {-z:.2f} m below the base frame"
            return Setting(T, float(z), voxel, (note,))
    return Setting(T, 0.0, voxel, ())
