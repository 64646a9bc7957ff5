"""Particles and their resampling: low-variance sampling, with the number of particles by KLD-sampling."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from turtlebag.datasets.kernels import njit
from turtlebag.datasets.se2 import Array
from turtlebag.pipeline.localisation.parameters import AmclConfig

# Bins of the histogram by which KLD-sampling counts particles: ROS amcl's heading, half its width [m].
BIN_M, BIN_RAD = 0.25, math.radians(10.0)


@dataclass(frozen=True, eq=False)
class Cloud:
    """Particles (n, 3) in the map frame and their normalised weights (n,)."""

    poses: Array
    weights: Array

    @classmethod
    def even(cls, poses: Array) -> Cloud:
        """All particles weigh the same."""
        return cls(poses, np.full(len(poses), 1.0 / len(poses)) if len(poses) else np.zeros(0))

    def weighed(self, log_likelihood: Array) -> Cloud:
        """The weights times the likelihood (n,) of a scan from each particle."""
        log_weights = np.log(np.maximum(self.weights, 1e-300)) + log_likelihood
        weights = np.exp(log_weights - log_weights.max())
        return Cloud(self.poses, weights / weights.sum())

    def due(self, config: AmclConfig, update: int) -> bool:
        """Whether to resample at the filter's `update`, counted from 1: at its interval and, if
        resampling is selective, where less than half of the particles count."""
        if update % config.resample_interval:
            return False
        return not config.selective_resampling or effective_size(self.weights) <= 0.5 * len(self.weights)

    def resampled(
        self, config: AmclConfig, rng: np.random.Generator, found: Array | None = None, share: float = 0.0
    ) -> Cloud:
        """As many particles as KLD-sampling asks for; a `share` of them are the first poses of `found`."""
        pool = low_variance(self.weights, config.max_particles, rng.random())
        bins = bin_numbers(self.poses, BIN_M, BIN_RAD)[scattered(pool, rng.random())]
        count = kld_count(bins, config.kld_err, config.kld_z, config.min_particles)
        new = np.zeros((0, 3)) if found is None else found[: int(share * count)]
        kept = self.poses[low_variance(self.weights, count - len(new), rng.random())]
        return Cloud.even(np.concatenate([kept, new]))


def effective_size(weights: Array) -> float:
    """1 / sum w^2 of normalised weights: how many particles really count."""
    return float(1.0 / np.square(weights).sum())


@njit(cache=True)
def low_variance(weights: Array, count: int, offset: float) -> NDArray[np.int64]:
    """`count` indices drawn by one comb of equal spacing (Probabilistic Robotics, table 4.4).

    `weights` are normalised, `offset` is uniform in [0, 1).
    """
    # How many teeth end with each weight, then a running sum: without a branch for the processor to guess.
    passed, cumulative = np.zeros(count + 1, dtype=np.int64), 0.0
    for weight in weights[:-1]:
        cumulative += weight
        passed[min(math.floor(cumulative * count - offset) + 1, count)] += 1
    picked, index = np.empty(count, dtype=np.int64), 0
    for k in range(count):
        index += passed[k]
        picked[k] = index
    return picked


@njit(cache=True)
def scattered(values: NDArray[np.int64], offset: float) -> NDArray[np.int64]:
    """The same in another order, in which neighbours come far apart, from a place `offset` in [0, 1) on.

    Wherever it ends, it had its share of every stretch, as in a random order, which takes ten times as long.
    """
    n = len(values)
    step = max(1, int(n * (math.sqrt(5.0) - 1.0) / 2.0))  # the golden ratio
    while math.gcd(step, n) > 1:
        step += 1
    out, at = np.empty_like(values), int(offset * n)
    for k in range(n):
        out[k] = values[at]
        at = (at + step) % n
    return out


@njit(cache=True)
def kld_bound(bins: int, err: float, z: float) -> int:
    """Particles needed for `bins` occupied bins (Fox 2003, eq. 7), so that the error is below `err`."""
    if bins <= 1:
        return 1
    k = bins - 1
    b = 2.0 / (9.0 * k)
    return math.ceil(k / (2.0 * err) * (1.0 - b + math.sqrt(b) * z) ** 3)


@njit(cache=True)
def bin_numbers(poses: Array, bin_xy: float, bin_yaw: float) -> NDArray[np.int64]:
    """Histogram bin of each pose, (n,), numbered in the order in which bins are first met."""
    size = 16
    while size < 2 * len(poses):
        size *= 2
    packed, number = np.empty(size, dtype=np.int64), np.full(size, -1)
    bins, met = np.empty(len(poses), dtype=np.int64), 0
    for i in range(len(poses)):
        x, y = int(np.floor(poses[i, 0] / bin_xy)), int(np.floor(poses[i, 1] / bin_xy))
        # One number a bin: each index has 21 bits, which are 500 km of quarter metres.
        key = (x << 42) + (y << 21) + int(np.floor(poses[i, 2] / bin_yaw))
        at = (x * 73856093 ^ y * 19349663 ^ key * 83492791) & (size - 1)  # Teschner et al. 2003
        while number[at] >= 0 and packed[at] != key:
            at = (at + 1) & (size - 1)
        if number[at] < 0:
            packed[at], number[at] = key, met
            met += 1
        bins[i] = number[at]
    return bins


@njit(cache=True)
def kld_count(numbers: NDArray[np.int64], err: float, z: float, least: int) -> int:
    """How many of a sequence of draws KLD-sampling would keep, from their bin numbers."""
    bins, bound, met = 0, least, np.zeros(numbers.max() + 1, dtype=np.bool_)
    for drawn in range(len(numbers)):
        if drawn >= bound:
            return drawn
        if not met[numbers[drawn]]:
            met[numbers[drawn]] = True
            bins += 1
            bound = max(least, kld_bound(bins, err, z))
    return len(numbers)
