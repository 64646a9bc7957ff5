"""Gauss-Newton on the distance field: the most probable pose near the cloud's mean, from all beams."""

from __future__ import annotations

import numpy as np
from numba import njit

from datasets.se2 import SE2, Array
from pipeline.localisation.field import DistanceField, FloatGrid

MAX_ITERATIONS = 10
STEP_DONE = 1e-5


def refine(
    field: DistanceField,
    T_map_prior: SE2,
    information: Array,
    points_base: Array,
    *,
    sigma_hit: float,
    odds_rand: float,
    beam_share: float,
) -> tuple[SE2, Array]:
    """Maximum a posteriori pose, and its information matrix (3, 3) in the map frame.

    Minimises the prior (`information`, (3, 3), about `T_map_prior`) plus the squared field distances of
    the end points over sigma_hit^2. Each beam counts with the probability that it hit the map at all
    (`odds_rand` is z_rand / range_max over z_hit) times `beam_share`, the share of independent
    evidence a beam carries: neighbouring beams see the same wall with the same map error.
    """
    inverse_resolution = 1.0 / field.resolution
    T_field_map = field.T_map_field.inverse()
    start = (T_field_map @ T_map_prior).xyt.copy()
    c, s = np.cos(T_field_map.yaw), np.sin(T_field_map.yaw)
    turn = np.array([[c, -s, 0.0], [s, c, 0.0], [0.0, 0.0, 1.0]])
    prior = turn @ information @ turn.T
    pose = start.copy()
    H = prior
    for _ in range(MAX_ITERATIONS):
        h, g = normal_equations(field.distance, inverse_resolution, pose, points_base, sigma_hit, odds_rand)
        offset = pose - start
        offset[2] = (offset[2] + np.pi) % (2.0 * np.pi) - np.pi
        H = prior + beam_share * h
        step = np.linalg.solve(H, -(prior @ offset + beam_share * g))
        pose = pose + step
        if np.abs(step).max() < STEP_DONE:
            break
    return field.T_map_field @ SE2.from_array(pose), turn.T @ H @ turn


@njit(cache=True)
def normal_equations(
    distance: FloatGrid, inverse_resolution: float, pose: Array, points: Array, sigma: float, odds_rand: float
) -> tuple[Array, Array]:
    """(J^T W J, J^T W r) over sigma^2 of the field distances r at the end points; SI."""
    rows, cols = distance.shape
    h, g, jac = np.zeros((3, 3)), np.zeros(3), np.empty(3)
    c, s = np.cos(pose[2]), np.sin(pose[2])
    for j in range(len(points)):
        dx, dy = c * points[j, 0] - s * points[j, 1], s * points[j, 0] + c * points[j, 1]
        gx, gy = (pose[0] + dx) * inverse_resolution, (pose[1] + dy) * inverse_resolution
        if gx < 0.0 or gy < 0.0 or gx >= cols - 1 or gy >= rows - 1:
            continue
        col, row = int(gx), int(gy)
        fx, fy = gx - col, gy - row
        d00, d01 = distance[row, col], distance[row, col + 1]
        d10, d11 = distance[row + 1, col], distance[row + 1, col + 1]
        low, high = d00 + fx * (d01 - d00), d10 + fx * (d11 - d10)
        r = low + fy * (high - low)
        jac[0] = ((1.0 - fy) * (d01 - d00) + fy * (d11 - d10)) * inverse_resolution
        jac[1] = (high - low) * inverse_resolution
        jac[2] = -jac[0] * dy + jac[1] * dx
        hit = np.exp(-0.5 * (r / sigma) ** 2)
        w = hit / (hit + odds_rand) / sigma**2
        for a in range(3):
            g[a] += w * jac[a] * r
            for b in range(3):
                h[a, b] += w * jac[a] * jac[b]
    return h, g
