"""Planar rigid transforms, batch first."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Any, overload

import numpy as np
from numpy.typing import ArrayLike, NDArray

Array = NDArray[np.float64]


def wrap(angle: ArrayLike) -> Array:
    """Angles wrapped to [-pi, pi) [rad]."""
    return (np.asarray(angle, dtype=np.float64) + np.pi) % (2.0 * np.pi) - np.pi


@dataclass(frozen=True, eq=False, slots=True)
class SE2:
    """A pose or a batch of poses: `T_a_b` is frame b seen from frame a.

    `xyt` has shape (..., 3): x [m], y [m], yaw [rad, in [-pi, pi)]. `T_a_b @ T_b_c` is `T_a_c`;
    `T_a_b @ points_b` with points of shape (..., 2) is `points_a`. Batch axes broadcast, so a batch
    of N poses moves N points; to move M points by each of N poses write `T[:, None] @ points`.
    """

    xyt: Array

    @staticmethod
    def from_xyt(x: ArrayLike, y: ArrayLike, yaw: ArrayLike) -> SE2:
        """Transform from its parts, broadcast together; yaw is wrapped."""
        x, y, yaw = np.broadcast_arrays(
            np.asarray(x, dtype=np.float64), np.asarray(y, dtype=np.float64), wrap(yaw)
        )
        return SE2(_joined(x, y, yaw))

    @staticmethod
    def from_array(xyt: ArrayLike) -> SE2:
        """Transform from an array of shape (..., 3); yaw is wrapped."""
        xyt = np.array(xyt, dtype=np.float64)
        if xyt.shape[-1:] != (3,):
            raise ValueError(f"SE2 needs an array of shape (..., 3), got {xyt.shape}")
        xyt[..., 2] = wrap(xyt[..., 2])
        return SE2(xyt)

    @staticmethod
    def identity(*shape: int) -> SE2:
        """Identity transforms of the given batch shape."""
        return SE2(np.zeros((*shape, 3)))

    @staticmethod
    def stack(poses: list[SE2]) -> SE2:
        """Poses of equal batch shape, stacked along a new first axis."""
        return SE2(np.stack([pose.xyt for pose in poses]))

    @property
    def x(self) -> Array:
        """x [m]."""
        return self.xyt[..., 0]

    @property
    def y(self) -> Array:
        """y [m]."""
        return self.xyt[..., 1]

    @property
    def yaw(self) -> Array:
        """Yaw [rad]."""
        return self.xyt[..., 2]

    @property
    def xy(self) -> Array:
        """Translation, (..., 2) [m]."""
        return self.xyt[..., :2]

    @property
    def shape(self) -> tuple[int, ...]:
        """Batch shape."""
        return self.xyt.shape[:-1]

    def __len__(self) -> int:
        return len(self.xyt) if self.xyt.ndim > 1 else 1

    def __getitem__(self, index: Any) -> SE2:
        if self.xyt.ndim == 1 and index is not None:
            raise IndexError("a single SE2 has no batch axis to index")
        return SE2(self.xyt[(*index, slice(None))] if isinstance(index, tuple) else self.xyt[index])

    @overload
    def __matmul__(self, other: SE2) -> SE2: ...
    @overload
    def __matmul__(self, other: Array) -> Array: ...
    def __matmul__(self, other: SE2 | Array) -> SE2 | Array:
        p = other.xyt if isinstance(other, SE2) else other
        if isinstance(other, SE2) and self.xyt.ndim == p.ndim == 1:
            return SE2(compose(self.xyt, p))
        c, s = np.cos(self.xyt[..., 2]), np.sin(self.xyt[..., 2])
        x = self.xyt[..., 0] + c * p[..., 0] - s * p[..., 1]
        y = self.xyt[..., 1] + s * p[..., 0] + c * p[..., 1]
        if isinstance(other, SE2):
            return SE2(_joined(x, y, wrap(self.xyt[..., 2] + p[..., 2])))
        return _joined(x, y)

    def inverse(self) -> SE2:
        """`T_b_a` from `T_a_b`."""
        if self.xyt.ndim == 1:
            x, y, yaw = self.xyt.tolist()
            cos, sin = math.cos(yaw), math.sin(yaw)
            return SE2(np.array([-cos * x - sin * y, sin * x - cos * y, wrapped(-yaw)]))
        c, s = np.cos(self.xyt[..., 2]), np.sin(self.xyt[..., 2])
        xs, ys = self.xyt[..., 0], self.xyt[..., 1]
        return SE2(_joined(-c * xs - s * ys, s * xs - c * ys, wrap(-self.xyt[..., 2])))

    @property
    def array(self) -> Array:
        """`xyt`, by the name that it shares with `SE3`."""
        return self.xyt

    def vector(self) -> Array:
        """Small motions as vectors x, y, yaw, (..., 3)."""
        return self.xyt

    def size(self) -> tuple[Array, Array]:
        """Distance [m] and angle [rad], (...,) each."""
        return np.hypot(self.x, self.y), np.abs(self.yaw)

    def steps(self) -> Array:
        """Each of n poses relative to the previous one, (n - 1, 3)."""
        return (self[:-1].inverse() @ self[1:]).xyt

    def matrix(self) -> Array:
        """Homogeneous matrices, (..., 3, 3)."""
        out = np.zeros((*self.shape, 3, 3))
        c, s = np.cos(self.xyt[..., 2]), np.sin(self.xyt[..., 2])
        out[..., 0, 0], out[..., 0, 1], out[..., 0, 2] = c, -s, self.xyt[..., 0]
        out[..., 1, 0], out[..., 1, 1], out[..., 1, 2] = s, c, self.xyt[..., 1]
        out[..., 2, 2] = 1.0
        return out

    @staticmethod
    def from_matrix(matrix: Array) -> SE2:
        """From homogeneous matrices (..., 3, 3) or the planar part of (..., 4, 4)."""
        yaw = np.arctan2(matrix[..., 1, 0], matrix[..., 0, 0])
        return SE2.from_xyt(matrix[..., 0, -1], matrix[..., 1, -1], yaw)

    def interpolate(self, other: SE2, fraction: ArrayLike) -> SE2:
        """Pose at `fraction` (0: this pose, 1: `other`): linear in position, shortest turn in yaw."""
        f = np.asarray(fraction, dtype=np.float64)
        xy = self.xy + f[..., None] * (other.xy - self.xy)
        yaw = self.yaw + f * wrap(other.yaw - self.yaw)
        return SE2.from_xyt(xy[..., 0], xy[..., 1], yaw)


def _joined(*parts: Array) -> Array:
    """Parts of equal shape along a new last axis; `np.stack` is slow."""
    if np.ndim(parts[0]) == 0:
        return np.array(parts)
    whole = np.empty((*np.shape(parts[0]), len(parts)))
    for k, part in enumerate(parts):
        whole[..., k] = part
    return whole


def compose(a: Array, b: Array) -> Array:
    """`T_x_z` from `T_x_y` and `T_y_z`, single poses (3,)."""
    (ax, ay, turn), (x, y, yaw) = a.tolist(), b.tolist()
    c, s = math.cos(turn), math.sin(turn)
    return np.array([ax + c * x - s * y, ay + s * x + c * y, wrapped(turn + yaw)])


def between(a: Array, b: Array) -> Array:
    """`T_a_b` from `T_x_a` and `T_x_b`, single poses (3,)."""
    (ax, ay, turn), (x, y, yaw) = a.tolist(), b.tolist()
    c, s, dx, dy = math.cos(turn), math.sin(turn), x - ax, y - ay
    return np.array([c * dx + s * dy, -s * dx + c * dy, wrapped(yaw - turn)])


def wrapped(angle: float) -> float:
    """`wrap` of a single angle, ten times as fast."""
    return float((angle + np.pi) % (2.0 * np.pi) - np.pi)
