"""Scan to map: residuals of a scan's end points against the map's surfaces, summed up per wall."""

from __future__ import annotations

import numpy as np

from turtlebag.datasets.kernels import njit
from turtlebag.datasets.se2 import Array
from turtlebag.pipeline.localisation.surfaces import Surfaces


@njit(cache=True)
def match_beams(
    surfaces: Surfaces, pose: Array, beams: Array, offsets: Array, scale: float, patch_beams: float
) -> tuple[Array, Array]:
    """Sums over the beams of each patch: second order terms (patches, 10), first order ones (patches, 4).

    The residual of a beam is the distance of its end point along the surface's normal from the surface,
    less the `offset` of its patch; the Jacobian j is with respect to the pose (x, y, yaw). Columns:
    the upper triangle of w j j^T (6), w j (3) and w (1); then w j r (3) and w r (1). Robust weights:
    Geman-McClure, a beam that is `scale` [m] off counts a quarter; all beams on one patch together
    weigh at most `patch_beams`.
    """
    points, normals, nearest = surfaces.points, surfaces.normals, surfaces.nearest
    n, per_metre = len(beams), 1.0 / surfaces.resolution
    seen = np.full(n, -1, dtype=np.int32)
    jac, residual, weight = np.empty((n, 3)), np.empty(n), np.empty(n)
    mass = np.zeros(len(offsets))
    c, s = np.cos(pose[2]), np.sin(pose[2])
    for i in range(n):
        dx, dy = c * beams[i, 0] - s * beams[i, 1], s * beams[i, 0] + c * beams[i, 1]
        x, y = pose[0] + dx, pose[1] + dy
        col, row = int(np.floor(x * per_metre)), int(np.floor(y * per_metre))
        if not (0 <= row < nearest.shape[0] and 0 <= col < nearest.shape[1]):
            continue
        k = nearest[row, col]
        if k < 0:
            continue
        nx, ny = normals[k, 0], normals[k, 1]
        if nx * dx + ny * dy > 0.0:
            continue  # this face looks away from the robot: the far side of a thin wall
        p = surfaces.patch[k]
        residual[i] = (x - points[k, 0]) * nx + (y - points[k, 1]) * ny - offsets[p]
        seen[i] = p
        jac[i, 0], jac[i, 1], jac[i, 2] = nx, ny, ny * dx - nx * dy
        weight[i] = surfaces.trust[k] / (1.0 + (residual[i] / scale) ** 2) ** 2
        mass[p] += weight[i]
    sums, right = np.zeros((len(offsets), 10)), np.zeros((len(offsets), 4))
    for i in range(n):
        p = seen[i]
        if p < 0:
            continue
        w = weight[i] * min(1.0, patch_beams / mass[p])
        column = 0
        for a in range(3):
            for b in range(a, 3):
                sums[p, column] += w * jac[i, a] * jac[i, b]
                column += 1
            sums[p, 6 + a] += w * jac[i, a]
            right[p, a] += w * jac[i, a] * residual[i]
        sums[p, 9] += w
        right[p, 3] += w * residual[i]
    return sums, right
