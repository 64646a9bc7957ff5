"""KISS-ICP: point-to-point registration with a local map, from any prediction.

Vizzo et al. (2023), "KISS-ICP: In Defense of Point-to-Point ICP". Its pipeline has no odometry input,
so its parts are used: the voxel map, the adaptive threshold and the registration, started from the
caller's prediction. Planar points stay planar. One thread, for the same bits every time.
All points of a scan are registered: thinned as KISS-ICP thins a hundred thousand points, the few of a planar
lidar say half as much (CSAIL: a step is off by 3.3 cm, with all of them by 1.5 cm).

As one more start of the point-to-line alignment it adds nothing where walls are seen (measured: no error of
a log with odometry changes by 1 % with or without it).
"""

from __future__ import annotations

import numpy as np
from pydantic import BaseModel, ConfigDict, Field

from datasets.se2 import SE2, Array


class KissConfig(BaseModel):
    """KISS-ICP for planar indoor lidars (its own defaults are for cars)."""

    model_config = ConfigDict(extra="forbid", frozen=True)
    voxel_m: float = Field(default=0.2, gt=0.0, description="map voxel; smaller loses track, see docs")
    initial_threshold_m: float = Field(default=0.5, gt=0.0)
    min_motion_m: float = Field(default=0.02, gt=0.0)
    iterations: int = Field(default=50, gt=0)
    min_score: float = Field(default=0.4, gt=0.0, le=1.0, description="of its answer, to be believed")


class LidarOdometry:
    """KISS-ICP's registration and local map, in the caller's frame."""

    def __init__(self, config: KissConfig, max_range: float) -> None:
        from kiss_icp.config import KISSConfig
        from kiss_icp.mapping import VoxelHashMap
        from kiss_icp.registration import Registration
        from kiss_icp.threshold import get_threshold_estimator
        from kiss_icp.voxelization import voxel_down_sample

        kiss = KISSConfig()
        kiss.data.max_range = max_range
        kiss.mapping.voxel_size = config.voxel_m
        kiss.adaptive_threshold.initial_threshold = config.initial_threshold_m
        kiss.adaptive_threshold.min_motion_th = config.min_motion_m
        self._voxel, self._thinned = config.voxel_m, voxel_down_sample
        self._map = VoxelHashMap(config.voxel_m, max_range, kiss.mapping.max_points_per_voxel)
        self._threshold = get_threshold_estimator(kiss)
        self._registration = Registration(config.iterations, 1e-4, max_num_threads=1)

    def register(self, points: Array, T_map_guess: Array) -> Array:
        """Pose (3,) of a scan's points (n, 2) against the local map, started at a guess (3,)."""
        if self._map.empty() or len(points) < 3:
            return T_map_guess
        sigma = self._threshold.get_threshold()
        guess = _matrix(T_map_guess)
        pose = self._registration.align_points_to_map(_flat(points), self._map, guess, 3.0 * sigma, sigma)
        if not np.all(np.isfinite(pose)):
            return T_map_guess
        return SE2.from_matrix(
            np.array(
                [[pose[0, 0], pose[0, 1], pose[0, 3]], [pose[1, 0], pose[1, 1], pose[1, 3]], [0, 0, 1.0]]
            )
        ).xyt

    def update(self, points: Array, T_map_base: Array, T_map_guess: Array) -> None:
        """Add the scan to the map at its final pose; the guess it started from tunes the threshold."""
        self._threshold.update_model_deviation(np.linalg.inv(_matrix(T_map_guess)) @ _matrix(T_map_base))
        self._map.update(self._thinned(_flat(points), 0.5 * self._voxel), _matrix(T_map_base))


def _flat(points: Array) -> Array:
    return np.column_stack([points, np.zeros(len(points))])


def _matrix(xyt: Array) -> Array:
    out = np.eye(4)
    c, s = np.cos(xyt[2]), np.sin(xyt[2])
    out[0, 0], out[0, 1], out[1, 0], out[1, 1] = c, -s, s, c
    out[:2, 3] = xyt[:2]
    return out
