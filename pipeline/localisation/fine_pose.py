"""The estimate finer than the particles: one pose, tracked beside the cloud on the map's surfaces.

The cloud finds and keeps the right place; its mean is only as fine as the map's cells and the number
of particles. Near that mean one pose is predicted by odometry and corrected by point-to-line matching
of ALL beams: an iterated extended Kalman filter. It starts from the cloud, and starts again whenever
the two disagree, so it can never be where the cloud is not.
"""

from __future__ import annotations

import math

import numpy as np

from datasets.grid import OccupancyGrid
from datasets.se2 import SE2, Array, wrap
from pipeline.localisation.estimate import Estimate
from pipeline.localisation.matching import match
from pipeline.localisation.parameters import AmclConfig
from pipeline.localisation.surfaces import fit_surfaces

# The cloud must be this narrow before a pose is tracked in it: matching reaches four cells far.
START_STD = np.array([0.15, 0.15, 0.15])
# Less than this apart, the two agree whatever the cloud's spread: its field is a cell coarse.
LEAST_REACH = np.array([0.08, 0.08, 0.08])


class FinePose:
    """The tracked pose; `correct` gives the estimate to publish."""

    def __init__(self, grid: OccupancyGrid, config: AmclConfig) -> None:
        self._surfaces = fit_surfaces(grid)
        self._config = config
        self._T_map_base: SE2 | None = None
        self._covariance = np.zeros((3, 3))

    def forget(self) -> None:
        """Stop tracking until the cloud is narrow again."""
        self._T_map_base = None

    def predict(self, T_base_new: SE2, motion: tuple[float, float, float], std: Array) -> None:
        """Move by odometry: the motion, decomposed, and the standard deviations (3,) of its parts."""
        if self._T_map_base is None:
            return
        T_map_new = self._T_map_base @ T_base_new
        dx, dy = (float(value) for value in T_map_new.xy - self._T_map_base.xy)
        F = np.array([[1.0, 0.0, -dy], [0.0, 1.0, dx], [0.0, 0.0, 1.0]])
        heading = float(self._T_map_base.yaw) + motion[0]
        c, s = math.cos(heading), math.sin(heading)
        G = np.array([[-motion[1] * s, c, 0.0], [motion[1] * c, s, 0.0], [1.0, 0.0, 1.0]])
        self._covariance = F @ self._covariance @ F.T + (G * std**2) @ G.T
        self._T_map_base = T_map_new

    def correct(self, cloud: Estimate, points_base: Array) -> SE2:
        """Pose after a scan's end points (n, 2) in the base frame; the cloud's mean when it is too wide."""
        std = np.sqrt(np.diag(cloud.core))
        if self._T_map_base is None or not self._agrees(cloud, std):
            if np.any(std > START_STD):
                self.forget()
                return cloud.T_map_base
            self._T_map_base, self._covariance = cloud.T_map_base, cloud.core
        c = self._config
        self._T_map_base, self._covariance = match(
            self._surfaces,
            self._T_map_base,
            self._covariance,
            points_base,
            scale=c.match_scale,
            beam_std=c.match_std,
            patch_beams=c.match_patch_beams,
        )
        return self._T_map_base if self._agrees(cloud, std) else cloud.T_map_base

    def _agrees(self, cloud: Estimate, std: Array) -> bool:
        assert self._T_map_base is not None
        offset = np.abs(self._T_map_base.xyt - cloud.T_map_base.xyt)
        offset[2] = abs(wrap(offset[2]))
        return bool(np.all(offset <= np.maximum(LEAST_REACH, 3.0 * std)))
