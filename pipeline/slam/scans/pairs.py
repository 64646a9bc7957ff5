"""Pairs of key scans that see the same surfaces, linearised into relative poses with their information."""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from turtlebag.datasets.kernels import njit
from turtlebag.datasets.point_to_line import add_equation, of_the_line
from turtlebag.datasets.se2 import SE2, Array
from turtlebag.datasets.threads import in_parts
from turtlebag.pipeline.slam.scans.align import direction_var, observable, possible, safe_solve
from turtlebag.pipeline.slam.scans.clouds import Clouds
from turtlebag.pipeline.slam.scans.correspondences import Limits, partner_line, relative_pose
from turtlebag.pipeline.slam.scans.open3d_icp import match_points


class PairMatches(NamedTuple):
    """Per pair (i, j): T_i_j (n, 3), its information by the points (n, 3, 3), overlap 0..1 (n,)."""

    T_i_j: Array
    information: Array
    overlap: Array

    @property
    def possible(self) -> NDArray[np.bool_]:
        """Which pairs match at all."""
        return possible(self.overlap)


def match_pairs(
    clouds: Clouds,
    keys: NDArray[np.int64],
    T_map_keys: SE2,
    pairs: NDArray[np.int64],
    limits: Limits,
) -> PairMatches:
    """As `linearise_pairs`; two scans without surfaces are matched point on point, by Open3D's ICP."""
    found = in_parts(
        lambda part: linearise_pairs(clouds, keys, T_map_keys.xyt, pairs[part], limits),
        len(pairs),
    )
    relative, information, overlap = (np.concatenate([part[k] for part in found]) for k in range(3))
    bare = np.array([clouds.placed_by(int(key)) == "points" for key in keys])
    both = np.flatnonzero(bare[pairs[:, 0]] & bare[pairs[:, 1]])
    if len(both) > 0:
        start = (T_map_keys[pairs[:, 0]].inverse() @ T_map_keys[pairs[:, 1]]).xyt
        for k in both:
            i, j = pairs[k]
            match = match_points(clouds.of(keys[j]), clouds.of(keys[i]), start[k], limits.gate)
            relative[k], information[k] = match.T_target_source, match.information
            overlap[k] = match.overlap
    return PairMatches(relative, information, overlap)


@njit(cache=True, nogil=True)
def linearise_pairs(
    clouds: Clouds, keys: NDArray, poses: Array, pairs: NDArray, limits: Limits
) -> tuple[Array, Array, Array]:
    """Per pair (i, j): best T_i_j to first order (3,), its information (3, 3), overlap 0..1.

    Points of j are matched with lines of i and points of i with lines of j.
    """
    n = len(pairs)
    relative = np.empty((n, 3))
    information = np.zeros((n, 3, 3))
    overlap = np.zeros(n)
    for k in range(n):
        a, b = pairs[k, 0], pairs[k, 1]
        tx, ty, dyaw = relative_pose(poses, a, b)
        c, s = math.cos(dyaw), math.sin(dyaw)
        h, g = np.zeros((3, 3)), np.zeros(3)
        used_b, hit_b, faked_b = _half(clouds, keys[b], keys[a], (tx, ty, c, s), limits, False, (h, g))
        ix, iy = -c * tx - s * ty, s * tx - c * ty
        used_a, hit_a, faked_a = _half(clouds, keys[a], keys[b], (ix, iy, c, -s), limits, True, (h, g))
        overlap[k] = max(hit_a / max(used_a, 1), hit_b / max(used_b, 1))
        seen = observable(h, faked_a + faked_b)
        step = -safe_solve(h, g)
        relative[k, 0] = tx + c * step[0] - s * step[1]
        relative[k, 1] = ty + s * step[0] + c * step[1]
        relative[k, 2] = (dyaw + step[2] + math.pi) % (2.0 * math.pi) - math.pi
        information[k] = seen
    return relative, information, overlap


@njit(cache=True, forceinline=True)
def _half(
    clouds: Clouds,
    scan: int,
    key: int,
    T_key_scan: tuple[float, float, float, float],
    limits: Limits,
    inverted: bool,
    equations: tuple[Array, Array],
) -> tuple[int, int, float]:
    """Add the normal equations of `scan`'s points against `key`'s lines, T_key_scan as in `linearise`.

    Returned are the points with a line, those with a partner, and the information that errors of the
    normals fake (see `observable`). The unknown is a right perturbation of T_i_j; `inverted` says that
    `scan` is i and `key` j.
    """
    (h, g), used, hit, faked = equations, 0, 0, 0.0
    for r in range(clouds.starts[scan], clouds.starts[scan + 1]):
        if not clouds.line_ok[r]:
            continue
        used += 1
        row, e, w, j = partner_line(clouds, r, key, T_key_scan, limits)
        if row < 0:
            continue
        hit += 1
        if inverted:
            point, normal = clouds.points[r], clouds.normals[row]
            j = of_the_line(T_key_scan, (point[0], point[1]), (normal[0], normal[1]))
        faked += w * direction_var(clouds, row)
        add_equation(h, g, w, j, e)
    h[1, 0], h[2, 0], h[2, 1] = h[0, 1], h[0, 2], h[1, 2]
    return used, hit, faked
