"""A pose for every cloud: carried by the refined keys around it, then aligned with the nearest of them."""

from __future__ import annotations

import numpy as np
from pydantic import BaseModel, ConfigDict, Field
from scipy.spatial import cKDTree

from turtlebag.datasets import se3
from turtlebag.datasets.se2 import Array
from turtlebag.pipeline.slam3d.cloud_tracking import Track3d, thinned
from turtlebag.pipeline.slam3d.key_clouds import gathered
from turtlebag.pipeline.slam3d.surfels import Prior, Surfels, fit, make_surfels

MOST_PLACES = 6
"""Places kept in memory: a robot goes from one to the next."""


class Posing3dConfig(BaseModel):
    """Alignment of the clouds between keys."""

    model_config = ConfigDict(extra="forbid", frozen=True)
    enabled: bool = True
    neighbours: int = Field(default=8, gt=0, description="keys that make a place")
    points: int = Field(default=1500, gt=100, description="points of a cloud that are aligned")
    gate_m: float = Field(default=0.1, gt=0.0, description="largest distance to a surfel")
    kernel_m: float = Field(default=0.03, gt=0.0)
    carried_m: float = Field(
        default=0.01, gt=0.0, description="standard deviation of the carried pose [m, rad]"
    )
    min_overlap: float = Field(default=0.4, gt=0.0, le=1.0)
    max_shift_m: float = Field(default=0.1, gt=0.0, description="a larger correction is not believed")


def carried_poses(track: Track3d, T_map_keys: Array) -> Array:
    """Each cloud's pose (n, 4, 4) carried by the keys before and after it, the correction blended."""
    keys = np.array(track.keys)
    clouds = np.arange(len(track.T))
    before = np.maximum(np.searchsorted(keys, clouds, side="right") - 1, 0)
    after = np.minimum(before + 1, len(keys) - 1)
    from_before = T_map_keys[before] @ se3.inverse(track.T[keys[before]]) @ track.T
    from_after = T_map_keys[after] @ se3.inverse(track.T[keys[after]]) @ track.T
    fraction = np.clip((clouds - keys[before]) / np.maximum(keys[after] - keys[before], 1), 0.0, 1.0)
    return se3.interpolate(from_before, from_after, fraction)


class Poser:
    """Aligns single clouds with the finished key map."""

    def __init__(self, track: Track3d, T_map_keys: Array, voxel: float, config: Posing3dConfig) -> None:
        self._track, self._T, self._voxel, self._config = track, T_map_keys, voxel, config
        self._carried = carried_poses(track, T_map_keys)
        self._keys = {index: k for k, index in enumerate(track.keys)}
        self._tree = cKDTree(T_map_keys[:, :3, 3])
        self._places: dict[int, Surfels] = {}
        self._prior = Prior(np.full(12, config.carried_m))

    def pose(self, index: int, points: Array) -> Array:
        """Pose (4, 4) in the map of a cloud with these points (n, 3); keys keep their refined one."""
        if index in self._keys:
            return np.asarray(self._T[self._keys[index]])
        config, carried = self._config, self._carried[index]
        if not config.enabled or not self._track.usable[index]:
            return np.asarray(carried)
        anchor = int(self._tree.query(carried[:3, 3])[1])
        found = fit(
            self._place(anchor),
            thinned(points, config.points),
            se3.inverse(self._T[anchor]) @ carried,
            origin=self._track.places.origin,
            gate=config.gate_m,
            kernel=config.kernel_m,
            prior=self._prior,
            iterations=8,
        )
        T = np.asarray(self._T[anchor] @ found.T)
        shift = float(np.linalg.norm(T[:3, 3] - carried[:3, 3]))
        good = found.overlap >= config.min_overlap and shift <= config.max_shift_m
        return T if good else np.asarray(carried)

    def _place(self, anchor: int) -> Surfels:
        if anchor not in self._places:
            if len(self._places) >= MOST_PLACES:
                self._places.pop(next(iter(self._places)))
            count = min(self._config.neighbours, len(self._T))
            near = np.atleast_1d(self._tree.query(self._T[anchor, :3, 3], k=count)[1])
            place = gathered(self._track.places, self._T, anchor, near.tolist())
            self._places[anchor] = make_surfels(*place, self._voxel)
        return self._places[anchor]
