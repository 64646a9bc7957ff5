"""Point-to-line ICP of a scan with a set of key scans: the kernel of front end, loops and refinement."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from turtlebag.datasets.kernels import njit
from turtlebag.datasets.se2 import SE2, Array
from turtlebag.pipeline.slam.scans.clouds import Clouds
from turtlebag.pipeline.slam.scans.correspondences import MIN_NORMAL_DOT, Limits, find_partner, sees
from turtlebag.pipeline.slam.scans.range_noise import SIGMAS

# Scans with more points than this are thinned to every second, third, ... point.
MOST_POINTS = 400
# Number of key scans that a scan is aligned with.
NEIGHBOURS = 8
# A smaller overlap with other scans is not a match.
LEAST_OVERLAP = 0.3
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
    points, normals, centers, line_ok = clouds.points, clouds.normals, clouds.centers, clouds.line_ok
    pose = start_pose.copy()
    lo, hi = clouds.starts[scan], clouds.starts[scan + 1]
    stride = 1 + (hi - lo - 1) // limits.most_points
    n_keys = len(keys)
    hessian, gradient = np.zeros((3, 3)), np.zeros(3)
    matched, usable, rms, cost = 0, 0, 0.0, 0.0
    relative = np.zeros((n_keys, 4))
    partners = np.empty(((hi - lo - 1) // stride + 1, n_keys), dtype=np.int32)
    moved = 2.0 * SAME_PARTNERS
    faked = 0.0
    for iteration in range(limits.iterations + 1):
        for k in range(n_keys):
            ck, sk = math.cos(key_poses[k, 2]), math.sin(key_poses[k, 2])
            dx, dy = pose[0] - key_poses[k, 0], pose[1] - key_poses[k, 1]
            relative[k, 0], relative[k, 1] = ck * dx + sk * dy, -sk * dx + ck * dy
            dyaw = pose[2] - key_poses[k, 2]
            relative[k, 2], relative[k, 3] = math.cos(dyaw), math.sin(dyaw)
        hessian[:] = 0.0
        faked = 0.0
        gradient[:] = 0.0
        matched, usable = 0, 0
        squares, weights, cost = 0.0, 0.0, 0.0
        search = moved > SAME_PARTNERS
        if search:
            moved = 0.0
        for i in range(lo, hi, stride):
            if not line_ok[i]:
                continue
            usable += 1
            of_point = partners[(i - lo) // stride]
            px, py = points[i, 0], points[i, 1]
            kernel2 = max(limits.sigma * limits.sigma, SIGMAS * SIGMAS * clouds.point_var[i])
            inv_s2 = 1.0 / kernel2
            reach = max(limits.gate, math.sqrt(kernel2))
            hit = False
            best_e = math.inf
            for k in range(n_keys):
                c, s = relative[k, 2], relative[k, 3]
                x = relative[k, 0] + c * px - s * py
                y = relative[k, 1] + s * px + c * py
                if search:
                    row = find_partner(x, y, keys[k], clouds, reach)
                    of_point[k] = row if row >= 0 and line_ok[row] else -1
                row = of_point[k]
                if row < 0:
                    continue
                nx, ny = normals[row, 0], normals[row, 1]
                # the partner's normal turned into this scan's base frame
                bx, by = c * nx + s * ny, -s * nx + c * ny
                if bx * normals[i, 0] + by * normals[i, 1] < MIN_NORMAL_DOT:
                    continue
                e = nx * (x - centers[row, 0]) + ny * (y - centers[row, 1])
                if abs(e) > reach:
                    continue
                hit = True
                best_e = min(best_e, abs(e))
                w = 1.0 / (1.0 + e * e * inv_s2)
                w = w * w * inv_s2 / n_keys
                faked += w * (clouds.normal_var[row] + SURFACE_VAR)
                add_equation(hessian, gradient, w, bx, by, by * px - bx * py, e)
                squares += w * e * e
                weights += w
            if hit:
                matched += 1
                q = best_e * best_e * inv_s2
                cost += q / (1.0 + q)
            else:
                cost += 1.0
        hessian[1, 0], hessian[2, 0], hessian[2, 1] = hessian[0, 1], hessian[0, 2], hessian[1, 2]
        rms = math.sqrt(squares / weights) if weights > 0.0 else 0.0
        if iteration == limits.iterations:
            break
        step = gauss_newton_step(hessian, faked, gradient, pose, prior)
        c, s = math.cos(pose[2]), math.sin(pose[2])
        pose[0] += c * step[0] - s * step[1]
        pose[1] += s * step[0] + c * step[1]
        pose[2] += step[2]
        size = abs(step[0]) + abs(step[1]) + abs(step[2])
        moved += size
        if size < SETTLED:
            break
    unknown = 0
    for i in range(lo, hi, stride):
        if line_ok[i] and partners[(i - lo) // stride].max() < 0:
            unseen = True
            for k in range(n_keys):
                c, s = relative[k, 2], relative[k, 3]
                x = relative[k, 0] + c * points[i, 0] - s * points[i, 1]
                y = relative[k, 1] + s * points[i, 0] + c * points[i, 1]
                unseen = unseen and not sees(x, y, keys[k], clouds, limits.gate)
            unknown += unseen
    pose[2] = (pose[2] + math.pi) % (2.0 * math.pi) - math.pi
    return pose, observable(hessian, faked), matched, usable, unknown, rms, cost - unknown


@njit(cache=True, forceinline=True)
def add_equation(h: Array, g: Array, w: float, j0: float, j1: float, j2: float, e: float) -> None:
    """Add an equation j x = -e of some weight to the upper half of the normal equations h x = -g."""
    h[0, 0] += w * j0 * j0
    h[0, 1] += w * j0 * j1
    h[0, 2] += w * j0 * j2
    h[1, 1] += w * j1 * j1
    h[1, 2] += w * j1 * j2
    h[2, 2] += w * j2 * j2
    g[0] += w * j0 * e
    g[1] += w * j1 * e
    g[2] += w * j2 * e


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
    """The information that is not an artefact of noisy normals.

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
