"""Where one place lies in another, from features alone: FPFH and RANSAC by Open3D."""

from __future__ import annotations

from typing import Any

import numpy as np

from turtlebag.datasets.se2 import Array
from turtlebag.pipeline.slam.open3d_loader import open3d

THINNED, NORMALS, FEATURES, NEAR = 0.5, 2.0, 4.0, 2.0
"""In voxels of the surfels: what clouds are thinned to; reach of normals, features and correspondences."""
ITERATIONS = 20_000


def pose_by_features(source: Array, target: Array, voxel: float, seed: int) -> Array:
    """Pose (4, 4) of points (n, 3) in points (m, 3); the identity for none."""
    o3d = open3d()
    registration = o3d.pipelines.registration
    clouds = [_cloud(points, voxel) for points in (source, target)]
    search = o3d.geometry.KDTreeSearchParamHybrid(FEATURES * voxel, 100)
    features = [registration.compute_fpfh_feature(cloud, search) for cloud in clouds]
    o3d.utility.random.seed(seed % 2**31)
    found = registration.registration_ransac_based_on_feature_matching(
        *clouds,
        *features,
        True,
        NEAR * voxel,
        registration.TransformationEstimationPointToPoint(False),
        3,
        [
            registration.CorrespondenceCheckerBasedOnEdgeLength(0.9),
            registration.CorrespondenceCheckerBasedOnDistance(NEAR * voxel),
        ],
        registration.RANSACConvergenceCriteria(ITERATIONS, 0.999),
    )
    return np.array(found.transformation)


def _cloud(points: Array, voxel: float) -> Any:
    o3d = open3d()
    cloud = o3d.geometry.PointCloud(o3d.utility.Vector3dVector(points)).voxel_down_sample(THINNED * voxel)
    cloud.estimate_normals(o3d.geometry.KDTreeSearchParamHybrid(NORMALS * voxel, 30))
    cloud.orient_normals_towards_camera_location(np.zeros(3))
    return cloud
