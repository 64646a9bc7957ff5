"""Errors of poses in space as evo computes them (Grupp 2017): the same pairs, the same statistics.

Checked against evo itself in tests/reports/test_evo.py.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import TypedDict

import numpy as np
from numpy.typing import NDArray

from turtlebag.datasets.other_systems import covered
from turtlebag.datasets.se2 import SE2, Array
from turtlebag.datasets.se3 import interpolate, inverse, quaternions
from turtlebag.datasets.trajectories_3d import Trajectory3D
from turtlebag.datasets.types import Stamps, neighbours
from turtlebag.reports.metrics.relations import nearest
from turtlebag.reports.metrics.trajectory import fit_rigid

MATCH_NS = 10_000_000
"""Stamps this near are one instant: evo's --t_max_diff."""
ENOUGH = 0.9
"""Where fewer of the sparser one's poses find a partner, the reference is interpolated."""
Pairs = tuple[NDArray[np.int64], NDArray[np.int64]]


class Statistics(TypedDict):
    """Of errors, as evo names them."""

    rmse: float
    mean: float
    median: float
    std: float
    min: float
    max: float


class Relative(TypedDict):
    """Relative pose error: evo's trans_part [m] and angle_deg; None where no pair is that far apart."""

    trans_m: Statistics | None
    rot_deg: Statistics | None


@dataclass(frozen=True, eq=False)
class Paired:
    """Poses of an estimate and of a reference at the same instants; `interpolated`: the reference's."""

    estimate: Trajectory3D
    reference: Trajectory3D
    interpolated: bool = False

    def __len__(self) -> int:
        return len(self.estimate)

    def errors(self) -> Array:
        """Distances between the positions, (n,) [m]: evo_ape."""
        return np.asarray(np.linalg.norm(self.estimate.T[:, :3, 3] - self.reference.T[:, :3, 3], axis=1))

    def fit_in_plane(self) -> SE2:
        """The rigid motion in the plane that brings the estimate nearest."""
        return fit_rigid(self.estimate.T[:, :2, 3], self.reference.T[:, :2, 3])

    def errors_in_plane(self) -> Array:
        """Distances between the positions from above after that fit, (n,) [m]."""
        xy, reference = self.estimate.T[:, :2, 3], self.reference.T[:, :2, 3]
        return np.asarray(np.linalg.norm((self.fit_in_plane() @ xy) - reference, axis=1))

    def aligned(self) -> Paired:
        """After the rigid motion in space that brings the estimate nearest: evo's --align."""
        T = umeyama(self.estimate.T[:, :3, 3], self.reference.T[:, :3, 3])
        return replace(self, estimate=replace(self.estimate, T=T @ self.estimate.T))


def pair(estimate: Trajectory3D, reference: Trajectory3D) -> Paired:
    """Pairs at the same instants, of trajectories in time; empty when there are none.

    As evo does it, each pose of the sparser one with the other's nearest, at most 10 ms away. Where the
    stamps do not meet like this, the reference is interpolated at the estimate's, but never over a gap.
    """
    sparse, dense = (estimate, reference) if len(estimate) <= len(reference) else (reference, estimate)
    near, met = nearest(dense.stamps_ns, sparse.stamps_ns, MATCH_NS)
    first, last = dense.stamps_ns[0], dense.stamps_ns[-1]
    shared = np.count_nonzero((sparse.stamps_ns >= first) & (sparse.stamps_ns <= last))
    if met.sum() > 0 and met.sum() >= ENOUGH * shared:
        chosen = sparse[met], dense[near[met]]
        return Paired(*(chosen if sparse is estimate else chosen[::-1]))
    inside = covered(estimate.stamps_ns, reference.stamps_ns)
    return Paired(estimate[inside], at(reference, estimate.stamps_ns[inside]), interpolated=True)


def at(track: Trajectory3D, stamps: Stamps) -> Trajectory3D:
    """Interpolated poses at stamps within the trajectory's span."""
    low, high, fraction = neighbours(track.stamps_ns, stamps)
    return Trajectory3D(stamps, interpolate(track.T[low], track.T[high], fraction))


def umeyama(xyz_a: Array, xyz_b: Array) -> Array:
    """`T_b_a` (4, 4) minimising sum |b - T_b_a a|^2 over paired points, (n, 3) each (Umeyama 1991)."""
    mean_a, mean_b = xyz_a.mean(axis=0), xyz_b.mean(axis=0)
    u, _, v = np.linalg.svd((xyz_b - mean_b).T @ (xyz_a - mean_a))
    turn = np.diag([1.0, 1.0, np.sign(np.linalg.det(u) * np.linalg.det(v))])
    T = np.eye(4)
    T[:3, :3] = u @ turn @ v
    T[:3, 3] = mean_b - T[:3, :3] @ mean_a
    return T


def statistics(errors: Array) -> Statistics:
    """Of errors, (n,) with n > 0."""
    return {
        "rmse": float(np.sqrt(np.mean(errors**2))),
        "mean": float(errors.mean()),
        "median": float(np.median(errors)),
        "std": float(errors.std()),
        "min": float(errors.min()),
        "max": float(errors.max()),
    }


def rpe(paired: Paired, pairs: Pairs) -> Relative:
    """evo_rpe over pairs of poses (i, j)."""
    i, j = pairs
    if not len(i):
        return {"trans_m": None, "rot_deg": None}
    P, Q = paired.estimate.T, paired.reference.T
    E = inverse(inverse(Q[i]) @ Q[j]) @ (inverse(P[i]) @ P[j])
    q = quaternions(E)
    angle = 2.0 * np.arctan2(np.linalg.norm(q[:, :3], axis=1), np.abs(q[:, 3]))
    moved_m = np.linalg.norm(E[:, :3, 3], axis=1)
    return {"trans_m": statistics(moved_m), "rot_deg": statistics(np.rad2deg(angle))}


def by_frame(count: int) -> Pairs:
    """Each pose and the next: `--delta 1 --delta_unit f`."""
    index = np.arange(max(count - 1, 0), dtype=np.int64)
    return index, index + 1


def by_metre(estimate: Trajectory3D) -> Pairs:
    """Poses a metre of the estimate's path apart, one pair after the other: `--delta 1 --delta_unit m`."""
    steps = np.linalg.norm(np.diff(estimate.T[:, :3, 3], axis=0), axis=1)
    chosen, driven = [0], 0.0
    for index, step in enumerate(steps.tolist(), start=1):
        driven += step
        if driven >= 1.0:
            chosen.append(index)
            driven = 0.0
    ids = np.array(chosen, dtype=np.int64)
    return ids[:-1], ids[1:]
