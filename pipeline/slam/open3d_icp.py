"""A second opinion on a loop: Open3D's ICP, another algorithm on the same points."""

from __future__ import annotations

import numpy as np

from datasets.se2 import SE2, Array
from pipeline.slam.open3d_loader import open3d
from pipeline.slam.tracking import between

CORRESPONDENCE_M = 0.15
MIN_FITNESS = 0.6
MAX_SHIFT_M, MAX_TURN_RAD = 0.08, 0.03


class IcpCheck:
    """Point-to-point ICP from a given alignment must stay there and keep most points matched."""

    def __init__(self) -> None:
        self._o3d = open3d()

    def agrees(self, source: Array, target: Array, T_target_source: Array) -> bool:
        """Whether ICP, started at `T_target_source` (3,), converges next to it; points are (n, 2)."""
        registration = self._o3d.pipelines.registration
        start = np.eye(4)
        start[:2, :2] = SE2(T_target_source).matrix()[:2, :2]
        start[:2, 3] = T_target_source[:2]
        result = registration.registration_icp(
            self._cloud(source),
            self._cloud(target),
            CORRESPONDENCE_M,
            start,
            registration.TransformationEstimationPointToPoint(),
            registration.ICPConvergenceCriteria(max_iteration=20),
        )
        shift = between(T_target_source, SE2.from_matrix(np.asarray(result.transformation)).xyt)
        return bool(
            result.fitness >= MIN_FITNESS
            and np.hypot(shift[0], shift[1]) < MAX_SHIFT_M
            and abs(shift[2]) < MAX_TURN_RAD
        )

    def _cloud(self, points: Array):  # type: ignore[no-untyped-def]
        cloud = self._o3d.geometry.PointCloud()
        flat = np.column_stack([points, np.zeros(len(points))])
        cloud.points = self._o3d.utility.Vector3dVector(flat)
        return cloud
