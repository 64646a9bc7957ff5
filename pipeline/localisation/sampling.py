"""Resampling: low variance draws, and as many of them as KLD-sampling asks for."""

from __future__ import annotations

import math

import numpy as np
from numba import njit
from numpy.typing import NDArray

from datasets.se2 import Array


def effective_size(weights: Array) -> float:
    """1 / sum w^2 of normalised weights: how many particles really count."""
    return float(1.0 / np.square(weights).sum())


@njit(cache=True)
def low_variance(weights: Array, count: int, offset: float) -> NDArray[np.int64]:
    """`count` indices drawn by one comb of equal spacing (Probabilistic Robotics, table 4.4).

    `weights` are normalised, `offset` is uniform in [0, 1).
    """
    picked = np.empty(count, dtype=np.int64)
    index, cumulative = 0, weights[0]
    for k in range(count):
        u = (k + offset) / count
        while u > cumulative and index < len(weights) - 1:
            index += 1
            cumulative += weights[index]
        picked[k] = index
    return picked


def kld_bound(bins: int, err: float, z: float) -> int:
    """Particles needed for `bins` occupied bins (Fox 2003, eq. 7), so that the error is below `err`."""
    if bins <= 1:
        return 1
    k = bins - 1
    b = 2.0 / (9.0 * k)
    return math.ceil(k / (2.0 * err) * (1.0 - b + math.sqrt(b) * z) ** 3)


def bin_keys(poses: Array, bin_xy: float, bin_yaw: float) -> NDArray[np.int64]:
    """One integer a pose, equal for poses of the same histogram bin, (n,)."""
    cells = np.floor(poses / np.array([bin_xy, bin_xy, bin_yaw])).astype(np.int64)
    return (cells[:, 0] << 42) + ((cells[:, 1] & 0x1FFFFF) << 21) + (cells[:, 2] & 0x1FFFFF)


def kld_count(keys: NDArray[np.int64], err: float, z: float, least: int) -> int:
    """How many of a sequence of draws (their bin keys, in random order) KLD-sampling would keep."""
    _, first = np.unique(keys, return_index=True)
    opened = np.sort(first)  # the draw at which the k-th bin is first met
    for bins, position in enumerate(opened, start=1):
        bound = max(kld_bound(bins, err, z), least)
        following = opened[bins] if bins < len(opened) else len(keys)
        if bound <= following:
            return max(bound, int(position) + 1)
    return len(keys)
