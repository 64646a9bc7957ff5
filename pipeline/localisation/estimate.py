"""The pose estimate of a particle cloud: the weighted mean of its heaviest cluster."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np

from turtlebag.datasets.kernels import njit
from turtlebag.datasets.se2 import SE2, Array
from turtlebag.pipeline.localisation.resampling import BIN_M, BIN_RAD, bin_numbers

# Radius of a cluster around its mean: several bins, so that no cloud is cut in two (not measured).
REACH_XY, REACH_YAW = 0.5, 0.6
# A cloud is narrow, one place, if its standard deviations are below these (not measured).
NARROW_M, NARROW_RAD = 0.15, 0.1
# A cluster is searched from this many of the heaviest bins, and its mean shifted at most this many times.
# From the heaviest alone, 12 drives have the same errors, but the lesser of two clusters that no border cuts
# may win.
MOST_SEEDS, MOST_SHIFTS = 5, 10
# The smallest variance of a cloud: 1 mm and 0.05 deg.
LEAST_VARIANCE = 1e-6


@dataclass(frozen=True, eq=False)
class Estimate:
    """Mean and covariance (`core`) of the main cluster, and the whole cloud's covariance about that mean."""

    T_map_base: SE2
    core: Array
    covariance: Array

    @cached_property
    def narrow(self) -> bool:
        """Whether the whole cloud is one place."""
        return narrow(self.covariance)


def narrow(covariance: Array) -> bool:
    """Whether poses of this covariance (3, 3) are one place."""
    x, y, yaw = np.sqrt(np.diag(covariance))
    return bool(max(x, y) <= NARROW_M and yaw <= NARROW_RAD)


def main_cluster(poses: Array, weights: Array) -> Estimate:
    """The heaviest cluster: from each of the heaviest histogram bins, the mean shifts to that of its
    neighbourhood."""
    numbers = bin_numbers(poses, BIN_M, BIN_RAD)
    bins = np.bincount(numbers, weights=weights)
    best: tuple[float, Array, Array] | None = None
    # A bin's border may cut a cluster: the heaviest bin need not belong to the heaviest cluster.
    for heavy in np.argsort(-bins, kind="stable")[:MOST_SEEDS]:
        seed = poses[np.argmax(numbers == heavy)]
        cluster = settled(poses, weights, moments(poses, weights, seed, BIN_M, BIN_RAD)[1])
        if best is None or cluster[0] > best[0]:
            best = cluster
        if best[0] > 0.5:
            break
    assert best is not None
    mass, mean, core = best
    everything = 1.0 - mass < 1e-9
    covariance = core if everything else moments(poses, weights, mean, np.inf, np.inf)[2]
    return Estimate(SE2.from_array(mean), core + LEAST_VARIANCE * np.eye(3), covariance)


def settled(poses: Array, weights: Array, mean: Array) -> tuple[float, Array, Array]:
    """Mass, mean (3,) and covariance (3, 3) of the cluster that a mean shifts into."""
    for _ in range(MOST_SHIFTS):
        mass, moved, core = moments(poses, weights, mean, REACH_XY, REACH_YAW)
        if np.abs(moved - mean).max() < 1e-4:
            break
        mean = moved
    return mass, moved, core


@njit(cache=True)
def moments(
    poses: Array, weights: Array, centre: Array, reach_xy: float, reach_yaw: float
) -> tuple[float, Array, Array]:
    """Mass, mean pose (3,) and second moment about `centre` (3, 3) of the particles within reach of it."""
    mass, tx, ty, ta = 0.0, 0.0, 0.0, 0.0
    xx, xy, xa, yy, ya, aa = 0.0, 0.0, 0.0, 0.0, 0.0, 0.0
    for i in range(len(poses)):
        x, y, a = poses[i, 0] - centre[0], poses[i, 1] - centre[1], poses[i, 2] - centre[2]
        a -= 2.0 * np.pi * np.floor((a + np.pi) / (2.0 * np.pi))
        if x * x + y * y > reach_xy * reach_xy or abs(a) > reach_yaw:
            continue
        w = weights[i]
        mass, tx, ty, ta = mass + w, tx + w * x, ty + w * y, ta + w * a
        xx, xy, xa = xx + w * x * x, xy + w * x * y, xa + w * x * a
        yy, ya, aa = yy + w * y * y, ya + w * y * a, aa + w * a * a
    second = np.array([[xx, xy, xa], [xy, yy, ya], [xa, ya, aa]])
    if mass <= 0.0:
        return 0.0, centre.copy(), second
    return mass, centre + np.array([tx, ty, ta]) / mass, second / mass
