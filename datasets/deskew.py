"""Deskewing: each beam's origin, relative to the start of the sweep.

One kernel is for the beams of a planar lidar, whose base moves in the plane, the other for the points of a
cloud, whose base moves in space.
"""

from __future__ import annotations

import math

import numpy as np

from turtlebag.datasets.kernels import njit
from turtlebag.datasets.se2 import Array


@njit(cache=True)
def deskewed(beams: Array, fractions: Array, T_base_lidar: Array, motion: Array) -> tuple[Array, Array]:
    """Origins and unit directions (n, 2) of beams in the base frame at the start of the sweep.

    `beams` (n, 2) are unit vectors in the lidar frame; `fractions` (n,) say when in the sweep a beam was
    sent, 0 at its start and 1 at its end; `T_base_lidar` is (3,). `motion` (k, 3) are base poses at k
    instants after the start, evenly spaced, the last at the end; in between the base moves on arcs of
    constant twist: the exponential of SE(2) and its inverse in closed form.
    """
    n, knots = len(beams), len(motion)
    origins, directions = np.empty((n, 2)), np.empty((n, 2))
    x0, y0, yaw0, arc = 0.0, 0.0, 0.0, -1
    for i in range(n):
        f = fractions[i] * knots
        k = min(int(f), knots - 1)
        f -= k
        if k != arc:
            arc = k
            x0, y0, yaw0 = 0.0, 0.0, 0.0
            if k > 0:
                x0, y0, yaw0 = motion[k - 1, 0], motion[k - 1, 1], motion[k - 1, 2]
            c0, s0 = np.cos(yaw0), np.sin(yaw0)
            dx, dy, yaw = motion[k, 0] - x0, motion[k, 1] - y0, motion[k, 2] - yaw0
            yaw -= 2.0 * np.pi * np.round(yaw / (2.0 * np.pi))
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
        angle = yaw0 + turn + T_base_lidar[2]
        c, s = np.cos(angle), np.sin(angle)
        directions[i, 0] = c * beams[i, 0] - s * beams[i, 1]
        directions[i, 1] = s * beams[i, 0] + c * beams[i, 1]
    return origins, directions


@njit(cache=True)
def deskewed_points(points: Array, fractions: Array, knots: Array) -> Array:
    """Points (n, 3), each in the base frame of its own time, transformed to the sweep's start.

    `fractions` (n,) say when in the sweep that was, 0 at its start and 1 at its end. `knots` (k, 6) are
    tangent vectors (rotation, translation) of the base's pose at k instants from start to end, evenly
    spaced; in between they are interpolated.
    """
    out = np.empty_like(points)
    w, v = np.zeros(3), np.zeros(3)
    last = len(knots) - 1
    for i in range(len(points)):
        at = min(max(fractions[i], 0.0), 1.0) * last
        k = min(int(at), last - 1)
        f = at - k
        for a in range(3):
            w[a] = (1 - f) * knots[k, a] + f * knots[k + 1, a]
            v[a] = (1 - f) * knots[k, 3 + a] + f * knots[k + 1, 3 + a]
        angle = math.sqrt(w[0] * w[0] + w[1] * w[1] + w[2] * w[2])
        one, two, three = 1.0, 0.5, 1.0 / 6.0
        if angle > 1e-4:
            one, two = math.sin(angle) / angle, (1.0 - math.cos(angle)) / (angle * angle)
            three = (1.0 - one) / (angle * angle)
        # R p + V v, with R = 1 + one W + two W W and V = 1 + two W + three W W
        for a in range(3):
            b, c = (a + 1) % 3, (a + 2) % 3
            wp, wv = w[b] * points[i, c] - w[c] * points[i, b], w[b] * v[c] - w[c] * v[b]
            # W W x = w (w . x) - x (w . w)
            wwp = w[a] * _dot(w, points[i]) - angle * angle * points[i, a]
            wwv = w[a] * _dot(w, v) - angle * angle * v[a]
            out[i, a] = points[i, a] + one * wp + two * wwp + v[a] + two * wv + three * wwv
    return out


@njit(cache=True)
def _dot(a: Array, b: Array) -> float:
    return a[0] * b[0] + a[1] * b[1] + a[2] * b[2]
