"""Undoing a robot's motion during a sweep: from where, and in which direction, each beam was sent."""

from __future__ import annotations

import numpy as np

from turtlebag.datasets.kernels import njit
from turtlebag.datasets.se2 import Array


@njit(cache=True)
def deskewed(bearings: Array, fractions: Array, T_base_lidar: Array, motion: Array) -> tuple[Array, Array]:
    """Origins and unit directions (n, 2) of beams in the base frame at the start of the sweep.

    `bearings` (n,) are in the lidar frame [rad]; `fractions` (n,) say when in the sweep a beam was sent,
    0 at its start and 1 at its end; `T_base_lidar` is (3,). `motion` (k, 3) are base poses at k instants
    after the start, evenly spaced, the last at the end; in between the base moves on arcs of constant
    twist: the exponential of SE(2) and its inverse in closed form.
    """
    n, knots = len(bearings), len(motion)
    origins, directions = np.empty((n, 2)), np.empty((n, 2))
    x0, y0, yaw0, arc = 0.0, 0.0, 0.0, -1
    for i in range(n):
        f = fractions[i] * knots
        k = min(int(f), knots - 1)
        f -= k
        if k != arc:
            arc = k
            if k > 0:
                x0, y0, yaw0 = motion[k - 1, 0], motion[k - 1, 1], motion[k - 1, 2]
            c0, s0 = np.cos(yaw0), np.sin(yaw0)
            dx, dy, yaw = motion[k, 0] - x0, motion[k, 1] - y0, motion[k, 2] - yaw0
            dx, dy = c0 * dx + s0 * dy, c0 * dy - s0 * dx
            # Translation part of the twist: V(yaw)^-1 t; half / tan(half) -> 1 for small turns.
            half = 0.5 * yaw
            shrink = 1.0 if abs(half) < 1e-9 else half / np.tan(half)
            ux, uy = shrink * dx + half * dy, shrink * dy - half * dx
        turn = f * yaw
        a, b = (f, 0.5 * f * turn) if abs(turn) < 1e-9 else (np.sin(turn) / yaw, (1.0 - np.cos(turn)) / yaw)
        c, s = np.cos(turn), np.sin(turn)
        x = a * ux - b * uy + c * T_base_lidar[0] - s * T_base_lidar[1]
        y = b * ux + a * uy + s * T_base_lidar[0] + c * T_base_lidar[1]
        origins[i, 0], origins[i, 1] = x0 + c0 * x - s0 * y, y0 + s0 * x + c0 * y
        angle = yaw0 + turn + T_base_lidar[2] + bearings[i]
        directions[i, 0], directions[i, 1] = np.cos(angle), np.sin(angle)
    return origins, directions
