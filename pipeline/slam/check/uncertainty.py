"""Uncertainty of a finished map's poses, by the covariance of its graph.

Expressed at one point, as motions of the whole plane (see `drift`), every constraint is a spring between two
motions, and the graph's information is the Laplacian of these springs. The constraints are not as good as
they say, as the points of one scan stand in many of them: SPREAD. docs/how-it-maps.md shows what is measured.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
import scipy
from numpy.typing import NDArray

from turtlebag.datasets.durations import seconds
from turtlebag.datasets.motion import way_and_turn
from turtlebag.datasets.se2 import SE2, Array, wrap
from turtlebag.pipeline.slam.graph.constraints import Constraint, Kind
from turtlebag.pipeline.slam.graph.cost import mahalanobis
from turtlebag.pipeline.slam.graph.drift import plane_motions, read_at
from turtlebag.pipeline.slam.graph.marginals import factorised, laplacian, marginals
from turtlebag.pipeline.slam.graph.pose_graph import positive_definite
from turtlebag.pipeline.slam.odometry.track import Track
from turtlebag.pipeline.slam.scans.align import match_information

# This many keys are evaluated, evenly spaced over the log.
ASKED = 50
# By how much the covariance of a constraint is larger than the inverse of its information; standard
# deviations of what all ranges have in common, as a share of them, and of a scan's stamp [s]. With them the
# 95 % ellipses of benchmarks/coverage.py hold as many of the poses.
SPREAD = {
    Kind.STEP: 4.0, Kind.PAIR: 0.6, Kind.LOOP: 0.6, Kind.BORDER: 1.0, Kind.WHEELS: 10.0, Kind.STEADY: 2.0,
}  # fmt: skip
RANGE_SHARE, STAMP_S = 0.004, 0.008
Shared = tuple[NDArray[np.int64], Array]
"""Constraints (k,), and how far one standard deviation of their shared errors moves their ends, in these
ends' frames (k, 3, errors)."""


@dataclass(frozen=True, eq=False)
class Uncertainty:
    """How uncertain a graph of n keys leaves their poses, as motions of the plane about `centre` (2,).

    `weights` (k, 3, 3) are the information of its springs between keys i (k,) and j (k,), `shared` what
    errors in common move all keys (n, 3, errors). The first key is fixed.
    """

    T_keys: Array
    centre: Array
    i: NDArray[np.int64]
    j: NDArray[np.int64]
    weights: Array
    shared: Array
    factors: Any

    @classmethod
    def of(
        cls, T_map_keys: SE2, constraints: Sequence[Constraint], shared: Iterable[Shared] = ()
    ) -> Uncertainty:
        """That of a graph whose constraints (k,) connect all keys to the first.

        A constraint has the weight that its kernel leaves it at these poses. `shared` are errors that many of
        them have in common, see `shared_errors`.
        """
        n = len(T_map_keys)
        # about the centre of the keys: with coordinates of a national grid no digits would be left
        centre = T_map_keys.xy.mean(axis=0)
        T_keys = T_map_keys.xyt - [*centre, 0.0]
        i, j, weights = _springs(SE2(T_keys), constraints)
        # the first key is fixed: its rows and columns are left out
        factors = factorised(laplacian(n, i, j, weights)[3:, 3:]) if n > 1 else None
        found = cls(T_keys, centre, i, j, weights, np.zeros((n, 3, 0)), factors)
        moved = [found._moved_by(*one) for one in shared] if n > 1 else []
        return replace(found, shared=np.concatenate([found.shared, *moved], axis=2))

    def keys(self) -> Array:
        """Covariance of each key about `centre`, (n, 3, 3)."""
        own = marginals(len(self.T_keys), self.i, self.j, self.weights)
        return np.asarray(own + self.shared @ self.shared.transpose(0, 2, 1))

    def position_sigmas(self, most: int = ASKED) -> tuple[NDArray[np.int64], Array]:
        """Up to `most` keys (m,), and the standard deviation [m] of each along its least certain direction.

        A motion of the whole map is excluded, as after a rigid fit.
        """
        n = len(self.T_keys)
        asked = np.unique(np.linspace(0, n - 1, min(n, most)).astype(np.int64))
        if n < 2:
            return asked, np.zeros(n)
        # the motion of the keys less the rigid motion that explains most of it
        x, y, _ = self.T_keys[asked].T
        lever = np.zeros((2 * len(asked), 3))
        lever[0::2, 0] = lever[1::2, 1] = 1.0
        lever[0::2, 2], lever[1::2, 2] = -y, x
        moved = scipy.linalg.block_diag(*lever.reshape(-1, 2, 3))
        rigid = np.linalg.qr(lever)[0]
        moved -= rigid @ (rigid.T @ moved)
        rows = (3 * asked[:, None] + np.arange(3)).ravel()
        own = np.column_stack([self._solved(np.arange(3 * n) == row)[rows] for row in rows])
        together = moved @ self.shared[asked].reshape(3 * len(asked), -1)
        covariance = moved @ own @ moved.T + together @ together.T
        xx, yy, xy = np.diag(covariance)[0::2], np.diag(covariance)[1::2], np.diag(covariance, 1)[0::2]
        largest = 0.5 * (xx + yy) + np.hypot(0.5 * (xx - yy), xy)
        return asked, np.sqrt(np.maximum(largest, 0.0))

    def _solved(self, push: Array | NDArray[np.bool_]) -> Array:
        """The motions (3 n,) of all keys under a push (3 n,)."""
        return np.concatenate([np.zeros(3), self.factors.solve(push[3:].astype(float))])

    def _moved_by(self, of: NDArray[np.int64], errors: Array) -> Array:
        """What shared errors of constraints `of` move all keys, (n, 3, errors)."""
        n, count = len(self.T_keys), errors.shape[2]
        pulls = self.weights[of] @ plane_motions(self.T_keys[self.j[of]]) @ errors
        pushes = np.zeros((n, 3, count))
        np.add.at(pushes, self.j[of], pulls)
        np.subtract.at(pushes, self.i[of], pulls)
        # one by one, because SuperLU solves many at once seven times as slowly
        solved = [self._solved(push) for push in pushes.reshape(3 * n, count).T]
        return np.stack(solved, axis=-1).reshape(n, 3, count)


