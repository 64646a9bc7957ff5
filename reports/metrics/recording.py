"""What a recording holds, and how far its wheel odometry drifted."""

from __future__ import annotations

from typing import TypedDict

from turtlebag.datasets.types import Trajectory
from turtlebag.reports.metrics.trajectory import Drift, Extremes, ate, rpe


class RecordingMetrics(TypedDict):
    """Scans, duration [s] and distance [m] of a recording, and the errors of /odom at the scans."""

    scans: int
    duration_s: float
    distance_m: float
    odometry_ate_m: Extremes
    odometry_rpe: Drift


def recording_metrics(
    truth: Trajectory, odometry: Trajectory, truth_at_scans: Trajectory
) -> RecordingMetrics:
    """What a recording holds, by the true poses and those of /odom in its bag, and the truth at its scans."""
    at_scans = odometry.sampled(truth_at_scans.stamps_ns)
    return {
        "scans": len(truth_at_scans),
        "duration_s": truth_at_scans.duration(),
        "distance_m": truth.length(),
        "odometry_ate_m": ate(at_scans, truth, align=False),
        "odometry_rpe": rpe(at_scans, truth),
    }
