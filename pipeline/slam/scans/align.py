"""Point-to-line ICP of a scan with a set of key scans: the kernel of front end, loops and refinement."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from turtlebag.datasets.kernels import njit
from turtlebag.datasets.point_to_line import add_equation
from turtlebag.datasets.se2 import SE2, Array, between
from turtlebag.pipeline.slam.scans.clouds import Clouds
from turtlebag.pipeline.slam.scans.correspondences import Limits, equation, find_line, sees, tolerance

# Number of key scans that a scan is aligned with.
NEIGHBOURS = 8
# A smaller overlap with other scans is not a match; if this share of what could be seen again fits, the match
# is certain (at wrong places of 26 drives with gaps at most 0.88).
LEAST_OVERLAP, SURELY_THERE = 0.3, 0.92
# Information along a direction below this many times what errors of the normals fake on average does not
# count (see `observable`).
FAKED = 1.5
# Variance of a surface's direction with the viewpoint, in addition to its noise [rad^2]: walls are not
# planes, and lines bend round their ends.
SURFACE_VAR = 0.05**2
# Partners are looked up again only after the scan has moved this far [m], [rad]: until then a point slides
# along its partner's line, which does not change its distance from the line.
SAME_PARTNERS = 0.005
# An alignment ends when a step is smaller [m, rad].
SETTLED = 2e-4
# Weight of the prior relative to the scan; where the scan observes nothing, any weight will do. With full
# weight, the odometry's systematic turn leaks into every step (Intel: 20 degrees a lap).
PRIOR_SHARE = 0.01
# Width of the Cauchy kernel on the odometry, in standard deviations.
CAUCHY = 2.0
# The errors of one scan's points are correlated: a match is worth far less than the sum of its points.
STEP_COVARIANCE_SCALE = 5.0


class Prior(NamedTuple):
    """A pose (3,) and its information (3, 3) in its own frame; `cauchy` > 0 makes it heavy-tailed (width in
    standard deviations)."""

    pose: Array
    information: Array
    cauchy: float = 0.0

    @staticmethod
    def of_odometry(pose: Array, information: Array) -> Prior:
        """A prior that gives way where the scan contradicts it."""
        return Prior(pose, information, CAUCHY)

    def cost(self, pose: Array) -> float:
        """The cost of another pose (3,) under the Cauchy kernel."""
        e = between(self.pose, pose)
        return float(np.log1p(e @ self.information @ e / self.cauchy**2))


NO_PRIOR = Prior(np.zeros(3), np.zeros((3, 3)))


@dataclass(frozen=True, eq=False)
class Alignment:
    """Outcome of one alignment.

    `information` is (3, 3) in the base frame at `T_map_base` (x, y, yaw), from the points alone, with
    directions the scan cannot see taken out; `overlap` is the fraction of the scan's points that found
    a partner within the gate, `rmse` their distance to the lines [m], `known` the fraction that lies where
    the key scans looked, and `cost` their mean robust cost: 0 on a line, 1 without a partner.
    """

    T_map_base: SE2
    information: Array
    overlap: float
    rmse: float
    cost: float
    known: float = 1.0

    @property
    def agreement(self) -> float:
        """The fraction with a partner among the points that could have one."""
        return self.overlap / self.known if self.known > 0.0 else 0.0

    @property
    def possible(self) -> bool:
        """Whether it is a match at all."""
        return bool(possible(self.overlap))

    @property
    def certain(self) -> bool:
        """Whether there is no doubt about it, even where it was not expected."""
        return self.agreement >= SURELY_THERE


def possible(overlap: Array | float) -> NDArray[np.bool_]:
    """Whether alignments (...,) with such an overlap are matches at all."""
    return np.asarray(overlap) >= LEAST_OVERLAP


def match_information(information: Array) -> Array:
    """Information (..., 3, 3) of scans by their points as that of matches: the points err together, and a
    match is worth far less than their sum."""
    return information / STEP_COVARIANCE_SCALE


def align(
    clouds: Clouds,
    scan: int,
    T_map_base: Array,
    keys: NDArray[np.int64],
    T_map_keys: Array,
    limits: Limits,
    prior: Prior = NO_PRIOR,
) -> Alignment:
    """Align `scan`, started at `T_map_base` (3,), with key scans at `T_map_keys` (k, 3).

    The robust kernel on point-to-line distances is that of Geman and McClure.
    """
    xyt, seen, matched, usable, unknown, rms, cost = align_kernel(
        clouds,
        scan,
        np.asarray(T_map_base, dtype=np.float64),
        np.asarray(keys, dtype=np.int64),
        np.ascontiguousarray(T_map_keys, dtype=np.float64),
        limits,
        prior,
    )
    known = usable - unknown
    overlap = matched / usable if usable else 0.0
    return Alignment(SE2(xyt), seen, overlap, rms, cost / known if known else 1.0, known / max(usable, 1))


@njit(cache=True, nogil=True)
def align_kernel(
    clouds: Clouds,
    scan: int,
    start_pose: Array,
    keys: NDArray,
    key_poses: Array,
    limits: Limits,
    prior: Prior,
) -> tuple[Array, Array, int, int, int, float, float]:
    """`align` on plain arrays: pose (3,), information (3, 3), numbers of points matched, usable, and in space
    that no key scan saw; rms [m], summed cost of all others."""
    pose, T_keys_scan = start_pose.copy(), np.empty((len(keys), 4))
    first, end = clouds.starts[scan], clouds.starts[scan + 1]
    rows = first, end, 1 + (end - first - 1) // limits.most_points
    partners = np.empty(((end - first - 1) // rows[2] + 1, len(keys)), dtype=np.int32)
    hessian, gradient = np.empty((3, 3)), np.empty(3)
    moved = 2.0 * SAME_PARTNERS
    for iteration in range(limits.iterations + 1):
        see_from_keys(pose, key_poses, T_keys_scan)
        if moved > SAME_PARTNERS:
            find_lines(clouds, rows, keys, T_keys_scan, limits, partners)
            moved = 0.0
        sums = add_equations(clouds, rows, partners, T_keys_scan, limits, hessian, gradient)
        if iteration == limits.iterations:
            break
        step = gauss_newton_step(hessian, sums.faked, gradient, pose, prior)
        size = move_by(pose, step)
        moved += size
        if size < SETTLED:
            break
    unknown = count_unseen(clouds, rows, partners, keys, T_keys_scan, limits.gate)
    pose[2] = wrap_angle(pose[2])
    seen = observable(hessian, sums.faked)
    return pose, seen, sums.matched, sums.usable, unknown, sums.rms, sums.cost - unknown


@njit(cache=True, forceinline=True, _nrt=False)
def see_from_keys(pose: Array, key_poses: Array, T_keys_scan: Array) -> None:
    """The scan's pose (3,) seen from the key scans: x, y, cosine and sine of the yaw, (k, 4)."""
    for k in range(len(key_poses)):
        c, s = math.cos(key_poses[k, 2]), math.sin(key_poses[k, 2])
        dx, dy = pose[0] - key_poses[k, 0], pose[1] - key_poses[k, 1]
        dyaw = pose[2] - key_poses[k, 2]
        T_keys_scan[k, 0], T_keys_scan[k, 1] = c * dx + s * dy, -s * dx + c * dy
        T_keys_scan[k, 2], T_keys_scan[k, 3] = math.cos(dyaw), math.sin(dyaw)


