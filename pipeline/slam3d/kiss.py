"""KISS-ICP in space: scan-to-local-map registration from any prediction.

Vizzo et al. (2023), "KISS-ICP: In Defense of Point-to-Point ICP". Its pipeline has no odometry input and
deskews to the end of a sweep, so its parts are used: the voxel map, the adaptive threshold and the
registration. One thread, for the same bits every time.
"""

from __future__ import annotations

import numpy as np
from kiss_icp.config import KISSConfig
from kiss_icp.mapping import VoxelHashMap
from kiss_icp.registration import Registration
from kiss_icp.threshold import get_threshold_estimator
from kiss_icp.voxelization import voxel_down_sample
from pydantic import BaseModel, ConfigDict, Field

from turtlebag.datasets import se3
from turtlebag.datasets.se2 import Array

LEAST_POINTS = 20


class Kiss3dConfig(BaseModel):
    """KISS-ICP for 3D lidars."""

    model_config = ConfigDict(extra="forbid", frozen=True)
    enabled: bool = Field(default=True, description="register with KISS-ICP before the surfels")
    voxel_share: float = Field(default=1.5, gt=0.0, description="its voxel, in voxels of the surfels")
    initial_threshold_m: float = Field(default=0.5, gt=0.0)
    min_motion_m: float = Field(default=0.02, gt=0.0)
    iterations: int = Field(default=60, gt=0)


class LidarOdometry3d:
    """KISS-ICP's registration and local map, in the caller's frame."""

    def __init__(self, config: Kiss3dConfig, voxel: float, max_range: float) -> None:
        kiss = KISSConfig()
        kiss.data.max_range = max_range
        kiss.mapping.voxel_size = self._voxel = config.voxel_share * voxel
        kiss.adaptive_threshold.initial_threshold = config.initial_threshold_m
        kiss.adaptive_threshold.min_motion_th = config.min_motion_m
        self._map = VoxelHashMap(self._voxel, max_range, kiss.mapping.max_points_per_voxel)
        self._threshold = get_threshold_estimator(kiss)
        self._registration = Registration(config.iterations, 1e-4, max_num_threads=1)

    def register(self, points: Array, T_guess: Array) -> Array:
        """Pose (4, 4) of a cloud (n, 3) against the local map, started at a guess (4, 4)."""
        if self._map.empty() or len(points) < LEAST_POINTS:
            return T_guess
        source = voxel_down_sample(points, 1.5 * self._voxel)
        sigma = self._threshold.get_threshold()
        T = self._registration.align_points_to_map(source, self._map, T_guess, 3.0 * sigma, sigma)
        return np.asarray(T) if np.all(np.isfinite(T)) else T_guess

    def update(self, points: Array, T: Array, T_guess: Array) -> None:
        """Add the cloud to the map at its final pose; the guess it started from tunes the threshold."""
        self._threshold.update_model_deviation(se3.inverse(T_guess) @ T)
        self._map.update(voxel_down_sample(points, 0.5 * self._voxel), T)
