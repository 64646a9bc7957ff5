"""Extended Kalman filter over the pose AND where in its cells each wall stands.

A grid places a wall to within a cell only, and the same error is met by every beam on that wall in
every scan: treated as noise it would look small after a few scans while it is not. So each wall (patch
of surfaces) in sight gets a state of its own, its offset along the normal, known beforehand to a
fraction of a cell, and is estimated jointly with the pose (Smith, Self, Cheeseman 1990).
"""

from __future__ import annotations

import math

import numpy as np

from datasets.se2 import SE2, Array
from pipeline.localisation.matching import match_beams
from pipeline.localisation.surfaces import Indices, Surfaces

MAX_ITERATIONS = 5
STEP_DONE = 1e-4
# Walls kept in the state; beyond, the one longest out of sight is forgotten.
MAX_WALLS = 150


class WallFilter:
    """State: pose in the frame of the surfaces (x, y, yaw), then the offset of each known wall [m]."""

    def __init__(
        self,
        surfaces: Surfaces,
        T_map_base: SE2,
        covariance: Array,
        *,
        scale: float,
        beam_std: float,
        patch_beams: float,
        offset_std: float,
    ) -> None:
        self._surfaces = surfaces
        self._scale, self._beam_std, self._patch_beams = scale, beam_std, patch_beams
        self._offset_variance = offset_std**2
        T_surfaces_map = surfaces.T_map_surfaces.inverse()
        turn = _turn(float(T_surfaces_map.yaw))
        self._x = (T_surfaces_map @ T_map_base).xyt.copy()
        self._P = turn @ covariance @ turn.T
        self._walls = np.zeros(0, dtype=np.int32)  # patch of each offset in the state
        self._last_seen = np.zeros(0, dtype=np.int64)
        self._scans = 0

    @property
    def T_map_base(self) -> SE2:
        """The pose."""
        return self._surfaces.T_map_surfaces @ SE2.from_array(self._x[:3])

    @property
    def offsets(self) -> dict[int, tuple[float, float]]:
        """Offset and its standard deviation [m] of each known wall, by patch."""
        std = np.sqrt(np.diag(self._P)[3:])
        return {int(p): (float(o), float(s)) for p, o, s in zip(self._walls, self._x[3:], std, strict=True)}

    def predict(self, T_base_new: SE2, motion: tuple[float, float, float], std: Array) -> None:
        """Move by odometry: the motion, its parts (rot1, trans, rot2) and their standard deviations (3,)."""
        before = self._x[:3].copy()
        self._x[:3] = (SE2(before) @ T_base_new).xyt
        dx, dy = self._x[0] - before[0], self._x[1] - before[1]
        F = np.array([[1.0, 0.0, -dy], [0.0, 1.0, dx], [0.0, 0.0, 1.0]])
        c, s = math.cos(before[2] + motion[0]), math.sin(before[2] + motion[0])
        G = np.array([[-motion[1] * s, c, 0.0], [motion[1] * c, s, 0.0], [1.0, 0.0, 1.0]])
        self._P[:3] = F @ self._P[:3]
        self._P[:, :3] = self._P[:, :3] @ F.T
        self._P[:3, :3] += (G * std**2) @ G.T

    def correct(self, points_base: Array) -> None:
        """Take in a scan's end points, (n, 2) in the base frame."""
        self._scans += 1
        first = self._match(self._x[:3], points_base)
        seen = np.flatnonzero(first[0][:, 9] > 0.0).astype(np.int32)
        self._admit(seen)
        place = {int(patch): 3 + i for i, patch in enumerate(self._walls)}
        sub = np.array([0, 1, 2, *(place[int(patch)] for patch in seen)])
        before, x = self._x[sub], self._x[sub].copy()
        prior = self._P[np.ix_(sub, sub)]
        for iteration in range(MAX_ITERATIONS):
            sums, right = first if iteration == 0 else self._match(x[:3], points_base, seen, x[3:])
            information, gradient = self._normal_equations(sums[seen], right[seen])
            # (I + prior information)^-1 turns both gain and covariance: the information form, with
            # no inverse of a covariance that may be nearly singular.
            gain = np.linalg.solve(np.eye(len(sub)) + prior @ information, prior)
            moved = x - before
            moved[2] = (moved[2] + math.pi) % (2.0 * math.pi) - math.pi
            pull = information @ moved - gradient
            new = before + gain @ pull
            step = np.abs(new - x).max()
            x = new
            if step < STEP_DONE:
                break
        # P_ss^-1 (x - before) without the inverse; walls out of sight move with those in sight.
        self._x = self._x + self._P[:, sub] @ (pull - information @ (x - before))
        shrink = information - information @ gain @ information
        self._P = self._P - self._P[:, sub] @ shrink @ self._P[sub]
        self._P = 0.5 * (self._P + self._P.T)

    def _match(
        self, pose: Array, points: Array, seen: Indices | None = None, offsets: Array | None = None
    ) -> tuple[Array, Array]:
        s = self._surfaces
        full = np.zeros(s.patches)
        full[self._walls] = self._x[3:]
        if seen is not None and offsets is not None:
            full[seen] = offsets
        return match_beams(
            s.points,
            s.normals,
            s.trust,
            s.patch,
            s.nearest,
            1.0 / s.resolution,
            pose,
            points,
            full,
            self._scale,
            self._patch_beams,
        )

    def _normal_equations(self, sums: Array, right: Array) -> tuple[Array, Array]:
        """Information and gradient over (pose, seen offsets); a residual falls as its offset grows."""
        size = 3 + len(sums)
        H, g = np.zeros((size, size)), np.empty(size)
        rows, cols = np.triu_indices(3)
        H[rows, cols] = sums[:, :6].sum(axis=0)
        H[cols, rows] = H[rows, cols]
        H[3:, :3] = -sums[:, 6:9]
        H[:3, 3:] = -sums[:, 6:9].T
        H[range(3, size), range(3, size)] = sums[:, 9]
        g[:3], g[3:] = right[:, :3].sum(axis=0), -right[:, 3]
        return H / self._beam_std**2, g / self._beam_std**2

    def _admit(self, seen: Indices) -> None:
        """Give every wall in sight a state; drop those longest unseen when there are too many."""
        new = np.setdiff1d(seen, self._walls)
        if len(new):
            size, more = len(self._x), len(new)
            P = np.zeros((size + more, size + more))
            P[:size, :size] = self._P
            P[range(size, size + more), range(size, size + more)] = self._offset_variance
            self._P, self._x = P, np.concatenate([self._x, np.zeros(more)])
            self._walls = np.concatenate([self._walls, new])
            self._last_seen = np.concatenate([self._last_seen, np.zeros(more, dtype=np.int64)])
        self._last_seen[np.isin(self._walls, seen)] = self._scans
        if len(self._walls) > MAX_WALLS:
            in_sight = int(np.count_nonzero(self._last_seen == self._scans))
            kept = np.sort(np.argsort(-self._last_seen, kind="stable")[: max(MAX_WALLS, in_sight)])
            states = np.concatenate([[0, 1, 2], 3 + kept])
            self._x, self._P = self._x[states], self._P[np.ix_(states, states)]
            self._walls, self._last_seen = self._walls[kept], self._last_seen[kept]


def _turn(yaw: float) -> Array:
    c, s = math.cos(yaw), math.sin(yaw)
    return np.array([[c, -s, 0.0], [s, c, 0.0], [0.0, 0.0, 1.0]])