@njit(cache=True, forceinline=True, _nrt=False)
def find_lines(
    clouds: Clouds,
    rows: tuple[int, int, int],
    keys: NDArray,
    T_keys_scan: Array,
    limits: Limits,
    partners: NDArray,
) -> None:
    """Row of the line of each key scan that each point of the scan may lie on, or -1, (points, k)."""
    for i in range(rows[0], rows[1], rows[2]):
        if clouds.line_ok[i]:
            _, reach = tolerance(clouds, i, limits)
            for k in range(len(keys)):
                T = (T_keys_scan[k, 0], T_keys_scan[k, 1], T_keys_scan[k, 2], T_keys_scan[k, 3])
                partners[(i - rows[0]) // rows[2], k] = find_line(clouds, i, keys[k], T, reach)


class Sums(NamedTuple):
    """Of the points of a scan: how many found a line, how many could have; the rms of their distances [m],
    their summed cost, and the information that errors of the normals fake (see `observable`)."""

    matched: int
    usable: int
    rms: float
    cost: float
    faked: float


@njit(cache=True, forceinline=True, _nrt=False)
def add_equations(
    clouds: Clouds,
    rows: tuple[int, int, int],
    partners: NDArray,
    T_keys_scan: Array,
    limits: Limits,
    hessian: Array,
    gradient: Array,
) -> Sums:
    """The normal equations of all points and their partners, each key scan weighing as much as the others."""
    hessian[:], gradient[:] = 0.0, 0.0
    n_keys, matched, usable = len(T_keys_scan), 0, 0
    squares, weights, cost, faked = 0.0, 0.0, 0.0, 0.0
    for i in range(rows[0], rows[1], rows[2]):
        if not clouds.line_ok[i]:
            continue
        usable += 1
        inv_s2, reach = tolerance(clouds, i, limits)
        best_e = math.inf
        for k in range(n_keys):
            row = partners[(i - rows[0]) // rows[2], k]
            T = (T_keys_scan[k, 0], T_keys_scan[k, 1], T_keys_scan[k, 2], T_keys_scan[k, 3])
            e, w, j = equation(clouds, i, row, T, inv_s2, reach)
            if w == 0.0:
                continue
            best_e = min(best_e, abs(e))
            w = w / n_keys
            faked += w * direction_var(clouds, row)
            add_equation(hessian, gradient, w, j, e)
            squares += w * e * e
            weights += w
        if best_e < math.inf:
            matched += 1
            q = best_e * best_e * inv_s2
            cost += q / (1.0 + q)
        else:
            cost += 1.0
    hessian[1, 0], hessian[2, 0], hessian[2, 1] = hessian[0, 1], hessian[0, 2], hessian[1, 2]
    return Sums(matched, usable, math.sqrt(squares / weights) if weights > 0.0 else 0.0, cost, faked)


@njit(cache=True, forceinline=True, _nrt=False)
def count_unseen(
    clouds: Clouds,
    rows: tuple[int, int, int],
    partners: NDArray,
    keys: NDArray,
    T_keys_scan: Array,
    margin: float,
) -> int:
    """How many points without any partner lie in space that no key scan had in view."""
    unknown = 0
    for i in range(rows[0], rows[1], rows[2]):
        if not clouds.line_ok[i]:
            continue
        unseen, px, py = True, clouds.points[i, 0], clouds.points[i, 1]
        for k in range(len(keys)):
            unseen = unseen and partners[(i - rows[0]) // rows[2], k] < 0
        for k in range(len(keys)):
            c, s = T_keys_scan[k, 2], T_keys_scan[k, 3]
            x = T_keys_scan[k, 0] + c * px - s * py
            y = T_keys_scan[k, 1] + s * px + c * py
            unseen = unseen and not sees(x, y, keys[k], clouds, margin)
        unknown += unseen
    return unknown


@njit(cache=True, forceinline=True, _nrt=False)
def move_by(pose: Array, step: Array) -> float:
    """Move a pose (3,) by a step (3,) in its own frame; the size of the step."""
    c, s = math.cos(pose[2]), math.sin(pose[2])
    pose[0] += c * step[0] - s * step[1]
    pose[1] += s * step[0] + c * step[1]
    pose[2] += step[2]
    return abs(step[0]) + abs(step[1]) + abs(step[2])


@njit(cache=True, forceinline=True, _nrt=False)
def direction_var(clouds: Clouds, row: int) -> float:
    """Variance of the normal of a line and of the surface's own direction [rad^2] (see `observable`)."""
    return clouds.normal_var[row] + SURFACE_VAR


@njit(cache=True)
def gauss_newton_step(hessian: Array, faked: float, gradient: Array, pose: Array, prior: Prior) -> Array:
    """Gauss-Newton step in the base frame; unobservable directions are left to the prior."""
    a = observable(hessian, faked)
    answer = safe_solve(hessian, gradient)
    b = -(a @ answer)
    if prior.information[0, 0] > 0.0:
        # error of the pose seen from the prior, turned into the base frame
        c, s = math.cos(pose[2]), math.sin(pose[2])
        dx, dy = pose[0] - prior.pose[0], pose[1] - prior.pose[1]
        e = np.array([c * dx + s * dy, -s * dx + c * dy, wrap_angle(pose[2] - prior.pose[2])])
        w = 1.0
        if prior.cauchy > 0.0:
            apart = contradiction(e - answer, prior.information, a)
            w = 1.0 / (1.0 + apart / (prior.cauchy * prior.cauchy))
        # the scan decides what it observes, the odometry all other directions
        w *= PRIOR_SHARE
        a = a + w * prior.information
        b = b - w * (prior.information @ e)
    return safe_solve(a, b)


@njit(cache=True)
def contradiction(apart: Array, information: Array, seen: Array) -> float:
    """Squared Mahalanobis distance between a scan and a prior, with the uncertainty of both.

    `apart` (3,) is the scan's own answer relative to the prior's, `information` (3, 3) that of the prior,
    `seen` that of the scan's points. A scan contradicts nothing in directions that it hardly observes.
    """
    sure = seen / STEP_COVARIANCE_SCALE
    return float(apart @ (information @ safe_solve(information + sure, sure @ apart)))


@njit(cache=True)
def wrap_angle(angle: float) -> float:
    """An angle in [-pi, pi)."""
    return (angle + math.pi) % (2.0 * math.pi) - math.pi


@njit(cache=True)
def safe_solve(a: Array, b: Array) -> Array:
    """Solution of `a` (3, 3) x = `b` (3,), damped by a little, so that there always is one."""
    damped = a.copy()
    scale = 1e-9 + 1e-6 * (a[0, 0] + a[1, 1])
    damped[0, 0] += scale
    damped[1, 1] += scale
    damped[2, 2] += 1e-9 + 1e-6 * a[2, 2] + scale * 1e-3
    return np.linalg.solve(damped, b)  # type: ignore[return-value]


@njit(cache=True)
def observable(hessian: Array, faked: float) -> Array:
    """The information that is not an artefact of noisy normals: (3) in docs/how-it-maps.md.

    In a featureless corridor all true normals point across it; the fitted ones scatter, which alone yields
    information along the corridor: `faked`, the sum over the points of weight times variance of the normal's
    direction. The weaker direction of the translation, with yaw eliminated, keeps only what exceeds FAKED
    times that. Nothing else is removed: in a round corridor neither the turn nor the distance is observed,
    but their combination is.
    """
    out = hessian.copy()
    a, b, d = hessian[0, 0], hessian[0, 1], hessian[1, 1]
    if hessian[2, 2] <= 0.0:
        return out
    # Schur complement on the translation
    a -= hessian[0, 2] * hessian[0, 2] / hessian[2, 2]
    b -= hessian[0, 2] * hessian[1, 2] / hessian[2, 2]
    d -= hessian[1, 2] * hessian[1, 2] / hessian[2, 2]
    half = 0.5 * (a - d)
    root = math.sqrt(half * half + b * b)
    taken = min(FAKED * faked, max(0.5 * (a + d) - root, 0.0))
    angle = 0.5 * math.atan2(2.0 * b, a - d) + 0.5 * math.pi
    ux, uy = math.cos(angle), math.sin(angle)
    out[0, 0] -= taken * ux * ux
    out[1, 1] -= taken * uy * uy
    out[0, 1] -= taken * ux * uy
    out[1, 0] = out[0, 1]
    return out