def scan_covariances(
    uncertainty: Uncertainty, track: Track, T_map_base: SE2, stamps_ns: NDArray[np.int64]
) -> Array:
    """Covariance of the pose of each scan (n,) along the axes of the map, the first one fixed, (n, 3, 3).

    Those of the key scans before and after a scan are blended as their corrections are; to them come its own
    alignment with what the robot drove since the key, and the error of its stamp.
    """
    scans, keys = np.arange(len(T_map_base)), track.keys
    before = np.maximum(np.searchsorted(keys, scans, side="right") - 1, 0)
    after = np.minimum(before + 1, len(keys) - 1)
    f = np.maximum(scans - keys[before], 0) / np.maximum(keys[after] - keys[before], 1)
    of_keys = uncertainty.keys()
    blended = (1.0 - f)[:, None, None] * of_keys[before] + f[:, None, None] * of_keys[after]
    covariance = read_at(blended, T_map_base.xyt - [*uncertainty.centre, 0.0])
    steps = (track.T_track_base[keys[before]].inverse() @ track.T_track_base).xyt
    seen = match_information(track.information) + track.calibration.information(steps)
    turn = plane_motions(T_map_base.xyt * [0.0, 0.0, 1.0])
    own = SPREAD[Kind.STEP] * turn @ np.linalg.inv(seen) @ turn.transpose(0, 2, 1)
    covariance += own * ~np.isin(scans, keys)[:, None, None]
    late = STAMP_S * _velocities(T_map_base, stamps_ns)
    covariance += late[:, :, None] * late[:, None, :]
    covariance[0] = 0.0
    return covariance


def _velocities(T_map_base: SE2, stamps_ns: NDArray[np.int64]) -> Array:
    """Velocity at each scan along the axes of the map [m/s] and in turn [rad/s], (n, 3)."""
    n = len(stamps_ns)
    before, after = np.maximum(np.arange(n) - 1, 0), np.minimum(np.arange(n) + 1, n - 1)
    moved = T_map_base.xyt[after] - T_map_base.xyt[before]
    moved[:, 2] = wrap(moved[:, 2])
    waits = seconds(stamps_ns[after] - stamps_ns[before])
    usual = np.median(waits[1:-1]) if n > 2 else 1.0
    return np.asarray(moved / np.maximum(waits, max(usual, 1e-3))[:, None])


def shared_errors(track: Track, constraints: Sequence[Constraint], unobserved_m: Array) -> Iterator[Shared]:
    """Errors that are the same in many constraints.

    The first is that of the ranges, the next three are the remaining errors of the odometry's calibration.
    Then, for each unobserved stretch
    (`unobserved_m` of each scan's step (n,)), the distance along both axes of the robot: a constant
    velocity was assumed, and is as wrong as it would be elsewhere in this log over as many scans.
    """
    seen = [k for k, c in enumerate(constraints) if c.kind not in (Kind.WHEELS, Kind.STEADY, Kind.BORDER)]
    if seen:
        along = _calibration_effects(np.array([constraints[k].T_i_j for k in seen]))[:, :, :1]
        yield np.array(seen), RANGE_SHARE * along
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
    spread = np.array([SPREAD[c.kind] for c in constraints])
    information = positive_definite(np.array([c.information for c in constraints]).reshape(-1, 3, 3))
    back = np.linalg.inv(plane_motions(T_map_keys.xyt[j]))
    return i, j, (kept / spread)[:, None, None] * (back.transpose(0, 2, 1) @ information @ back)
