"""Open3D's ICP: a loop matcher, and the matcher for scans without surfaces."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np

from turtlebag.datasets.open3d_loader import open3d
from turtlebag.datasets.se2 import SE2, Array
from turtlebag.pipeline.slam.scans.clouds import point_information

# Fewer points matched are no match.
LEAST_MATCHES = 8
# Standard deviation of a point on a post, because it is seen from different sides.
POINT_SIGMA_M = 0.02


@dataclass(frozen=True, eq=False)
class PointMatch:
    """Points on points: `T_target_source` (3,), the share of source points matched, their rms [m], and
    the information (3, 3) about the pose, in the source frame."""

    T_target_source: Array
    overlap: float
    rmse: float
    information: Array


def match_points(
    source: Array, target: Array, T_target_source: Array, gate: float, iterations: int = 20
) -> PointMatch:
    """Points (n, 2) matched with points (m, 2), started at `T_target_source` (3,); `gate` in metres.

    Point-to-point ICP (Besl and McKay 1992) as Open3D has it, imported when first asked.
    """
    registration = open3d().pipelines.registration
    start = np.eye(4)
    start[:2, :2] = SE2(T_target_source).matrix()[:2, :2]
    start[:2, 3] = T_target_source[:2]
    result = registration.registration_icp(
        _cloud(source),
        _cloud(target),
        gate,
        start,
        registration.TransformationEstimationPointToPoint(),
        registration.ICPConvergenceCriteria(max_iteration=iterations),
    )
    pose = SE2.from_matrix(np.asarray(result.transformation)).xyt
    matched = source[np.asarray(result.correspondence_set).reshape(-1, 2)[:, 0]]
    if len(matched) < LEAST_MATCHES:
        return PointMatch(pose, 0.0, 0.0, np.zeros((3, 3)))
    information = point_information(matched) / POINT_SIGMA_M**2
    return PointMatch(pose, float(result.fitness), float(result.inlier_rmse), information)


def _cloud(points: Array) -> Any:
    cloud = open3d().geometry.PointCloud()
    cloud.points = open3d().utility.Vector3dVector(np.column_stack([points, np.zeros(len(points))]))
    return cloud
