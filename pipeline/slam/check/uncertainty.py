"""Position uncertainty of a finished map's key scans, by the covariance of its graph.

Expressed at one point, as motions of the whole plane (see `drift`), every constraint is a spring between two
motions, and the graph's information is the Laplacian of these springs.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Sequence

import numpy as np
import scipy
from numpy.typing import NDArray

from turtlebag.datasets.motion import way_and_turn
from turtlebag.datasets.se2 import SE2, Array
from turtlebag.pipeline.slam.graph.constraints import Constraint, Kind
from turtlebag.pipeline.slam.graph.cost import mahalanobis
from turtlebag.pipeline.slam.graph.drift import covariances, plane_motions
from turtlebag.pipeline.slam.odometry.track import Track

# This many keys are evaluated, evenly spaced over the log.
ASKED = 50
Shared = tuple[NDArray[np.int64], Array]
"""Constraints (k,), and how far one standard deviation of their shared errors moves their ends, in these
ends' frames (k, 3, errors)."""


def position_sigmas(
    T_map_keys: SE2, constraints: Sequence[Constraint], shared: Iterable[Shared] = (), most: int = ASKED
) -> tuple[NDArray[np.int64], Array]:
    """Up to `most` keys (m,), and the standard deviation [m] of each along its least certain direction.

    A motion of the whole map is excluded, as after a rigid fit. A constraint has the weight that its kernel
    leaves it at these poses; constraints (k,) connect all keys to the first. `shared` are errors that many of
    them have in common, see `shared_errors`.
    """
    n = len(T_map_keys)
    # about the centre of the keys: with coordinates of a national grid no digits would be left
    T_map_keys = SE2(T_map_keys.xyt - [*T_map_keys.xy.mean(axis=0), 0.0])
    asked = np.unique(np.linspace(0, n - 1, min(n, most)).astype(np.int64))
    if n < 2:
        return asked, np.zeros(n)
    rows = (3 * asked[:, None] + np.arange(3)).ravel()
    i, j, weights = _springs(T_map_keys, constraints)
    # the first key is fixed: its rows and columns are left out
    symmetric = {"SymmetricMode": True}
    held = _laplacian(n, i, j, weights)[3:, 3:]
    factors = scipy.sparse.linalg.splu(held, "MMD_AT_PLUS_A", diag_pivot_thresh=0.0, options=symmetric)

    def answers(pushes: Iterable[Array]) -> Array:
        # one by one, because SuperLU solves many at once seven times as slowly
        solved = [np.concatenate([np.zeros(3), factors.solve(push[3:])])[rows] for push in pushes]
        return np.column_stack(solved)

    # the motion of the keys less the rigid motion that explains most of it
    lever = np.zeros((2 * len(asked), 3))
    lever[0::2, 0] = lever[1::2, 1] = 1.0
    lever[0::2, 2], lever[1::2, 2] = -T_map_keys.y[asked], T_map_keys.x[asked]
    moved = scipy.linalg.block_diag(*lever.reshape(-1, 2, 3))
    rigid = np.linalg.qr(lever)[0]
    moved -= rigid @ (rigid.T @ moved)
    covariance = moved @ answers((np.arange(3 * n) == row).astype(float) for row in rows) @ moved.T
    for of, errors in shared:
        pulls = weights[of] @ plane_motions(T_map_keys.xyt[j[of]]) @ errors
        pushes = np.zeros((n, 3, errors.shape[2]))
        np.add.at(pushes, j[of], pulls)
        np.subtract.at(pushes, i[of], pulls)
        together = moved @ answers(pushes.reshape(3 * n, -1).T)
        covariance += together @ together.T
    xx, yy, xy = np.diag(covariance)[0::2], np.diag(covariance)[1::2], np.diag(covariance, 1)[0::2]
    largest = 0.5 * (xx + yy) + np.hypot(0.5 * (xx - yy), xy)
    return asked, np.sqrt(np.maximum(largest, 0.0))


