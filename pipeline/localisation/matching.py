"""Scan to map: the pose from which the end points lie on the map's surfaces, near a prior."""

from __future__ import annotations

import math

import numpy as np
from numba import njit

from datasets.se2 import SE2, Array
from pipeline.localisation.surfaces import Indices, Surfaces

MAX_ITERATIONS = 8
STEP_DONE = 1e-5


def match(
    surfaces: Surfaces,
    T_map_prior: SE2,
    covariance: Array,
    points_base: Array,
    *,
    scale: float,
    beam_std: float,
    patch_beams: float,
) -> tuple[SE2, Array]:
    """Pose and covariance (3, 3; x, y, yaw in the map frame) after matching the end points to the surfaces.

    `scale` is the residual [m] at which a beam counts a quarter (Geman-McClure), `beam_std` the
    standard deviation of one beam. All beams on one patch together count as at most `patch_beams`:
    they share the map's error of that wall, and more of them tell nothing new.
    """
    T_surfaces_map = surfaces.T_map_surfaces.inverse()
    prior = (T_surfaces_map @ T_map_prior).xyt
    turn = _turn(float(T_surfaces_map.yaw))
    P = turn @ covariance @ turn.T
    information = np.linalg.inv(P)
    pose = prior.copy()
    H = information
    for _ in range(MAX_ITERATIONS):
        h, g = normal_equations(
            surfaces.points,
            surfaces.normals,
            surfaces.trust,
            surfaces.patch,
            surfaces.nearest,
            1.0 / surfaces.resolution,
            pose,
            points_base,
            scale,
            patch_beams,
            np.zeros(surfaces.patches),
        )
        offset = pose - prior
        offset[2] = (offset[2] + math.pi) % (2.0 * math.pi) - math.pi
        H = information + h / beam_std**2
        step = np.linalg.solve(H, -(information @ offset + g / beam_std**2))
        pose = pose + step
        if np.abs(step).max() < STEP_DONE:
            break
    covariance = turn.T @ np.linalg.inv(H) @ turn
    return surfaces.T_map_surfaces @ SE2.from_array(pose), covariance


def _turn(yaw: float) -> Array:
    c, s = math.cos(yaw), math.sin(yaw)
    return np.array([[c, -s, 0.0], [s, c, 0.0], [0.0, 0.0, 1.0]])


@njit(cache=True)
def normal_equations(
    points: Array,
    normals: Array,
    trust: Array,
    patch: Indices,
    nearest: Indices,
    inverse_resolution: float,
    pose: Array,
    beams: Array,
    scale: float,
    patch_beams: float,
    mass: Array,
) -> tuple[Array, Array]:
    """(J^T W J, J^T W r) of the point-to-line residuals of `beams` (n, 2) seen from `pose` (3,).

    `mass` (patches,) must come in as zeros: it collects each patch's weight, which is capped.
    """
    n = len(beams)
    seen = np.full(n, -1, dtype=np.int32)
    jac, residual, weight = np.empty((n, 3)), np.empty(n), np.empty(n)
    c, s = np.cos(pose[2]), np.sin(pose[2])
    for i in range(n):
        dx, dy = c * beams[i, 0] - s * beams[i, 1], s * beams[i, 0] + c * beams[i, 1]
        x, y = pose[0] + dx, pose[1] + dy
        col, row = int(np.floor(x * inverse_resolution)), int(np.floor(y * inverse_resolution))
        if not (0 <= row < nearest.shape[0] and 0 <= col < nearest.shape[1]):
            continue
        k = nearest[row, col]
        if k < 0:
            continue
        nx, ny = normals[k, 0], normals[k, 1]
        if nx * dx + ny * dy > 0.0:
            continue  # this face looks away from the robot: the far side of a thin wall
        r = (x - points[k, 0]) * nx + (y - points[k, 1]) * ny
        seen[i], residual[i] = k, r
        jac[i, 0], jac[i, 1], jac[i, 2] = nx, ny, ny * dx - nx * dy
        weight[i] = trust[k] / (1.0 + (r / scale) ** 2) ** 2
        mass[patch[k]] += weight[i]
    h, g = np.zeros((3, 3)), np.zeros(3)
    for i in range(n):
        if seen[i] < 0:
            continue
        w = weight[i] * min(1.0, patch_beams / mass[patch[seen[i]]])
        for a in range(3):
            g[a] += w * jac[i, a] * residual[i]
            for b in range(3):
                h[a, b] += w * jac[i, a] * jac[i, b]
    return h, g
