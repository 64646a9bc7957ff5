"""A place as surfels: one small plane in each voxel that holds a flat piece of surface, and point-to-plane
alignment against them.

The mean of a voxel's points is far more accurate than any of them, and does not depend on a scan's pattern
of rings, which biases point-to-point matching.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from turtlebag.datasets import se3
from turtlebag.datasets.deskew import deskewed_points
from turtlebag.datasets.kernels import njit
from turtlebag.datasets.se2 import Array
from turtlebag.pipeline.slam.odometry.track import BLIND

MAX_CELLS = 24_000_000
NOISE_M = 0.01
"""Least standard deviation of a surfel [m]."""
FLATNESS = 4.0
"""A surfel's variance along itself is at least this many times that across."""
MIN_POINTS = 5
SETTLED = 5e-5
"""Alignment ends when a step is smaller [rad, m]."""


class Surfels(NamedTuple):
    """Planes (m,) with means and normals (m, 3), towards where they were seen from, and variances across.

    cells (nx, ny, nz) int32 holds -1 or a number k: pairs[k] are the surfels of that voxel, -1 for none,
    two where a thin wall was seen from both sides. `low` is the outer corner of cell (0, 0, 0) [m].
    """

    cells: NDArray[np.int32]
    pairs: NDArray[np.int32]
    low: Array
    voxel: float
    means: Array
    normals: Array
    variances: Array


