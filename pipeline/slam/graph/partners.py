"""Which key scans are compared with which: partners of the refinement, candidates of loops, revisits.

A key scan has partners among all visits to its place, until there are many. Then only the first visits are
compared with each other, and later ones with the first key scan of each place alone: were every visit tied to
any other, a solver would have to keep all of them in mind at once, and its time grow with their cube.
"""

from __future__ import annotations

import math
from collections.abc import Iterator

import numpy as np
import scipy
from numpy.typing import NDArray

from turtlebag.datasets.se2 import SE2, Array
from turtlebag.pipeline.slam.scans.align import NEIGHBOURS
from turtlebag.pipeline.slam.scans.clouds import Clouds

# Key scans farther apart than this [m], or than the usual range if that is longer, see too little of the same
# to be partners; this many on either side of one in time see the same as it does, and proportionally more if
# the lidar sees farther.
RADIUS_M, ALIKE = 4.0, 2
# Near means in place and in heading: keys turned by 1 rad are as far as those this far away [m].
TURN_M = 0.5
# A place is so large [m], [rad]; it is crowded with so many key scans. The most in eleven public logs and
# drives are 8, after 13,600 scans of Intel's.
PLACE_M, PLACE_RAD, CROWD = 0.5, 0.25 * math.pi, 16


def earlier_in_place(poses: Array) -> NDArray[np.int64]:
    """How many earlier key scans lie in the place of each, by their poses (n, 3), (n,)."""
    cells = np.floor(poses / [PLACE_M, PLACE_M, PLACE_RAD])
    place = np.unique(cells, axis=0, return_inverse=True)[1].ravel()
    in_order = np.argsort(place, kind="stable")
    earlier = np.empty(len(poses), dtype=np.int64)
    earlier[in_order] = np.arange(len(poses)) - np.searchsorted(place, place, sorter=in_order)[in_order]
    return earlier


def compared(earlier: NDArray[np.int64]) -> Iterator[tuple[NDArray[np.int64], NDArray[np.int64]]]:
    """Key scans (k,), and those that they are compared with (m,), by how many are `earlier_in_place`: the
    first ones of each place with each other, then the later ones with the very first."""
    few = np.flatnonzero(earlier < CROWD)
    yield few, few
    if len(few) < len(earlier):
        yield np.flatnonzero(earlier >= CROWD), np.flatnonzero(earlier == 0)


def compared_with(earlier: NDArray[np.int64], i: int) -> NDArray[np.bool_]:
    """Whether key i is compared with each key before it, (i,)."""
    return earlier[:i] < (CROWD if earlier[i] < CROWD else 1)


def partner_radius(clouds: Clouds) -> float:
    """The distance [m] up to which key scans are partners: the median of their ranges, or RADIUS_M."""
    ranges = np.linalg.norm(clouds.points - clouds.origins(), axis=1)
    return max(RADIUS_M, float(np.median(ranges))) if len(ranges) else RADIUS_M


def alike_within(radius: float) -> int:
    """The keys before and after one that see the same as it, where partners are up to `radius` [m] apart."""
    return round(ALIKE * radius / RADIUS_M)


def overlapping_pairs(
    T_map_keys: SE2, radius: float = RADIUS_M, neighbours: int = NEIGHBOURS, alike: int = ALIKE
) -> NDArray[np.int64]:
    """Pairs (n, 2), i < j, of nearby keys: each key with its two successors in time and its nearest ones.
    These are spread over all visits to the place: once a key is taken, those up to `alike` before and after
    it are left out, as the same view adds nothing."""
    beside = TURN_M * np.column_stack([np.cos(T_map_keys.yaw), np.sin(T_map_keys.yaw)])
    at, key = np.column_stack([T_map_keys.xy, beside]), np.arange(len(T_map_keys))
    found = [np.column_stack([key[:-after], key[after:]]) for after in (1, 2)]
    for some, others in compared(earlier_in_place(T_map_keys.xyt)):
        near = scipy.spatial.cKDTree(at[others])
        # nobody has a later one for a partner, so that it has as many with half of its own
        most = neighbours if some is others else neighbours // 2
        nearest = near.query(at[some], 1 + most * (2 * alike + 1), distance_upper_bound=radius)[1]
        found.append(_spread(some, np.append(others, -1)[nearest], most, alike))
    return np.unique(np.sort(np.concatenate(found), axis=1), axis=0)


def _spread(
    keys: NDArray[np.int64], nearest: NDArray[np.int64], neighbours: int, alike: int
) -> NDArray[np.int64]:
    """Pairs (m, 2) of each of `keys` (k,) with the first of its `nearest` (k, most) that are not alike; -1
    where there is none."""
    taken, count = np.full((len(keys), neighbours), -alike - 1), np.zeros(len(keys), dtype=np.int64)
    for one in nearest.T:  # the nearest of each key first
        fresh = (one >= 0) & (one != keys) & (count < neighbours)
        fresh &= (np.abs(one[:, None] - taken) > alike).all(axis=1)
        taken[fresh, count[fresh]] = one[fresh]
        count += fresh
    i, k = np.nonzero(taken >= 0)
    return np.column_stack([keys[i], taken[i, k]])
