"""One pose from a cloud: the weighted mean of its heaviest cluster."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from datasets.se2 import SE2, Array, wrap
from pipeline.localisation.parameters import AmclConfig
from pipeline.localisation.sampling import bin_keys

# Reach of a cluster about its mean: several bins, so that one cloud is never cut in two.
REACH_XY, REACH_YAW = 0.5, 0.6
# A variance no cloud's is taken below: 1 mm and 0.05 deg.
LEAST_VARIANCE = np.array([1e-6, 1e-6, 1e-6])


@dataclass(frozen=True, eq=False)
class Estimate:
    """Mean and covariance (`core`) of the main cluster, and the whole cloud's covariance about that mean."""

    T_map_base: SE2
    core: Array
    covariance: Array
    weight: float  # of the main cluster


def main_cluster(poses: Array, weights: Array, config: AmclConfig) -> Estimate:
    """Start at the heaviest histogram bin and move to the mean of what is within reach until it rests."""
    keys = bin_keys(poses, config.kld_bin_xy, config.kld_bin_yaw)
    _, inverse = np.unique(keys, return_inverse=True)
    heaviest = inverse == np.argmax(np.bincount(inverse, weights=weights))
    mean = weighted_mean(poses[heaviest], weights[heaviest])
    for _ in range(10):
        offset = _offset(poses, mean)
        near = (np.hypot(offset[:, 0], offset[:, 1]) < REACH_XY) & (np.abs(offset[:, 2]) < REACH_YAW)
        moved = weighted_mean(poses[near], weights[near])
        done = np.abs(_offset(moved, mean)).max() < 1e-6
        mean = moved
        if done:
            break
    offset = _offset(poses, mean)
    covariance = (weights * offset.T) @ offset
    mass = float(weights[near].sum())
    core = (weights[near] * offset[near].T) @ offset[near] / mass + np.diag(LEAST_VARIANCE)
    return Estimate(SE2.from_array(mean), core, covariance, mass)


def weighted_mean(poses: Array, weights: Array) -> Array:
    """Mean pose (3,): linear in position, circular in yaw."""
    x, y = np.average(poses[:, :2], axis=0, weights=weights)
    yaw = np.arctan2(weights @ np.sin(poses[:, 2]), weights @ np.cos(poses[:, 2]))
    return np.array([x, y, yaw])


def _offset(poses: Array, mean: Array) -> Array:
    offset = poses - mean
    offset[..., 2] = wrap(offset[..., 2])
    return offset
