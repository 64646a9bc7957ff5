"""Free-space violations: walls of one scan that another one saw through."""

from __future__ import annotations

import math

import numpy as np
import scipy
from numpy.typing import NDArray

from turtlebag.datasets.bearing import bearing
from turtlebag.datasets.kernels import njit
from turtlebag.datasets.se2 import Array
from turtlebag.datasets.threads import in_parts
from turtlebag.pipeline.slam.graph.partners import compared, earlier_in_place
from turtlebag.pipeline.slam.scans.clouds import Clouds
from turtlebag.pipeline.slam.scans.correspondences import relative_pose

# A point this near a wall of the other scan agrees with it; a point this far in front of everything that the
# other scan saw there violates its free space [m].
WALL_M, THROUGH_M = 0.15, 0.4
# Key scans this near are visits of one place [m]; at most this many pairs are compared.
NEAR_M, MOST_PAIRS = 1.5, 3000
# The largest share of free-space violations between two visits of one place, beyond what is usual in the log:
# true loops reach 0.04 (CSAIL, belgioioso), those that fold mazes of identical cells 0.07 to 0.19.
MOST_VIOLATIONS = 0.05


def free_space_violations(
    clouds: Clouds, scans: NDArray[np.int64], poses: Array, pairs: NDArray[np.int64]
) -> Array:
    """Share of points that violate the other's free space in each pair (n, 2) of scans (k,) at poses (k, 3),
    the worse of both ways; NaN where they see too little of each other."""
    both_ways = np.concatenate([pairs, pairs[:, ::-1]])
    found = in_parts(
        lambda part: violation_shares(clouds, scans, poses, both_ways[part], WALL_M, THROUGH_M),
        len(both_ways),
    )
    return np.asarray(np.fmax(*np.concatenate(found).reshape(2, -1)))


def contradicts(violation: float, usual: float = 0.0) -> bool:
    """Whether the mean share of violations between two visits says that they were not at one place, in a log
    where such a share is usual."""
    return violation > usual + MOST_VIOLATIONS


def visits(poses: Array) -> NDArray[np.int64]:
    """Pairs (n, 2) of keys at poses (k, 3) that are visits of one place, in order."""
    found = []
    for some, others in compared(earlier_in_place(poses)):
        one, other = (scipy.spatial.cKDTree(poses[keys, :2]) for keys in (some, others))
        near = one.sparse_distance_matrix(other, NEAR_M, output_type="coo_matrix")
        found.append(np.sort([some[near.row], others[near.col]], axis=0))
    pairs = np.concatenate(found, axis=1)
    numbers = pairs[0] * len(poses) + pairs[1]
    return np.column_stack(np.divmod(np.unique(numbers[pairs[0] < pairs[1]]), len(poses)))


def thinned(pairs: NDArray[np.int64], times: int = 1) -> NDArray[np.int64]:
    """Every second, third, ... of pairs (n, 2), if there are more than so many times MOST_PAIRS."""
    return pairs[:: max(1, len(pairs) // (times * MOST_PAIRS))]


def mean_violation(
    clouds: Clouds,
    scans: NDArray[np.int64],
    poses: Array,
    pairs: NDArray[np.int64],
    unknown: float,
) -> float:
    """Their mean over pairs of scans; `unknown` where no pair sees enough of each other."""
    shares = free_space_violations(clouds, scans, poses, pairs)
    shares = shares[np.isfinite(shares)]
    return float(shares.mean()) if len(shares) else unknown


@njit(cache=True, nogil=True)
def violation_shares(
    clouds: Clouds, keys: NDArray, poses: Array, pairs: NDArray, wall: float, through: float
) -> Array:
    """Per pair: of i's points that agree with j or violate its free space, the share that violates it; NaN
    when fewer than 20."""
    points, starts, table = clouds.points, clouds.starts, clouds.table
    out = np.full(len(pairs), np.nan)
    for k in range(len(pairs)):
        a, b = pairs[k, 0], pairs[k, 1]
        lidar = clouds.sensor[keys[b]]
        n_bins, ox, oy = clouds.bins[lidar], clouds.origin[lidar, 0], clouds.origin[lidar, 1]
        scale = n_bins / (2.0 * math.pi)
        tx, ty, dyaw = relative_pose(poses, b, a)
        c, s = math.cos(dyaw), math.sin(dyaw)
        agreeing, violating = 0, 0
        for r in range(starts[keys[a]], starts[keys[a] + 1]):
            x = tx + c * points[r, 0] - s * points[r, 1]
            y = ty + s * points[r, 0] + c * points[r, 1]
            ex, ey = x - ox, y - oy
            distance = math.sqrt(ex * ex + ey * ey)
            bin_ = int((bearing(ey, ex) + math.pi) * scale)
            half = min(6, int(wall / max(distance, wall) * scale) + 1)
            shortest2, seen = math.inf, 0
            for step in range(1, 2 * half + 2):  # outwards
                q = bin_ + (step // 2 if step % 2 else -(step // 2))
                row = table[keys[b], q % n_bins]
                if row < 0:
                    continue
                dx, dy = points[row, 0] - x, points[row, 1] - y
                if dx * dx + dy * dy < wall * wall:
                    agreeing += 1
                    break
                dx, dy = points[row, 0] - ox, points[row, 1] - oy
                shortest2 = min(shortest2, dx * dx + dy * dy)
                seen += 1
            else:
                violating += seen >= 3 and shortest2 > (distance + through) ** 2
        if agreeing + violating >= 20:
            out[k] = violating / (agreeing + violating)
    return out
