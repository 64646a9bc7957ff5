"""What a recording holds, and how far its wheel odometry drifted."""

from __future__ import annotations

from pathlib import Path
from typing import Any

from turtlebag.datasets.bags.reader import read_poses
from turtlebag.datasets.types import Trajectory
from turtlebag.reports.metrics.trajectory import ate, rpe


def recording_metrics(bag: Path, truth_at_scans: Trajectory) -> dict[str, Any]:
    """Scans, duration and distance of a recording, and the errors of /odom at the scans [m]."""
    truth = read_poses(bag, "/ground_truth/odom")
    odometry = read_poses(bag, "/odom")
    at_scans = Trajectory(truth_at_scans.stamps_ns, odometry.at(truth_at_scans.stamps_ns))
    return {
        "scans": len(truth_at_scans),
        "duration_s": truth_at_scans.duration(),
        "distance_m": truth.length(),
        "odometry_ate_m": ate(at_scans, truth, align=False),
        "odometry_rpe": rpe(at_scans, truth),
    }
