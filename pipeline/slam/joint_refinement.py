"""Joint refinement: every key scan aligned with every key scan it overlaps, all poses at once.

Lu and Milios (1997), with point-to-line distances: each overlapping pair is linearised at the current
poses into a relative pose with its full information matrix, the pose graph is solved, and the pairs
are linearised again, the gate shrinking, until nothing moves.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence

import numpy as np
import scipy
from numpy.typing import NDArray
from pydantic import Field

from turtlebag.datasets.kernels import njit
from turtlebag.datasets.se2 import SE2, Array
from turtlebag.datasets.settings import Settings
from turtlebag.pipeline.slam.back_end import BackEnd
from turtlebag.pipeline.slam.clouds import Clouds
from turtlebag.pipeline.slam.correspondences import FINE, ROUGH, Limits, partner_line, relative_pose
from turtlebag.pipeline.slam.factors import Constraint
from turtlebag.pipeline.slam.loop_edits import NO_EDITS, KeyEdits
from turtlebag.pipeline.slam.open3d_icp import match_points
from turtlebag.pipeline.slam.point_to_line_icp import (
    CAUCHY,
    LEAST_OVERLAP,
    NEIGHBOURS,
    STEP_COVARIANCE_SCALE,
    SURFACE_VAR,
    add_equation,
    observable,
    safe_solve,
)
from turtlebag.pipeline.slam.pose_graph import GTSAM, Poses, optimise
from turtlebag.pipeline.slam.threads import in_parts

# Key scans farther apart than this [m], or than the usual range if that is longer, see too little of the same
# to be partners; this many on either side of one in time see the same as it does, and proportionally more if
# the lidar sees farther.
RADIUS_M, ALIKE = 4.0, 2


class RefineConfig(Settings):
    """The joint refinement."""

    rounds: int = Field(default=5, ge=0, le=100, description="linearise-and-solve rounds; 0: no refinement")


def refine(
    clouds: Clouds,
    keys: NDArray[np.int64],
    T_map_keys: SE2,
    steps: Sequence[Constraint],
    config: RefineConfig,
    edits: KeyEdits = NO_EDITS,
    back_end: BackEnd = GTSAM,
) -> tuple[SE2, list[Constraint]]:
    """Refined poses of the key scans and the pair constraints of the last round.

    `steps` are the odometry constraints between successive keys, kept in the graph throughout. Pairs that a
    person rejected are left out.
    """
    radius = partner_radius(clouds)
    alike = round(ALIKE * radius / RADIUS_M)

    def matched(poses: SE2, f: float) -> list[Constraint]:
        gate = ROUGH.gate * (FINE.gate / ROUGH.gate) ** f
        sigma = ROUGH.sigma * (FINE.sigma / ROUGH.sigma) ** f
        pairs = overlapping_pairs(poses, radius, NEIGHBOURS, alike)
        pairs = pairs[~edits.rejects(pairs[:, 0], pairs[:, 1])]
        return pair_constraints(clouds, keys, poses, pairs, Limits(gate, sigma))

    return in_rounds(T_map_keys, steps, config.rounds, matched, back_end.optimise)


def in_rounds(
    T_map_keys: Poses,
    steps: Sequence[Constraint],
    rounds: int,
    matched: Callable[[Poses, float], list[Constraint]],
    solve: Callable[[Poses, Sequence[Constraint], int], Poses] = optimise,
) -> tuple[Poses, list[Constraint]]:
    """Match pairs at the current poses and solve the graph, again and again. `matched` gives the constraints
    of a round, from its progress: 0 (the first) to 1 (the last)."""
    poses: Poses = T_map_keys
    constraints = list(steps)
    for round_ in range(rounds):
        f: float = round_ / max(rounds - 1, 1)
        constraints = [*steps, *matched(poses, f)]
        poses = solve(poses, constraints, 5)
    return poses, constraints


def partner_radius(clouds: Clouds) -> float:
    """The distance [m] up to which key scans are partners: the median of their ranges, or RADIUS_M."""
    ranges = np.linalg.norm(clouds.points - clouds.origin, axis=1)
    return max(RADIUS_M, float(np.median(ranges))) if len(ranges) else RADIUS_M


def overlapping_pairs(
    T_map_keys: SE2, radius: float, neighbours: int, alike: int = ALIKE
) -> NDArray[np.int64]:
    """Pairs (n, 2), i < j, of nearby keys: each key with its two successors in time and its nearest ones.
    These are spread over all visits to the place: once a key is taken, those up to `alike` before and after
    it are left out."""
    n = len(T_map_keys)
    tree = scipy.spatial.cKDTree(T_map_keys.xy)
    found: set[tuple[int, int]] = {(k, k + 1) for k in range(n - 1)} | {(k, k + 2) for k in range(n - 2)}
    for i, near in enumerate(tree.query_ball_point(T_map_keys.xy, radius)):
        others = np.array([k for k in near if k != i], dtype=np.int64)
        if len(others) == 0:
            continue
        distance = np.linalg.norm(T_map_keys.xy[others] - T_map_keys.xy[i], axis=1)
        turn = np.abs((T_map_keys.yaw[others] - T_map_keys.yaw[i] + np.pi) % (2 * np.pi) - np.pi)
        order = np.argsort(distance + 0.5 * turn, kind="stable")
        taken: list[int] = []
        beside: set[int] = set()
        for k in others[order].tolist():
            # the same view adds nothing
            if k not in beside:
                taken.append(k)
                beside.update(range(k - alike, k + alike + 1))
                if len(taken) == neighbours:
                    break
        found |= {(min(i, k), max(i, k)) for k in taken}
    return np.array(sorted(found), dtype=np.int64).reshape(-1, 2)


def pair_constraints(
    clouds: Clouds,
    keys: NDArray[np.int64],
    T_map_keys: SE2,
    pairs: NDArray[np.int64],
    limits: Limits,
) -> list[Constraint]:
    """One constraint for each pair that overlaps enough, linearised at the given poses."""
    relative, information, overlap = match_pairs(clouds, keys, T_map_keys, pairs, limits)
    return [
        Constraint(int(i), int(j), relative[k], information[k] / STEP_COVARIANCE_SCALE, "pair", CAUCHY)
        for k, (i, j) in enumerate(pairs)
        if overlap[k] >= LEAST_OVERLAP
    ]


def match_pairs(
    clouds: Clouds,
    keys: NDArray[np.int64],
    T_map_keys: SE2,
    pairs: NDArray[np.int64],
    limits: Limits,
) -> tuple[Array, Array, Array]:
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
    return relative, information, overlap


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
    """Add the normal equations of `scan`'s points against `key`'s lines, T_key_scan as in `partner_line`.

    Returned are the points with a line, those with a partner, and the information that errors of the
    normals fake (see `observable`). The unknown is a right perturbation of T_i_j; `inverted` says that
    `scan` is i and `key` j.
    """
    points, normals, line_ok = clouds.points, clouds.normals, clouds.line_ok
    (tx, ty, c, s), (h, g) = T_key_scan, equations
    used, hit, faked = 0, 0, 0.0
    for r in range(clouds.starts[scan], clouds.starts[scan + 1]):
        if not line_ok[r]:
            continue
        used += 1
        row, e, w = partner_line(clouds, r, key, T_key_scan, limits)
        if row < 0:
            continue
        hit += 1
        px, py = points[r, 0], points[r, 1]
        x, y = tx + c * px - s * py, ty + s * px + c * py
        nx, ny = normals[row, 0], normals[row, 1]
        bx, by = c * nx + s * ny, -s * nx + c * ny
        faked += w * (clouds.normal_var[row] + SURFACE_VAR)
        if inverted:
            add_equation(h, g, w, -nx, -ny, -(x * ny - y * nx), e)
        else:
            add_equation(h, g, w, bx, by, by * px - bx * py, e)
    h[1, 0], h[2, 0], h[2, 1] = h[0, 1], h[0, 2], h[1, 2]
    return used, hit, faked
