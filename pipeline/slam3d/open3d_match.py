"""Open3D's opinion on a loop: FPFH and RANSAC where nothing tells the pose, then ICP, then tests.

What leaves here is rounded to what an opinion is worth.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from pydantic import BaseModel, ConfigDict, Field

from turtlebag.datasets import se3
from turtlebag.datasets.se2 import Array
from turtlebag.pipeline.slam.open3d_loader import open3d

DECIMALS = 4


class MatchConfig(BaseModel):
    """Open3D's registration; lengths in voxels of the surfels."""

    model_config = ConfigDict(extra="forbid", frozen=True)
    voxels: float = Field(default=0.5, gt=0.0, description="both clouds are thinned to this")
    feature_voxels: float = Field(default=4.0, gt=0.0, description="radius of the FPFH features")
    ransac_iterations: int = Field(default=20_000, gt=0)
    coarse_voxels: float = Field(default=2.0, gt=0.0, description="correspondences of the first ICP")
    fine_voxels: float = Field(default=0.5, gt=0.0, description="and of the second, which is tested")
    min_fitness: float = Field(default=0.6, gt=0.0, le=1.0, description="of the new cloud in the old place")
    min_overlap: float = Field(default=0.35, gt=0.0, le=1.0, description="of the old place in the new cloud")


@dataclass(frozen=True, eq=False)
class Match:
    """Pose of the source in the target (4, 4), shares matched of either, and why it is not believed."""

    T: Array
    fitness: float
    overlap: float
    problem: str


class Matcher:
    """Compares places given as points."""

    def __init__(self, config: MatchConfig, voxel: float) -> None:
        self._o3d, self._config, self._voxel = open3d(), config, voxel
        self._registration: Any = self._o3d.pipelines.registration

    def match(self, source: Array, target: Array, T_guess: Array, *, anywhere: bool, seed: int) -> Match:
        """Register points (n, 3) in points (m, 3): from the guess, or with `anywhere` from features alone
        (the guess then only competes)."""
        config, voxel = self._config, self._voxel
        a, b = self._cloud(source), self._cloud(target)
        starts = [T_guess, self._global(a, b, seed)] if anywhere else [T_guess]
        results = [self._icp(a, b, start) for start in starts]
        best = max(results, key=lambda result: round(result.fitness, DECIMALS))
        T = np.array(best.transformation)
        back = self._registration.evaluate_registration(b, a, config.fine_voxels * voxel, np.linalg.inv(T))
        fitness, overlap = round(best.fitness, DECIMALS), round(back.fitness, DECIMALS)
        problem = ""
        if fitness < config.min_fitness:
            problem = "open3d: low fitness"
        elif overlap < config.min_overlap:
            problem = "open3d: low overlap"
        return Match(se3.exp(np.round(se3.log(T), DECIMALS)), fitness, overlap, problem)

    def _cloud(self, points: Array) -> Any:
        cloud = self._o3d.geometry.PointCloud()
        cloud.points = self._o3d.utility.Vector3dVector(points)
        cloud = cloud.voxel_down_sample(self._config.voxels * self._voxel)
        search = self._o3d.geometry.KDTreeSearchParamHybrid(2.0 * self._voxel, 30)
        cloud.estimate_normals(search)
        cloud.orient_normals_towards_camera_location(np.zeros(3))
        return cloud

    def _global(self, a: Any, b: Any, seed: int) -> Array:
        registration, config = self._registration, self._config
        radius = config.feature_voxels * self._voxel
        search = self._o3d.geometry.KDTreeSearchParamHybrid(radius, 100)
        features = [registration.compute_fpfh_feature(cloud, search) for cloud in (a, b)]
        reach = config.coarse_voxels * self._voxel
        self._o3d.utility.random.seed(seed)
        found = registration.registration_ransac_based_on_feature_matching(
            a,
            b,
            *features,
            True,
            reach,
            registration.TransformationEstimationPointToPoint(False),
            3,
            [
                registration.CorrespondenceCheckerBasedOnEdgeLength(0.9),
                registration.CorrespondenceCheckerBasedOnDistance(reach),
            ],
            registration.RANSACConvergenceCriteria(config.ransac_iterations, 0.999),
        )
        return np.asarray(found.transformation)

    def _icp(self, a: Any, b: Any, start: Array) -> Any:
        registration, result = self._registration, None
        for reach, most in ((self._config.coarse_voxels, 30), (self._config.fine_voxels, 30)):
            result = registration.registration_icp(
                a,
                b,
                reach * self._voxel,
                start if result is None else result.transformation,
                registration.TransformationEstimationPointToPlane(),
                registration.ICPConvergenceCriteria(max_iteration=most),
            )
        return result
