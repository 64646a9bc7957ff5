"""Rigid transforms in space as homogeneous matrices (..., 4, 4), batch first; `SE3` is the twin of `SE2`.

`T_a_b @ T_b_c` is `T_a_c`. Tangent vectors are (..., 6): rotation [rad] before translation [m], applied
on the right: T Exp(xi). Formulas: Barfoot (2017), "State Estimation for Robotics", chapter 7.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np

from turtlebag.datasets.se2 import SE2, Array

_SMALL = 1e-6


@dataclass(frozen=True, eq=False, slots=True)
class SE3:
    """A pose in space or a batch of them, with the methods of `SE2` that a pose graph needs; `matrix` is
    (..., 4, 4)."""

    matrix: Array

    @staticmethod
    def from_array(matrix: Array) -> SE3:
        """From homogeneous matrices (..., 4, 4)."""
        return SE3(np.asarray(matrix))

    @property
    def array(self) -> Array:
        """The matrices (..., 4, 4)."""
        return self.matrix

    def __len__(self) -> int:
        return len(self.matrix)

    def __getitem__(self, index: Any) -> SE3:
        return SE3(self.matrix[index])

    def __matmul__(self, other: SE3) -> SE3:
        return SE3(self.matrix @ other.matrix)

    def inverse(self) -> SE3:
        """`T_b_a` from `T_a_b`."""
        return SE3(inverse(self.matrix))

    def vector(self) -> Array:
        """Small motions as vectors, rotation and translation, (..., 6)."""
        return log(self.matrix)

    def size(self) -> tuple[Array, Array]:
        """Distance [m] and angle [rad], (...,) each."""
        xi = log(self.matrix)
        return np.linalg.norm(xi[..., 3:], axis=-1), np.linalg.norm(xi[..., :3], axis=-1)

    def interpolate(self, other: SE3, fraction: Array) -> SE3:
        """Pose at `fraction` (0: this pose, 1: `other`), along the screw that joins them."""
        return SE3(interpolate(self.matrix, other.matrix, fraction))


def lifted(T: SE2) -> Array:
    """A planar transform in space: z, roll and pitch are 0."""
    out = np.zeros((*T.shape, 4, 4))
    c, s = np.cos(T.yaw), np.sin(T.yaw)
    out[..., 0, 0], out[..., 0, 1], out[..., 1, 0], out[..., 1, 1] = c, -s, s, c
    out[..., 0, 3], out[..., 1, 3] = T.x, T.y
    out[..., 2, 2] = out[..., 3, 3] = 1.0
    return out


def planar(T: Array) -> SE2:
    """x, y and yaw of a transform."""
    return SE2.from_matrix(T)


def inverse(T: Array) -> Array:
    """`T_b_a` from `T_a_b`."""
    out = np.zeros_like(T)
    Rt = np.swapaxes(T[..., :3, :3], -1, -2)
    out[..., :3, :3] = Rt
    out[..., :3, 3] = -np.einsum("...ij,...j->...i", Rt, T[..., :3, 3])
    out[..., 3, 3] = 1.0
    return out


def moved(T: Array, points: Array) -> Array:
    """Points (n, 3) in frame a from points in frame b, by `T_a_b` (4, 4)."""
    return points @ T[:3, :3].T + T[:3, 3]


def skew(w: Array) -> Array:
    """Matrices (..., 3, 3) of the cross product with vectors (..., 3)."""
    out = np.zeros((*w.shape[:-1], 3, 3))
    out[..., 0, 1], out[..., 0, 2], out[..., 1, 2] = -w[..., 2], w[..., 1], -w[..., 0]
    return out - np.swapaxes(out, -1, -2)


def _coefficients(angle: Array) -> tuple[Array, Array, Array]:
    """sin a / a, (1 - cos a) / a^2 and (a - sin a) / a^3, good at 0 too."""
    small = angle < _SMALL
    a = np.where(small, 1.0, angle)
    one = np.where(small, 1.0, np.sin(a) / a)
    two = np.where(small, 0.5, (1.0 - np.cos(a)) / a**2)
    three = np.where(small, 1.0 / 6.0, (a - np.sin(a)) / a**3)
    return one[..., None, None], two[..., None, None], three[..., None, None]


def exp(xi: Array) -> Array:
    """Transforms (..., 4, 4) of tangent vectors (..., 6)."""
    w, v = xi[..., :3], xi[..., 3:]
    one, two, three = _coefficients(np.linalg.norm(w, axis=-1))
    W = skew(w)
    WW, eye = W @ W, np.eye(3)
    out = np.zeros((*xi.shape[:-1], 4, 4))
    out[..., :3, :3] = eye + one * W + two * WW
    out[..., :3, 3] = np.einsum("...ij,...j->...i", eye + two * W + three * WW, v)
    out[..., 3, 3] = 1.0
    return out


def log(T: Array) -> Array:
    """Tangent vectors (..., 6) of transforms; rotations below half a turn."""
    q = quaternions(T)
    q = np.where(q[..., 3:] < 0.0, -q, q)
    sine = np.linalg.norm(q[..., :3], axis=-1)
    angle = 2.0 * np.arctan2(sine, q[..., 3])
    w = q[..., :3] * np.where(sine < _SMALL, 2.0, angle / np.where(sine < _SMALL, 1.0, sine))[..., None]
    one, two, _ = _coefficients(angle)
    W = skew(w)
    small = angle < 1e-3
    square = np.where(small, 1.0, angle**2)[..., None, None]
    inner = np.where(small[..., None, None], 1.0 / 12.0, (1.0 - 0.5 * one / two) / square)
    V_inverse = np.eye(3) - 0.5 * W + inner * (W @ W)
    return np.concatenate([w, np.einsum("...ij,...j->...i", V_inverse, T[..., :3, 3])], axis=-1)


def rotations(q: Array) -> Array:
    """Matrices (..., 3, 3) of unit quaternions (..., 4) x, y, z, w."""
    x, y, z, w = np.moveaxis(q, -1, 0)
    rows = (
        (1 - 2 * (y * y + z * z), 2 * (x * y - z * w), 2 * (x * z + y * w)),
        (2 * (x * y + z * w), 1 - 2 * (x * x + z * z), 2 * (y * z - x * w)),
        (2 * (x * z - y * w), 2 * (y * z + x * w), 1 - 2 * (x * x + y * y)),
    )
    return np.stack([np.stack(row, axis=-1) for row in rows], axis=-2)


def quaternions(T: Array) -> Array:
    """Unit quaternions (..., 4) x, y, z, w of the rotations (Shepperd 1978: from the largest part)."""
    R = T[..., :3, :3]
    xx, yy, zz = R[..., 0, 0], R[..., 1, 1], R[..., 2, 2]
    squares = np.stack([1 + xx - yy - zz, 1 - xx + yy - zz, 1 - xx - yy + zz, 1 + xx + yy + zz], axis=-1)
    a, b, c = R[..., 2, 1] - R[..., 1, 2], R[..., 0, 2] - R[..., 2, 0], R[..., 1, 0] - R[..., 0, 1]
    d, e, f = R[..., 0, 1] + R[..., 1, 0], R[..., 0, 2] + R[..., 2, 0], R[..., 1, 2] + R[..., 2, 1]
    rows = np.stack(
        [
            np.stack([squares[..., 0], d, e, a], axis=-1),
            np.stack([d, squares[..., 1], f, b], axis=-1),
            np.stack([e, f, squares[..., 2], c], axis=-1),
            np.stack([a, b, c, squares[..., 3]], axis=-1),
        ],
        axis=-2,
    )
    best = np.argmax(squares, axis=-1)[..., None, None]
    row = np.take_along_axis(rows, best, axis=-2)[..., 0, :]
    return row / np.linalg.norm(row, axis=-1, keepdims=True)


def interpolate(T_a: Array, T_b: Array, fraction: Array) -> Array:
    """Poses between T_a (0) and T_b (1) along the screw that joins them."""
    return T_a @ exp(np.asarray(fraction)[..., None] * log(inverse(T_a) @ T_b))
