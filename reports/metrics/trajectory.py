"""Errors of an estimated trajectory against the truth (Sturm et al. 2012, in the plane).

Association is by interpolation: the truth is evaluated at the estimate's own stamps, and stamps
outside the truth's span (plus `SLACK_NS` at both ends) have no truth and are left out.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import TypedDict

import numpy as np

from turtlebag.datasets.se2 import SE2, Array
from turtlebag.datasets.types import Stamps, Trajectory, yaw_difference

SLACK_NS = 50_000_000


@dataclass(frozen=True, eq=False)
class PosePairs:
    """Estimated and true poses at the same stamps, in the estimate's order, (n,) each."""

    stamps_ns: Stamps
    T_map_base: SE2
    T_world_base: SE2

    def __len__(self) -> int:
        return len(self.stamps_ns)

    def position_errors(self) -> Array:
        """Distance between estimated and true positions, (n,) [m]."""
        return np.linalg.norm(self.T_map_base.xy - self.T_world_base.xy, axis=1)

    def yaw_errors(self) -> Array:
        """Absolute difference of the yaws, (n,) [rad]."""
        return yaw_difference(self.T_map_base.yaw, self.T_world_base.yaw)

    def aligned(self) -> PosePairs:
        """The same pairs after the rigid motion that brings the estimate nearest to the truth."""
        T_world_map = fit_rigid(self.T_map_base.xy, self.T_world_base.xy)
        return PosePairs(self.stamps_ns, T_world_map @ self.T_map_base, self.T_world_base)


def associate(estimate: Trajectory, truth: Trajectory) -> PosePairs:
    """The estimate's poses with the interpolated truth; ValueError when their times do not overlap."""
    stamps, first = np.unique(truth.stamps_ns, return_index=True)
    truth = Trajectory(stamps, truth.poses[first])
    inside = (estimate.stamps_ns >= stamps[0] - SLACK_NS) & (estimate.stamps_ns <= stamps[-1] + SLACK_NS)
    if not inside.any():
        raise ValueError("the estimate and the truth share no time")
    kept = estimate.stamps_ns[inside]
    return PosePairs(kept, estimate.poses[inside], truth.at(kept))


def fit_rigid(xy_a: Array, xy_b: Array) -> SE2:
    """`T_b_a` minimising sum |b - T_b_a a|^2 over paired points, (n, 2) each.

    The planar case of Horn 1987 / Umeyama 1991 without scale: with both clouds centred, the best
    yaw is atan2(sum of cross products, sum of dot products).
    """
    mean_a, mean_b = xy_a.mean(axis=0), xy_b.mean(axis=0)
    a, b = xy_a - mean_a, xy_b - mean_b
    yaw = np.arctan2(np.sum(a[:, 0] * b[:, 1] - a[:, 1] * b[:, 0]), np.sum(a * b))
    turned = SE2.from_xyt(0.0, 0.0, yaw) @ mean_a
    return SE2.from_xyt(mean_b[0] - turned[0], mean_b[1] - turned[1], yaw)


class Extremes(TypedDict):
    """Root mean square and largest of some errors, in their unit."""

    rmse: float
    max: float


class Drift(TypedDict):
    """Relative pose error per metre; None for a drive shorter than that."""

    trans_m: float | None
    rot_rad: float | None


class TrajectoryErrors(TypedDict, total=False):
    """What a truth says of the trajectory of a map."""

    ate_m: Extremes
    ate_aligned_m: Extremes
    rpe: Drift


def ate(estimate: Trajectory, truth: Trajectory, align: bool) -> Extremes:
    """Absolute trajectory error, {rmse, max} [m]; `align` fits a rigid motion first."""
    pairs = associate(estimate, truth)
    return summary((pairs.aligned() if align else pairs).position_errors())


def summary(errors: Array) -> Extremes:
    """{rmse, max} of errors, (n,)."""
    return {"rmse": float(np.sqrt(np.mean(errors**2))), "max": float(errors.max())}


def rpe(estimate: Trajectory, truth: Trajectory) -> Drift:
    """Relative pose error per metre driven: RMSE of {trans_m [m/m], rot_rad [rad/m]}.

    Every pose is paired with the first later one that lies a metre of TRUE path ahead;
    E = (T_true_i^-1 T_true_j)^-1 (T_est_i^-1 T_est_j), divided by the true path between the two.
    A run shorter than that has no pair: both are None.
    """
    pairs = associate(estimate, truth)
    order = np.argsort(pairs.stamps_ns, kind="stable")
    T_est, T_true = pairs.T_map_base[order], pairs.T_world_base[order]
    steps = np.linalg.norm(np.diff(T_true.xy, axis=0), axis=1)
    path = np.concatenate([[0.0], np.cumsum(steps)])
    later = np.searchsorted(path, path + 1.0)
    i = np.flatnonzero(later < len(path))
    if len(i) == 0:
        return {"trans_m": None, "rot_rad": None}
    j = later[i]
    error = (T_true[i].inverse() @ T_true[j]).inverse() @ (T_est[i].inverse() @ T_est[j])
    span = path[j] - path[i]
    return {
        "trans_m": float(np.sqrt(np.mean((np.linalg.norm(error.xy, axis=1) / span) ** 2))),
        "rot_rad": float(np.sqrt(np.mean((error.yaw / span) ** 2))),
    }


def trajectory_metrics(estimate: Trajectory, truth: Trajectory) -> TrajectoryErrors:
    """Errors without and with alignment; ValueError when the two share no time."""
    return {
        "ate_m": ate(estimate, truth, align=False),
        "ate_aligned_m": ate(estimate, truth, align=True),
        "rpe": rpe(estimate, truth),
    }


class RecordingMetrics(TypedDict):
    """Scans, duration [s] and distance [m] of a recording, and the errors of /odom at the scans."""

    scans: int
    duration_s: float
    distance_m: float
    odometry_ate_m: Extremes
    odometry_rpe: Drift


def recording_metrics(odometry: Trajectory, truth: Trajectory) -> RecordingMetrics:
    """What a recording holds, by the poses of /odom in its bag and the truth at its scans."""
    at_scans = odometry.sampled(truth.stamps_ns)
    return {
        "scans": len(truth),
        "duration_s": truth.duration(),
        "distance_m": truth.length(),
        "odometry_ate_m": ate(at_scans, truth, align=False),
        "odometry_rpe": rpe(at_scans, truth),
    }
