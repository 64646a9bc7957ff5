"""Extended Kalman filter over the pose, odometry's errors, and where in its cells each wall stands.

A grid places a wall to within a cell only, and the same error is met by every beam on that wall in
every scan: treated as noise it would look small after a few scans while it is not. So each wall (patch
of surfaces) in sight gets a state of its own, its offset along the normal, known beforehand to a
fraction of a cell, and is estimated jointly with the pose (Smith, Self, Cheeseman 1990).

Odometry is wrong by nearly constant shares (a wheel's radius, the track: Censi et al. 2013), and that is
a state, too: learned where walls are in sight, it carries the pose along a bare corridor, where they tell
nothing about the way along it.
"""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

from turtlebag.datasets.kernels import njit
from turtlebag.datasets.point_to_line import linearise
from turtlebag.datasets.se2 import SE2, Array
from turtlebag.pipeline.localisation.small_matrices import multiply, solve
from turtlebag.pipeline.localisation.surfaces import Indices, Surfaces

# Residual at which a beam counts a quarter, standard deviation of a beam, how many beams' worth one wall may
# say in a scan (any number: the house 1.13 cm off for 0.92), and how far from where its cells are a wall may
# stand (standard deviation: that of anywhere within half a cell).
MATCH_SCALE_M, BEAM_STD_M, PATCH_BEAMS, OFFSET_CELLS = 0.03, 0.012, 4.0, 0.14
# Walls kept in the state, for the sake of time; beyond, those out of sight are forgotten.
MAX_WALLS = 150
# States before the walls': the pose (x, y, yaw), then odometry's errors: share of distance, share of turn,
# and turn by distance [rad/m]; their standard deviations beforehand, and what they gain in a metre.
POSE, FIXED = 3, 6
ODOMETRY_STD = np.array([0.02, 0.02, 0.01])
ODOMETRY_WALK = 5e-4
# A step of 0.1 mm or 0.006 deg is none: smaller ones do not count in the NIS.
NO_STEP = 1e-4
# From this NIS on, odometry slipped, by about so much [m and rad].
SLIP, SLIP_STD = 6.0, 0.1


class WallFilter:
    """State: pose in the frame of the surfaces, odometry's errors, then the offset of each known wall [m]."""

    def __init__(
        self,
        surfaces: Surfaces,
        T_map_base: SE2,
        covariance: Array,
        most_walls: int = MAX_WALLS,
    ) -> None:
        self._surfaces = surfaces
        T_surfaces_map = surfaces.T_map_surfaces.inverse()
        turn = _turn(float(T_surfaces_map.yaw))
        self.state = np.concatenate([(T_surfaces_map @ T_map_base).xyt, np.zeros(3)])
        """Pose, odometry's errors, and the offset of each of the `walls`, (FIXED + walls,)."""
        self.P = np.zeros((FIXED, FIXED))
        """Covariance of the state."""
        self.P[:POSE, :POSE] = turn @ covariance @ turn.T
        self.P[range(POSE, FIXED), range(POSE, FIXED)] = ODOMETRY_STD**2
        self.walls = np.zeros(0, dtype=np.int32)
        """Patch of each offset in the state."""
        self._most_walls = most_walls
        self._place = np.full(surfaces.patches, -1, dtype=np.int64)  # of a patch in the list of walls

    @property
    def T_map_base(self) -> SE2:
        """The pose."""
        return self._surfaces.T_map_surfaces @ SE2.from_array(self.state[:3])

    @property
    def covariance(self) -> Array:
        """Covariance of the pose on the map, (3, 3)."""
        turn = _turn(float(self._surfaces.T_map_surfaces.yaw))
        return np.asarray(turn @ self.P[:POSE, :POSE] @ turn.T)

    def predict(self, T_base_new: SE2, motion: tuple[float, float, float], std: Array) -> None:
        """Move by odometry: the motion, its parts (rot1, trans, rot2) and their standard deviations (3,)."""
        move(self.state, self.P, T_base_new.xyt, motion[0], motion[1], std)

    def correct(self, points_base: Array) -> float:
        """Take in a scan's end points, (n, 2) in the base frame; their NIS (see `nis`).

        A great one is a slip of the wheels: then odometry is not believed and the scan is taken in anew.
        """
        sums, right = self._match(self.state[:POSE], self._offsets(), points_base)
        # Walls come and go before the state is kept: a wall forgotten meanwhile would shift those after it.
        seen = self._admit(np.flatnonzero(sums[:, 9] > 0.0).astype(np.int32))
        x, P = self.state.copy(), self.P.copy()
        found = self._take_in(points_base, seen, sums, right)
        if found > SLIP:
            self.state, self.P = x, P
            self.P[range(POSE), range(POSE)] += SLIP_STD**2
            self._take_in(points_base, seen, sums, right)
        return found

    def _offsets(self) -> Array:
        """The known walls' offsets by patch, 0 for the others, (patches,)."""
        offsets = np.zeros(self._surfaces.patches)
        offsets[self.walls] = self.state[FIXED:]
        return offsets

    def _match(self, pose: Array, offsets: Array, points_base: Array) -> tuple[Array, Array]:
        return match_beams(self._surfaces, pose, points_base, offsets, MATCH_SCALE_M, PATCH_BEAMS)

    def _take_in(self, points_base: Array, seen: NDArray[np.int64], sums: Array, right: Array) -> float:
        """Correct the state by a scan, matched at the predicted pose; `seen` are its walls in the list.

        It is matched once more where that leads, and no more: four matches are no better than two (1.03 cm
        for 1.01, mean of twelve drives).
        """
        offsets, walls = self._offsets(), self.walls[seen]
        state = np.concatenate([range(POSE), FIXED + seen])
        before, prior = self.state[state], self.P[state][:, state].copy()
        x = posterior(before, prior, before, *normal_equations(sums, right, walls, BEAM_STD_M**-2))
        offsets[walls] = x[POSE:]
        sums, right = self._match(x[:POSE], offsets, points_base)
        information, gradient = normal_equations(sums, right, walls, BEAM_STD_M**-2)
        P_predicted = self.P[:POSE, :POSE].copy()
        full_update(self.state, self.P, state, before, x, information, gradient)
        return nis(before[:POSE], P_predicted, self.state[:POSE], self.P[:POSE, :POSE])

    def _admit(self, seen: Indices) -> NDArray[np.int64]:
        """Give every wall in sight a state; where in the list of walls they are."""
        new = seen[self._place[seen] < 0]
        if len(new):
            size, more = len(self.state), len(new)
            P = np.zeros((size + more, size + more))
            P[:size, :size] = self.P
            P[range(size, size + more), range(size, size + more)] = (
                OFFSET_CELLS * self._surfaces.resolution
            ) ** 2
            self.P, self.state = P, np.concatenate([self.state, np.zeros(more)])
            self.walls = np.concatenate([self.walls, new])
            self._place[new] = np.arange(size - FIXED, size - FIXED + more)
        if len(self.walls) > self._most_walls:
            self._forget_all_but(self._place[seen])
        return self._place[seen]

    def _forget_all_but(self, kept: NDArray[np.int64]) -> None:
        states = np.concatenate([range(FIXED), FIXED + kept])
        self.state, self.P = self.state[states], self.P[states][:, states].copy()
        self.walls = self.walls[kept]
        self._place[:] = -1
        self._place[self.walls] = np.arange(len(self.walls))


