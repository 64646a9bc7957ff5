"""Relative pose of two places from features alone: FPFH and RANSAC by Open3D."""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np

from turtlebag.datasets.open3d_loader import open3d
from turtlebag.datasets.se2 import Array

THINNED, NEAR = 0.5, 2.0
"""In voxels of the surfels: what clouds are thinned to, and the reach of normals and matches; features
reach twice as far."""
ITERATIONS = 20_000


class Featured(NamedTuple):
    """Open3D's thinned cloud of a place, and a feature for each of its points."""

    cloud: Any
    features: Any


def featured(points: Array, voxel: float) -> Featured:
    """Points (n, 3) with their FPFH features."""
    o3d = open3d()
    cloud = o3d.geometry.PointCloud(o3d.utility.Vector3dVector(points)).voxel_down_sample(THINNED * voxel)
    cloud.estimate_normals(o3d.geometry.KDTreeSearchParamHybrid(NEAR * voxel, 30))
    cloud.orient_normals_towards_camera_location(np.zeros(3))
    search = o3d.geometry.KDTreeSearchParamHybrid(2.0 * NEAR * voxel, 100)
    return Featured(cloud, o3d.pipelines.registration.compute_fpfh_feature(cloud, search))


def pose_by_features(source: Featured, target: Featured, voxel: float, seed: int) -> Array:
    """Pose (4, 4) of one place in another; the identity for none."""
    o3d = open3d()
    registration = o3d.pipelines.registration
    o3d.utility.random.seed(seed % 2**31)
    found = registration.registration_ransac_based_on_feature_matching(
        source.cloud,
        target.cloud,
        source.features,
        target.features,
        True,
        NEAR * voxel,
        registration.TransformationEstimationPointToPoint(False),
        3,
        [
            registration.CorrespondenceCheckerBasedOnEdgeLength(),
            registration.CorrespondenceCheckerBasedOnDistance(NEAR * voxel),
        ],
        registration.RANSACConvergenceCriteria(ITERATIONS),
    )
    return np.array(found.transformation)
