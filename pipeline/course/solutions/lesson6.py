"""Lesson 6 solved: particles weighted by a likelihood field."""

from __future__ import annotations

import numpy as np

from turtlebag.datasets.se2 import SE2, Array

COUNT, SIGMA_M = 600, 0.1


class ParticleFilter:
    """Move, weigh, average, resample."""

    def __init__(self, distance: Array, resolution: float, origin: Array, start: Array, seed: int) -> None:
        self.distance, self.resolution, self.origin = distance, resolution, origin
        self.rng = np.random.default_rng(seed)
        self.poses = start + self.rng.normal(0.0, [0.2, 0.2, 0.12], (COUNT, 3))

    def update(self, motion: Array, points: Array) -> Array:
        """The weighted mean of the particles (3,)."""
        size = np.hypot(*motion[:2]) + 0.3 * abs(motion[2])
        spread = 0.005 + size * np.array([0.12, 0.06, 0.2])
        moves = motion + self.rng.normal(0.0, 1.0, (COUNT, 3)) * spread
        self.poses = (SE2.from_array(self.poses) @ SE2.from_array(moves)).xyt
        hits = SE2.from_array(self.poses)[:, None] @ points
        cells = np.floor((hits - self.origin) / self.resolution).astype(int)
        rows = np.clip(cells[..., 1], 0, self.distance.shape[0] - 1)
        cols = np.clip(cells[..., 0], 0, self.distance.shape[1] - 1)
        score = -0.5 * np.mean(np.minimum(self.distance[rows, cols] / SIGMA_M, 4.0) ** 2, axis=1) * 20.0
        weight = np.exp(score - score.max())
        weight /= weight.sum()
        yaw = np.arctan2(weight @ np.sin(self.poses[:, 2]), weight @ np.cos(self.poses[:, 2]))
        mean = np.array([*(weight @ self.poses[:, :2]), yaw])
        picks = (self.rng.random() + np.arange(COUNT)) / COUNT
        self.poses = self.poses[np.minimum(np.searchsorted(np.cumsum(weight), picks), COUNT - 1)]
        return mean
