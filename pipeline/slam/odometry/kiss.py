"""KISS-ICP as front end: every scan is registered point-to-point on the voxel map of the earlier ones.

Vizzo et al. (2023), "KISS-ICP: In Defense of Point-to-Point ICP". Its pipeline has no odometry input, so
its components are used - voxel map, adaptive threshold, registration - started from the odometry and from
constant velocity (without odometry, from the latter alone). One thread, for reproducible results. All points
of a scan are registered: downsampled as KISS-ICP does for a hundred thousand points, the few of a planar
lidar are half as accurate (CSAIL: a step is off by 3.3 cm, with all points by 1.5 cm). In the line tracker
it registers the scans without surfaces: posts, table legs, thin trunks.
"""

from __future__ import annotations

import numpy as np

from turtlebag.datasets import se3
from turtlebag.datasets.se2 import SE2, Array, compose
from turtlebag.pipeline.slam.odometry.front_end import Placed
from turtlebag.pipeline.slam.odometry.track import HYPOTHESES
from turtlebag.pipeline.slam.odometry.tracker import Tracker
from turtlebag.pipeline.slam.scans.align import align
from turtlebag.pipeline.slam.scans.clouds import point_information
from turtlebag.pipeline.slam.scans.correspondences import Limits

# Voxel of the map [m]; smaller ones lose track. KISS-ICP's own defaults, for voxels of 1 m, scale with it.
VOXEL_M = 0.2
# Share of a scan that must fit for its pose to be accepted; the pose from another start must be better by
# this share.
MIN_FIT, SURELY_BETTER = 0.4, 0.05
# Points are matched up to this many times KISS-ICP's threshold apart.
SIGMAS = 3.0
# Standard deviation of a point of the voxel map, in voxels: a point is matched with whichever one was kept
# there.
VOXELS = 0.6
SOURCE = HYPOTHESES.index("kiss-icp")


class KissIcp:
    """KISS-ICP's registration, adaptive threshold and voxel map."""

    def __init__(self, tracker: Tracker) -> None:
        self._tracker = tracker
        self._kiss: LidarOdometry | None = None
        self._scan = -1

    def step(self, points: Array, odometry_step: Array | None, wait_s: float) -> Placed:
        """As in `FrontEnd`; if the result does not fit the key scans, the predicted pose is returned."""
        del wait_s
        tracker = self._tracker
        if self._kiss is None or self._scan != tracker.scan - 1:
            self._kiss = self._of_keys()
        self._scan = tracker.scan
        starts = [] if odometry_step is None else [compose(tracker.pose, odometry_step)]
        starts.append(compose(tracker.pose, tracker.velocity))
        found = [self._kiss.register(points, start) for start in starts]
        fits = [tracker.fit(points, pose) for pose in found]
        best = int(fits[-1] > fits[0] + SURELY_BETTER)
        if fits[best] < MIN_FIT:
            self._kiss.update(points, starts[0], starts[0])
            return Placed(starts[0], np.zeros((3, 3)), fits[best])
        self._kiss.update(points, found[best], starts[0])
        return Placed(found[best], self._seen(points, found[best]), fits[best], source=SOURCE)

    def _seen(self, points: Array, pose: Array) -> Array:
        """The information of a scan at a pose: from lines on walls, because point matches have no blind
        direction."""
        tracker = self._tracker
        if tracker.clouds.placed_by(tracker.scan) == "points":
            return point_information(points) / (VOXELS * VOXEL_M) ** 2
        keys, poses = tracker.last_keys()
        as_is = Limits.rough().of_one_scan(iterations=0)
        return align(tracker.clouds, tracker.scan, pose, keys, poses, as_is).information

    def _of_keys(self) -> LidarOdometry:
        """KISS-ICP with the map of the last key scans."""
        tracker = self._tracker
        kiss = LidarOdometry(tracker.max_range)
        for key, pose in zip(*tracker.field_keys(), strict=True):
            kiss.update(tracker.clouds.of(key), pose, pose)
        return kiss


class LidarOdometry:
    """KISS-ICP's registration and local map, in the caller's frame; returns up to `max_range` [m].

    Points (n, 2) with poses (3,), or points (n, 3) in space with poses (4, 4).
    """

    def __init__(self, max_range: float, voxel: float = VOXEL_M) -> None:
        from kiss_icp.config import KISSConfig
        from kiss_icp.mapping import VoxelHashMap
        from kiss_icp.registration import Registration
        from kiss_icp.threshold import get_threshold_estimator
        from kiss_icp.voxelization import voxel_down_sample

        kiss = KISSConfig()
        kiss.data.max_range = max_range
        kiss.adaptive_threshold.initial_threshold *= voxel
        kiss.adaptive_threshold.min_motion_th *= voxel
        own = kiss.registration
        self._voxel, self._thinned = voxel, voxel_down_sample
        self._map = VoxelHashMap(voxel, max_range, kiss.mapping.max_points_per_voxel)
        self._threshold = get_threshold_estimator(kiss)
        self._registration = Registration(
            own.max_num_iterations, own.convergence_criterion, max_num_threads=1
        )

    @property
    def search_radius(self) -> float:
        """A third of the distance within which points are matched [m], by how wrong the guesses were."""
        return float(self._threshold.get_threshold())

    def register(self, points: Array, T_map_guess: Array) -> Array:
        """Pose of a scan's points against the local map, started at a guess."""
        if self._map.empty() or len(points) < 3:
            return T_map_guess
        plane = points.shape[1] == 2
        source = _in_space(points) if plane else self._thinned(points, 1.5 * self._voxel)
        sigma = self.search_radius
        guess = _matrix(T_map_guess)
        pose = self._registration.align_points_to_map(source, self._map, guess, SIGMAS * sigma, sigma)
        if not np.all(np.isfinite(pose)):
            return T_map_guess
        if not plane:
            return np.asarray(pose)
        axes = [0, 1, 3]
        return SE2.from_matrix(np.vstack([pose[:2, axes], [0.0, 0.0, 1.0]])).xyt

    def update(self, points: Array, T_map_base: Array, T_map_guess: Array) -> None:
        """Add the scan to the map at its final pose; the guess it started from tunes the threshold."""
        self._threshold.update_model_deviation(np.linalg.inv(_matrix(T_map_guess)) @ _matrix(T_map_base))
        self._map.update(self._thinned(_in_space(points), 0.5 * self._voxel), _matrix(T_map_base))


def _in_space(points: Array) -> Array:
    return points if points.shape[1] == 3 else np.column_stack([points, np.zeros(len(points))])


def _matrix(pose: Array) -> Array:
    return pose if pose.shape == (4, 4) else se3.lifted(SE2(pose))