def make_surfels(points: Array, views: Array, voxel: float) -> Surfels:
    """Surfels of points (n, 3), each seen from its view point (n, 3).

    The voxel grows where the extent would need too much memory.
    """
    if len(points) == 0:
        points = views = np.zeros((1, 3))
    # by columns: numpy reduces rows of three one by one, twenty times as slowly
    low, high = np.array([[column.min(), column.max()] for column in points.T]).T
    while np.prod(np.floor((high - low) / voxel) + 3) > MAX_CELLS:
        voxel *= np.cbrt(2.0)  # half as many cells
    low = (np.floor(low / voxel) - 1.0) * voxel
    shape = (np.floor((high - low) / voxel) + 2).astype(np.int64)
    cells = np.full((int(shape[0]), int(shape[1]), int(shape[2])), -1, dtype=np.int32)
    ids = _numbered(points, low, voxel, cells)
    count = int(ids.max()) + 1
    # Voxels and faces of fewer points hold no surfel: their axes are not asked for.
    points_in, _, scatter = _moments(points, ids, count)
    some = points_in >= MIN_POINTS
    normals = np.zeros((count, 3))
    normals[some] = np.linalg.eigh(scatter[some])[1][:, :, 0]
    # The two faces of a wall may share a voxel: what was seen from either side makes a surfel of its own.
    x, y, z = (normals[ids] * (views - points)).T
    behind = x + y + z < 0.0
    counts, means, scatter = _moments(points, 2 * ids + behind, 2 * count)
    faces = np.flatnonzero(counts >= MIN_POINTS)
    values, vectors = np.linalg.eigh(scatter[faces] / (counts[faces] - 1)[:, None, None])
    flat = (
        (values[:, 1] > FLATNESS * values[:, 0])
        & (values[:, 1] > (0.08 * voxel) ** 2)
        & (values[:, 0] < (0.15 * voxel) ** 2)
    )
    first = normals[faces // 2] * np.where(faces % 2 == 0, 1.0, -1.0)[:, None]
    outward = vectors[:, :, 0] * np.where(np.sum(vectors[:, :, 0] * first, axis=1) < 0.0, -1.0, 1.0)[:, None]
    pairs = np.full(2 * count, -1, dtype=np.int32)
    pairs[faces[flat]] = np.arange(np.count_nonzero(flat))
    return Surfels(
        cells,
        pairs.reshape(count, 2),
        low,
        voxel,
        np.ascontiguousarray(means[faces[flat]]),
        np.ascontiguousarray(outward[flat]),
        np.maximum(values[flat, 0], 0.0) + NOISE_M**2,
    )


@njit(cache=True)
def _numbered(points: Array, low: Array, voxel: float, cells: NDArray) -> NDArray:
    """The number of each point's voxel (n,), given in order of appearance and written into `cells`."""
    ids = np.empty(points.shape[0], dtype=np.int64)
    m = 0
    for i in range(points.shape[0]):
        x = int((points[i, 0] - low[0]) / voxel)
        y = int((points[i, 1] - low[1]) / voxel)
        z = int((points[i, 2] - low[2]) / voxel)
        if cells[x, y, z] < 0:
            cells[x, y, z] = m
            m += 1
        ids[i] = cells[x, y, z]
    return ids


@njit(cache=True)
def _moments(points: Array, ids: NDArray, m: int) -> tuple[Array, Array, Array]:
    """Counts (m,), means (m, 3) and scatter matrices (m, 3, 3) of the points by their number."""
    counts, means, scatter = np.zeros(m), np.zeros((m, 3)), np.zeros((m, 3, 3))
    for i in range(points.shape[0]):
        counts[ids[i]] += 1.0
        for a in range(3):
            means[ids[i], a] += points[i, a]
    for k in range(m):
        means[k] /= max(counts[k], 1.0)
    for i in range(points.shape[0]):
        k = ids[i]
        for a in range(3):
            for b in range(3):
                scatter[k, a, b] += (points[i, a] - means[k, a]) * (points[i, b] - means[k, b])
    return counts, means, scatter


@dataclass(frozen=True, eq=False)
class Fit:
    """Where a cloud fits a place: pose (4, 4), information (6, 6) in the cloud's frame, overlap 0..1, the
    weighted RMS distance to the planes [m], and the motion within the sweep (6,) where that was fitted."""

    T: Array
    information: Array
    overlap: float
    rmse: float
    motion: Array | None = None


LEAST_OVERLAP = 0.35
"""A cloud with a smaller overlap with a place does not fit it."""
KERNEL_M, GATE_VOXELS = 0.03, 0.7
"""Width of the Geman-McClure weight of a distance; the largest distance that counts once a pose is nearly
right."""
COVARIANCE_SCALE = 50.0
"""The errors of points are correlated, so their sum counts this many times less."""
LOOSE = np.array([0.1, 0.1, 0.1, 0.3, 0.3, 0.3] * 2)


class Seen(NamedTuple):
    """Points (n, 3) seen from `origin` (3,), in a sweep at times `when` (n,) in [0, 1] if these matter."""

    points: Array
    origin: Array
    when: Array = np.zeros(0)


def fit(
    surfels: Surfels,
    seen: Seen,
    T_guess: Array,
    *,
    gate: float,
    iterations: int = 12,
    prior: Array = LOOSE,
    motion: Array | None = None,
) -> Fit:
    """Point-to-plane alignment, started at `T_guess` (4, 4).

    `gate` is the largest distance to a plane that counts [m]; the width of the weight starts there and
    tightens. `prior` (12,) are standard deviations of the guess: of the pose, and of the motion. With
    `motion` (6,), the guessed one over the sweep, that is fitted too (continuous time, as in CT-ICP,
    Dellenbach et al. 2022); pose and result are then those of the sweep's start.
    """
    if len(seen.points) == 0 or len(surfels.means) == 0:
        return Fit(T_guess, np.zeros((6, 6)), 0.0, 0.0, motion)
    T, xi, width = T_guess, motion, gate
    anchor = (COVARIANCE_SCALE / prior**2)[: 6 if motion is None else 12]
    away = np.zeros(len(anchor))
    for iteration in range(iterations):
        still = seen
        if xi is not None:
            knots = np.stack([np.zeros(6), xi])
            still = seen._replace(points=deskewed_points(seen.points, seen.when, knots))
        H, b, overlap, rmse = normal_equations(still, np.ascontiguousarray(T), surfels, gate, width)
        n = len(anchor)
        step: Array = np.asarray(np.linalg.solve(H[:n, :n] + np.diag(anchor), -(b[:n] + anchor * away)))
        # Small steps add up to nearly the tangent vector of their product, and a prior is no ruler.
        away = away + step
        T = T @ se3.exp(step[:6])
        if xi is not None:
            xi = xi + step[6:]
        if float(np.abs(step).max()) < SETTLED and width <= KERNEL_M:
            break
        if iteration >= 1:
            width = max(KERNEL_M, 0.6 * width)
    u, _, vt = np.linalg.svd(T[:3, :3])
    T[:3, :3] = u @ vt
    return Fit(T, H[:6, :6], overlap, rmse, xi)


def observable(information: Array) -> Array:
    """Information (6, 6) without the unobservable directions, such as that along a corridor. Normals err by
    some degrees, so a blind direction still gathers a share of the others' information, up to BLIND of the
    best one's. Rotation and translation are judged separately."""
    out = information.copy()
    for block in (slice(0, 3), slice(3, 6)):
        values, vectors = np.linalg.eigh(information[block, block])
        for k in np.flatnonzero(values < BLIND * values[-1]):
            keep = np.eye(6)
            keep[block, block] -= np.outer(vectors[:, k], vectors[:, k])
            out = keep @ out @ keep
    return out


@njit(cache=True, forceinline=True, _nrt=False)
def nearest_surfel(q: Array, o: Array, surfels: Surfels, gate: float) -> int:
    """The surfel nearest to a point (3,) within its voxel and those around; -1 for none within the gate. It
    must face `o` (3,), from which the point was seen: the far side of a wall is not visible."""
    cells, pairs, low, voxel, means, normals, _ = surfels
    nx, ny, nz = cells.shape
    x = math.floor((q[0] - low[0]) / voxel)
    y = math.floor((q[1] - low[1]) / voxel)
    z = math.floor((q[2] - low[2]) / voxel)
    if x < -1 or y < -1 or z < -1 or x > nx or y > ny or z > nz:
        return -1
    best, found = 1.5 * voxel * voxel, -1
    for i in range(max(x - 1, 0), min(x + 2, nx)):
        for j in range(max(y - 1, 0), min(y + 2, ny)):
            for k in range(max(z - 1, 0), min(z + 2, nz)):
                if cells[i, j, k] < 0:
                    continue
                for side in range(2):
                    s = pairs[cells[i, j, k], side]
                    if s < 0:
                        continue
                    dx, dy, dz = q[0] - means[s, 0], q[1] - means[s, 1], q[2] - means[s, 2]
                    d = dx * dx + dy * dy + dz * dz
                    if d >= best:
                        continue
                    nx_, ny_, nz_ = normals[s, 0], normals[s, 1], normals[s, 2]
                    faces = (o[0] - q[0]) * nx_ + (o[1] - q[1]) * ny_ + (o[2] - q[2]) * nz_
                    if faces > 0.0 and abs(dx * nx_ + dy * ny_ + dz * nz_) <= gate:
                        best, found = d, s
    return found


@njit(cache=True)
def normal_equations(
    seen: Seen, T: Array, surfels: Surfels, gate: float, width: float
) -> tuple[Array, Array, float, float]:
    """Gauss-Newton system H (12, 12), b (12,) of the point-to-plane distances, overlap and weighted RMS.

    For T Exp(w, v): d(R p + t) = R (w x p + v), so each row is [p x (R'n), R'n]; a motion over the sweep
    moves a point by its share `when` (n,) of it (second half of the system; empty: no motion).
    """
    points, origin, when = seen
    means, normals, variances = surfels.means, surfels.normals, surfels.variances
    H, b = np.zeros((12, 12)), np.zeros(12)
    q, J, o = np.zeros(3), np.zeros(12), np.zeros(3)
    for a in range(3):
        o[a] = T[a, 0] * origin[0] + T[a, 1] * origin[1] + T[a, 2] * origin[2] + T[a, 3]
    size = 12 if len(when) > 0 else 6
    matched, total, squares = 0, 0.0, 0.0
    for i in range(points.shape[0]):
        p = points[i]
        for a in range(3):
            q[a] = T[a, 0] * p[0] + T[a, 1] * p[1] + T[a, 2] * p[2] + T[a, 3]
        s = nearest_surfel(q, o, surfels, gate)
        if s < 0:
            continue
        r = 0.0
        for a in range(3):
            r += normals[s, a] * (q[a] - means[s, a])
            J[3 + a] = T[0, a] * normals[s, 0] + T[1, a] * normals[s, 1] + T[2, a] * normals[s, 2]
        J[0] = p[1] * J[5] - p[2] * J[4]
        J[1] = p[2] * J[3] - p[0] * J[5]
        J[2] = p[0] * J[4] - p[1] * J[3]
        root = width * width / (width * width + r * r)
        robust = root * root
        w = robust / variances[s]
        if size == 12:
            for a in range(6):
                J[6 + a] = when[i] * J[a]
        for a in range(size):
            b[a] += w * r * J[a]
            for c in range(a, size):
                H[a, c] += w * J[a] * J[c]
        matched += 1
        total += robust
        squares += robust * r * r
    for a in range(12):
        for c in range(a):
            H[a, c] = H[c, a]
    n = points.shape[0]
    return H, b, matched / max(n, 1), math.sqrt(squares / total) if total > 0.0 else 0.0
