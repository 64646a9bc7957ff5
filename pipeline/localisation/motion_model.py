"""Differential odometry motion model (Probabilistic Robotics, table 5.6), with ROS amcl's alphas."""

from __future__ import annotations

import math

import numpy as np

from turtlebag.datasets.kernels import njit
from turtlebag.datasets.se2 import SE2, Array, wrap

# Below this step the direction of travel is noise and the motion counts as a turn on the spot; ROS amcl's.
MIN_STEP_M = 0.01


def decompose(T_base_new: SE2) -> tuple[float, float, float]:
    """(rot1, trans, rot2) of a motion; a backward motion has negative trans and small rotations."""
    x, y, yaw = (float(value) for value in T_base_new.xyt)
    trans = math.hypot(x, y)
    if trans < MIN_STEP_M:
        return 0.0, trans, yaw
    rot1 = math.atan2(y, x)
    if abs(rot1) > math.pi / 2.0:
        rot1, trans = float(wrap(rot1 + math.pi)), -trans
    return rot1, trans, float(wrap(yaw - rot1))


def noise_std(motion: tuple[float, float, float], alphas: tuple[float, float, float, float]) -> Array:
    """Standard deviations of (rot1, trans, rot2), (3,): square roots of the alphas' sums."""
    rot1, trans, rot2 = motion
    a1, a2, a3, a4 = alphas
    return np.sqrt(
        [
            a1 * rot1**2 + a2 * trans**2,
            a3 * trans**2 + a4 * (rot1**2 + rot2**2),
            a1 * rot2**2 + a2 * trans**2,
        ]
    )


@njit(cache=True)
def move(poses: Array, motion: tuple[float, float, float], noise: Array) -> None:
    """Move every pose (n, 3) in place by its own noisy copy of the motion; `noise` is (n, 3) in SI."""
    for i in range(len(poses)):
        heading = poses[i, 2] + motion[0] + noise[i, 0]
        step = motion[1] + noise[i, 1]
        poses[i, 0] += step * np.cos(heading)
        poses[i, 1] += step * np.sin(heading)
        yaw = heading + motion[2] + noise[i, 2]
        poses[i, 2] = yaw - 2.0 * np.pi * np.floor((yaw + np.pi) / (2.0 * np.pi))
