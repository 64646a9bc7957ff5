"""KISS-ICP as front end: every scan on the voxel map of those before, by points alone.

It is started from the odometry, and from a steady motion, which alone is left without odometry. In the
line tracker it places the scans that have no surfaces: posts, table legs, thin trunks.
"""

from __future__ import annotations

import numpy as np

from datasets.se2 import Array, compose
from pipeline.slam.align import MOST_POINTS, ROUGH_GATE_M, ROUGH_SIGMA_M, align
from pipeline.slam.clouds import point_information
from pipeline.slam.course import Course
from pipeline.slam.front_end import Placed
from pipeline.slam.odometry import LidarOdometry
from pipeline.slam.track import HYPOTHESES

# A fit must be that much better to prefer a steady motion to the odometry's.
SURELY_BETTER = 0.05
# Standard deviation of a point on the voxel map, in voxels: it is matched with whatever point was kept there.
VOXELS = 0.6
SOURCE = HYPOTHESES.index("kiss-icp")


class KissIcp:
    """KISS-ICP's registration, adaptive threshold and voxel map."""

    def __init__(self, course: Course) -> None:
        self._course = course
        self._kiss: LidarOdometry | None = None
        self._scan = -1

    def step(self, points: Array, odometry_step: Array | None, wait_s: float) -> Placed:
        """As in `FrontEnd`; where the answer does not fit the key scans the expected pose stands."""
        del wait_s
        course = self._course
        if self._kiss is None or self._scan != course.scan - 1:
            self._kiss = self._of_keys()
        self._scan = course.scan
        starts = [] if odometry_step is None else [compose(course.pose, odometry_step)]
        starts.append(compose(course.pose, course.velocity))
        found = [self._kiss.register(points, start) for start in starts]
        fits = [course.fit(points, pose) for pose in found]
        best = int(fits[-1] > fits[0] + SURELY_BETTER)
        if fits[best] < course.config.kiss.min_score:
            self._kiss.update(points, starts[0], starts[0])
            return Placed(starts[0], np.zeros((3, 3)), fits[best])
        self._kiss.update(points, found[best], starts[0])
        return Placed(found[best], self._seen(points, found[best]), fits[best], source=SOURCE)

    def _seen(self, points: Array, pose: Array) -> Array:
        """What a scan at a pose saw of it: on walls by their lines, for points know no blind direction."""
        course, n = self._course, self._course.config.reference_keys
        if course.clouds.placed_by(course.scan) == "points":
            return point_information(points) / (VOXELS * course.config.kiss.voxel_m) ** 2
        keys, poses = np.array(course.keys[-n:]), np.array(course.key_poses[-n:])
        return align(
            course.clouds, course.scan, pose, keys, poses,
            gate=ROUGH_GATE_M, sigma=ROUGH_SIGMA_M, iterations=0, most_points=MOST_POINTS,
        ).information  # fmt: skip

    def _of_keys(self) -> LidarOdometry:
        """KISS-ICP with the map of the last key scans."""
        course = self._course
        kiss, n = LidarOdometry(course.config.kiss, course.max_range), course.config.field_keys
        for key, pose in zip(course.keys[-n:], course.key_poses[-n:], strict=True):
            kiss.update(course.clouds.of(key), pose, pose)
        return kiss