@njit(cache=True)
def match_beams(
    surfaces: Surfaces, pose: Array, beams: Array, offsets: Array, scale: float, patch_beams: float
) -> tuple[Array, Array]:
    """Sums over the beams of each patch: second order terms (patches, 10), first order ones (patches, 4).

    The residual e of a beam is the distance of its end point from the surface, which stands by the `offset`
    of its patch along the normal from where its cells are; the Jacobian j is with respect to the pose (x, y,
    yaw). Columns: the upper triangle of w j j^T (6), w j (3) and w (1); then w j e (3) and w e (1). Residual
    and weight are those of `linearise`, with s = `scale` [m]; all beams on one patch together weigh at most
    `patch_beams`.
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
        line = (nx, ny, points[k, 0] + offsets[p] * nx, points[k, 1] + offsets[p] * ny)
        end = (beams[i, 0], beams[i, 1])
        residual[i], w, j = linearise((pose[0], pose[1], c, s), end, line, 1.0 / (scale * scale))
        seen[i], weight[i] = p, surfaces.trust[k] * w
        # by a motion along the axes of the surfaces, not of the robot
        jac[i, 0], jac[i, 1], jac[i, 2] = nx, ny, j[2]
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


@njit(cache=True)
def move(x: Array, P: Array, motion: Array, rot1: float, trans: float, std: Array) -> None:
    """Predict x (n,), P (n, n) in place: P <- F P F^T + G diag(std^2) G^T.

    `motion` (x, y, yaw) is odometry's step in the base frame; rot1, trans and `std` (3,) as in `predict`.
    """
    c, s = math.cos(x[2]), math.sin(x[2])
    rx, ry = c * motion[0] - s * motion[1], s * motion[0] + c * motion[1]
    dx, dy = (1.0 + x[3]) * rx, (1.0 + x[3]) * ry
    c, s = math.cos(x[2] + rot1), math.sin(x[2] + rot1)
    G = np.array([[-trans * s, c, 0.0], [trans * c, s, 0.0], [1.0, 0.0, 1.0]])
    yaw = x[2] + (1.0 + x[4]) * motion[2] + x[5] * motion[0]
    x[0], x[1], x[2] = x[0] + dx, x[1] + dy, yaw - 2.0 * np.pi * np.floor((yaw + np.pi) / (2.0 * np.pi))
    for j in range(len(x)):
        P[0, j] += rx * P[3, j] - dy * P[2, j]
        P[1, j] += ry * P[3, j] + dx * P[2, j]
        P[2, j] += motion[2] * P[4, j] + motion[0] * P[5, j]
    for j in range(len(x)):
        P[j, 0] += rx * P[j, 3] - dy * P[j, 2]
        P[j, 1] += ry * P[j, 3] + dx * P[j, 2]
        P[j, 2] += motion[2] * P[j, 4] + motion[0] * P[j, 5]
    for a in range(3):
        P[POSE + a, POSE + a] += ODOMETRY_WALK**2 * abs(trans)
        for b in range(3):
            for k in range(3):
                P[a, b] += G[a, k] * std[k] ** 2 * G[b, k]


@njit(cache=True)
def normal_equations(sums: Array, right: Array, walls: Indices, weight: float) -> tuple[Array, Array]:
    """Information (m, m) and gradient (m,) over pose and offsets in sight, of beams of equal `weight`.

    A residual falls as its wall's offset grows: that Jacobian is -1.
    """
    m = 3 + len(walls)
    information, gradient = np.zeros((m, m)), np.zeros(m)
    for i in range(len(walls)):
        p, o = walls[i], 3 + i
        column = 0
        for a in range(3):
            gradient[a] += weight * right[p, a]
            for b in range(a, 3):
                information[a, b] += weight * sums[p, column]
                column += 1
            information[a, o] = information[o, a] = -weight * sums[p, 6 + a]
        information[o, o] = weight * sums[p, 9]
        gradient[o] = -weight * right[p, 3]
    for a in range(3):
        for b in range(a):
            information[a, b] = information[b, a]
    return information, gradient


@njit(cache=True)
def posterior(before: Array, prior: Array, x: Array, information: Array, gradient: Array) -> Array:
    """State of one Gauss-Newton step, (m,): before + (P^-1 + I)^-1 (I (x - before) - g).

    I and g are the beams' information and gradient at `x`, P the covariance about `before`; written
    without an inverse of P, which may be nearly singular.
    """
    growth = multiply(information, prior) + np.eye(len(prior))  # (P^-1 + I)^-1 = P (1 + I P)^-1
    return before + multiply(prior, solve(growth, _pull(before, x, information, gradient)))[:, 0]


@njit(cache=True)
def _pull(before: Array, x: Array, information: Array, gradient: Array) -> Array:
    """I (x - before) - g as a column, (m, 1)."""
    moved = (x - before).reshape(-1, 1)
    moved[2, 0] = (moved[2, 0] + np.pi) % (2.0 * np.pi) - np.pi
    return multiply(information, moved) - gradient.reshape(-1, 1)


@njit(cache=True)
def full_update(
    x: Array,
    P: Array,
    state: NDArray[np.int64],
    before: Array,
    last: Array,
    information: Array,
    gradient: Array,
) -> None:
    """Carry the update of the states in sight over to all of x (n,) and P (n, n), in place.

    Over the states in sight, all states move by P_s (1 + I P_ss)^-1 u, where u is the pull at the last
    linearisation, and P loses P_s (1 + I P_ss)^-1 I P_s^T.
    """
    n, m = len(x), len(state)
    columns, prior = np.empty((n, m)), np.empty((m, m))
    for j in range(m):
        for i in range(n):
            columns[i, j] = P[i, state[j]]
        for i in range(m):
            prior[i, j] = P[state[i], state[j]]
    pull = _pull(before, last, information, gradient)
    growth = multiply(information, prior) + np.eye(m)
    shares = multiply(columns, solve(growth, np.hstack((pull, information))))
    x += shares[:, 0]
    half = shares[:, 1:]
    rows = columns.T.copy()
    for i in range(n):
        row = P[i, : i + 1]
        for k in range(m):
            factor, other = half[i, k], rows[k]
            for j in range(i + 1):
                row[j] -= factor * other[j]
        for j in range(i):
            P[j, i] = row[j]


@njit(cache=True)
def nis(predicted: Array, P_predicted: Array, corrected: Array, P_corrected: Array) -> float:
    """Normalised innovation squared: a pose's correction over what was expected, per degree of freedom."""
    step = (corrected - predicted).reshape(-1, 1)
    step[2, 0] = (step[2, 0] + np.pi) % (2.0 * np.pi) - np.pi
    expected = P_predicted - P_corrected + NO_STEP**2 * np.eye(3)
    return (step * solve(expected, step)).sum() / POSE


def _turn(yaw: float) -> Array:
    c, s = math.cos(yaw), math.sin(yaw)
    return np.array([[c, -s, 0.0], [s, c, 0.0], [0.0, 0.0, 1.0]])
