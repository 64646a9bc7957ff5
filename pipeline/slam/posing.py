"""A pose for every scan: carried by the refined key scans, then aligned with the nearest of them."""

from __future__ import annotations

import numpy as np
from pydantic import BaseModel, ConfigDict, Field
from scipy.spatial import cKDTree

from datasets.se2 import SE2
from pipeline.slam.align import align
from pipeline.slam.clouds import Clouds
from pipeline.slam.tracking import Track


class PosingConfig(BaseModel):
    """Alignment of the scans between key scans."""

    model_config = ConfigDict(extra="forbid", frozen=True)
    enabled: bool = True
    neighbours: int = Field(default=6, gt=0, description="key scans a scan is aligned with")
    most_points: int = Field(default=400, gt=0, description="points of a scan that are aligned")
    gate_m: float = Field(default=0.15, gt=0.0)
    sigma_m: float = Field(default=0.03, gt=0.0)
    carried_m: float = Field(default=0.003, gt=0.0, description="standard deviation of the carried pose")
    min_overlap: float = Field(default=0.3, gt=0.0, le=1.0)
    max_shift_m: float = Field(default=0.1, gt=0.0, description="a larger correction is not believed")


def carried_poses(track: Track, T_map_keys: SE2) -> SE2:
    """Each scan carried by the key scans before and after it, the correction blended between them."""
    keys = track.keys
    scans = np.arange(len(track.T_track_base))
    before = np.searchsorted(keys, scans, side="right") - 1
    after = np.minimum(before + 1, len(keys) - 1)
    T_track = track.T_track_base
    from_before = T_map_keys[before] @ (T_track[keys[before]].inverse() @ T_track)
    from_after = T_map_keys[after] @ (T_track[keys[after]].inverse() @ T_track)
    fraction = (scans - keys[before]) / np.maximum(keys[after] - keys[before], 1)
    return from_before.interpolate(from_after, fraction)


def pose_all_scans(clouds: Clouds, track: Track, T_map_keys: SE2, config: PosingConfig) -> SE2:
    """Poses (n,) of all scans in the map; key scans keep their refined ones."""
    carried = carried_poses(track, T_map_keys)
    if not config.enabled or len(track.keys) < 2:
        return carried
    poses = carried.xyt.copy()
    count = min(config.neighbours, len(track.keys))
    near = np.atleast_2d(cKDTree(T_map_keys.xy).query(carried.xy, k=count)[1]).reshape(len(poses), count)
    information = np.diag([config.carried_m**-2, config.carried_m**-2, (0.5 * config.carried_m) ** -2])
    is_key = np.zeros(len(poses), dtype=bool)
    is_key[track.keys] = True
    for scan in np.flatnonzero(~is_key & track.usable):
        result = align(
            clouds,
            int(scan),
            poses[scan],
            track.keys[near[scan]],
            T_map_keys.xyt[near[scan]],
            gate=config.gate_m,
            sigma=config.sigma_m,
            iterations=5,
            most_points=config.most_points,
            prior=poses[scan],
            prior_information=information,
        )
        shift = np.linalg.norm(result.T_map_base.xy - poses[scan, :2])
        if result.overlap >= config.min_overlap and shift <= config.max_shift_m:
            poses[scan] = result.T_map_base.xyt
    return SE2(poses)