def shared_errors(track: Track, constraints: Sequence[Constraint], unobserved_m: Array) -> Iterator[Shared]:
    """Errors that are the same in many constraints.

    The first three are the remaining errors of the odometry's calibration. Then, for each unobserved stretch
    (`unobserved_m` of each scan's step (n,)), the distance along both axes of the robot: a constant
    velocity was assumed, and is as wrong as it would be elsewhere in this log over as many scans.
    """
    odometry = [k for k, c in enumerate(constraints) if c.kind is Kind.WHEELS]
    if odometry:
        effects = _calibration_effects(np.array([constraints[k].T_i_j for k in odometry]))
        yield np.array(odometry), effects @ np.linalg.cholesky(track.calibration.covariance)
    motions = {c.i: k for k, c in enumerate(constraints) if c.kind in (Kind.STEADY, Kind.WHEELS)}
    way = np.diff(np.cumsum(unobserved_m)[track.keys])
    stretches = np.flatnonzero(np.diff(np.concatenate([[0.0], way > 0.0, [0.0]])))
    for begin, end in stretches.reshape(-1, 2).tolist():
        scans = unobserved_m[track.keys[begin] + 1 : track.keys[end] + 1]
        # a log that ends unobserved may have ended anywhere along the way
        last = end == len(way)
        off = 1.0 if last else _unsteadiness(track, unobserved_m, int(np.count_nonzero(scans)))
        keys = [i for i in range(begin, end) if i in motions]
        if keys:
            of = np.array([motions[i] for i in keys])
            yaw = np.array([constraints[k].T_i_j[2] for k in of.tolist()])
            error = np.zeros((len(keys), 3, 2))
            error[:, 0, 0] = error[:, 1, 1] = off * way[keys] * np.cos(yaw)
            error[:, 0, 1] = off * way[keys] * np.sin(yaw)
            error[:, 1, 0] = -error[:, 0, 1]
            yield of, error


def _calibration_effects(steps: Array) -> Array:
    """How far each error of the calibration moves the ends of corrected steps (n, 3), in the ends' frames
    (n, 3, 3)."""
    x, y, yaw = steps.T
    out = np.zeros((len(steps), 3, 3))
    out[:, 0, 0], out[:, 1, 0] = np.cos(yaw) * x + np.sin(yaw) * y, np.cos(yaw) * y - np.sin(yaw) * x
    out[:, 2, 1], out[:, 2, 2] = yaw, x
    return out


def _unsteadiness(track: Track, unobserved_m: Array, scans: int) -> float:
    """The relative error of a constant velocity over this many scans, where all are observed; 1 if there are
    hardly any such stretches."""
    T = track.T_track_base
    step = np.concatenate([[0.0], way_and_turn(T.steps())[:, 0]])
    way, blind = np.cumsum(step), np.cumsum(unobserved_m > 0.0)
    start = np.arange(1, len(step) - scans)
    start = start[blind[start + scans] == blind[start - 1]]
    driven = way[start + scans] - way[start]
    if len(start) < scans or not driven.any():
        return 1.0
    error = driven - scans * step[start]
    return min(1.0, float(np.sqrt(np.mean(error**2) / np.mean(driven**2))))


def _springs(
    T_map_keys: SE2, constraints: Sequence[Constraint]
) -> tuple[NDArray[np.int64], NDArray[np.int64], Array]:
    """The keys (k,) that each constraint connects to others (k,), and its information (k, 3, 3) about motions
    of the plane."""
    i, j = (np.array([getattr(c, end) for c in constraints], dtype=np.int64) for end in "ij")
    cauchy = np.array([c.cauchy for c in constraints])
    # Cauchy's weight, 1 where there is no kernel
    kept = cauchy**2 / np.where(cauchy > 0.0, cauchy**2 + mahalanobis(T_map_keys, constraints), 1.0)
    kept[cauchy == 0.0] = 1.0
    errors = covariances(T_map_keys.xyt, j, [c.information for c in constraints])
    return i, j, kept[:, None, None] * np.linalg.inv(errors)


def _laplacian(n: int, i: NDArray[np.int64], j: NDArray[np.int64], weights: Array) -> scipy.sparse.csc_matrix:
    """The information (3 n, 3 n) of a graph of n keys."""
    blocks = [(i, i, weights), (j, j, weights), (i, j, -weights), (j, i, -weights)]
    cell = np.arange(3)
    rows = np.concatenate([np.repeat(3 * a[:, None] + cell, 3, axis=1).ravel() for a, _, _ in blocks])
    columns = np.concatenate([np.tile(3 * b[:, None] + cell, 3).ravel() for _, b, _ in blocks])
    values = np.concatenate([w.ravel() for _, _, w in blocks])
    return scipy.sparse.csc_matrix((values, (rows, columns)), shape=(3 * n, 3 * n))
