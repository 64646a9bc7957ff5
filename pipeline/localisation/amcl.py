"""Adaptive Monte Carlo localisation (AMCL): the robot's pose on a known map, and so the frame `odom`.

Fox 2003 (KLD-sampling), Thrun, Burgard, Fox: Probabilistic Robotics, chapters 4, 6 and 8 (augmented MCL).
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from turtlebag.datasets.grid import OccupancyGrid
from turtlebag.datasets.se2 import SE2, Array, wrap
from turtlebag.datasets.types import LidarSpec, MountedLidar, Scan
from turtlebag.pipeline.localisation import motion_model
from turtlebag.pipeline.localisation.deskewed_beams import Beams, prepare
from turtlebag.pipeline.localisation.estimate import Estimate, main_cluster, narrow
from turtlebag.pipeline.localisation.fine_pose import FinePose, agree
from turtlebag.pipeline.localisation.global_search import global_search
from turtlebag.pipeline.localisation.likelihood_field import LikelihoodField
from turtlebag.pipeline.localisation.lost_detection import ALIKE, DIFFERENT, AgreementWatch
from turtlebag.pipeline.localisation.parameters import AmclConfig
from turtlebag.pipeline.localisation.resampling import Cloud


@dataclass
class _Located:
    """The last update: odometry, and the estimate of the cloud then; None before."""

    T_odom_base: SE2 | None = None
    T_map_odom: SE2 | None = None
    estimate: Estimate | None = None


class Amcl:
    """Particle filter over the base's pose in `map`; its one output is `T_map_odom`.

    It has no pose until `initialise` or `initialise_globally` was called and a scan was taken in.
    """

    def __init__(
        self,
        grid: OccupancyGrid,
        lidar: LidarSpec,
        T_base_lidar: SE2,
        config: AmclConfig,
        rng: np.random.Generator,
        others: Sequence[MountedLidar] = (),
    ) -> None:
        """`others` are further lidars, whose scans have the `sensor` 1 and on."""
        self.config = config
        self.search = global_search(grid, lidar, config)
        """How well the map explains a scan from any pose."""
        self.searches = 0
        """How often poses from a search were used."""
        self.beams: Beams | None = None
        """The scan of the last update; None before the first."""
        self.watch = AgreementWatch(config)
        self.cloud = Cloud.even(np.zeros((0, 3)))
        """The particles, in the map frame."""
        self._lidars = MountedLidar(lidar, T_base_lidar), *others
        self._due: set[int] = set()
        self._sensor = LikelihoodField(config, self.search.field, self.search.range_max)
        self._fine = FinePose(grid) if config.refine else None
        self._rng = rng
        self._at = _Located()

    @property
    def initialised(self) -> bool:
        """Whether the filter was initialised, with a pose or globally."""
        return self.size > 0

    @property
    def converged(self) -> bool:
        """Whether the whole cloud is one narrow cluster."""
        return self._at.estimate is not None and self._at.estimate.narrow

    @property
    def T_map_odom(self) -> SE2:
        """Odometry's frame on the map; ValueError before the first update."""
        if self._at.T_map_odom is None:
            raise ValueError("the filter has no pose yet: initialise it and update it with a scan")
        return self._at.T_map_odom

    def T_map_base(self, T_odom_base: SE2) -> SE2:
        """The estimate now, given odometry now."""
        return self.T_map_odom @ T_odom_base

    @property
    def covariance(self) -> Array:
        """Covariance of the estimate at the last update, (3, 3): x, y, yaw.

        It is that of the whole cloud until that has converged, and as much more as at the start while scans
        disagree with the map.
        """
        if self._at.estimate is None:
            raise ValueError("the filter has no pose yet: initialise it and update it with a scan")
        fine = None if self._fine is None or not self.converged else self._fine.covariance
        found = self._at.estimate.covariance if fine is None else fine
        c = self.config
        start = np.diag([c.initial_cov_xx, c.initial_cov_yy, c.initial_cov_aa])
        return found if self.agrees else found + start

    @property
    def particles(self) -> SE2:
        """The cloud in the map frame, (n,)."""
        return SE2(self.cloud.poses.copy())

    @property
    def size(self) -> int:
        """How many particles there are."""
        return len(self.cloud.poses)

    @property
    def agreement(self) -> float:
        """Share 0..1 of recent scans that the map explains at the estimate."""
        return self.watch.fast

    @property
    def agrees(self) -> bool:
        """Whether recent scans agree with the map at the estimate as well as earlier ones."""
        return self.watch.random_share() == 0.0

    @property
    def lost(self) -> bool:
        """Whether the cloud is wide, or scans no longer agree with the map at the estimate."""
        return not (self.converged and self.agrees)

    def initialise(
        self, T_map_base: SE2, covariance: Array | None = None, T_odom_base: SE2 | None = None
    ) -> None:
        """Draw the cloud around a pose estimate (covariance (3, 3), default: initial_cov_*).

        With `T_odom_base`, the current odometry, `T_map_odom` is set at once; otherwise the pose is that of
        the next scan.
        """
        c = self.config
        if covariance is None:
            covariance = np.diag([c.initial_cov_xx, c.initial_cov_yy, c.initial_cov_aa])
        noise = self._rng.multivariate_normal(np.zeros(3), covariance, size=c.max_particles, method="eigh")
        poses = T_map_base.xyt + noise
        poses[:, 2] = wrap(poses[:, 2])
        self._restart(poses, AgreementWatch(c))
        if T_odom_base is not None:
            self._at = _Located(T_odom_base, T_map_base @ T_odom_base.inverse())

    def initialise_globally(self) -> None:
        """Forget the pose: the next scan is compared with the whole free space."""
        poses = self.search.uniform(self.config.max_particles, self._rng)
        self._restart(poses, AgreementWatch(self.config, anywhere=True))

    def update(self, scan: Scan, T_odom_base: SE2, T_odom_base_end: SE2 | None = None) -> bool:
        """Update with a scan; True if the filter used it, False if the robot has hardly moved since it used
        one of that lidar.

        `T_odom_base` is the odometry at the scan's stamp, `T_odom_base_end` at the end of the sweep (stamp +
        n_beams * time_increment), used for deskewing. ValueError if the filter is not initialised or the
        odometry is not finite.
        """
        self._check(T_odom_base)
        last = self._at.T_odom_base
        T_last_base = None if last is None else last.inverse() @ T_odom_base
        if self._moved_enough(T_last_base):
            self._due = set(range(len(self._lidars)))
        if scan.sensor not in self._due:
            return False
        self._due.discard(scan.sensor)
        T_base_odom = T_odom_base.inverse()
        sweep = None if T_odom_base_end is None else T_base_odom @ T_odom_base_end
        beams = self._prepare(scan, sweep)
        if T_last_base is not None:
            self._predict(T_last_base)
        self._at.T_odom_base, self.beams = T_odom_base, beams
        if len(beams) > 0:
            self._weigh(beams)
            self._resample(beams)
        self._estimate_pose(beams, T_base_odom)
        return True

    def contradicted(self, scan: Scan, T_odom_base: SE2, T_odom_base_end: SE2) -> bool:
        """Whether a scan, used or not, contradicts the estimate: the map explains far less of it than
        usual."""
        if self._at.T_map_odom is None:
            return False
        beams = self._prepare(scan, T_odom_base.inverse() @ T_odom_base_end)
        return self.watch.contradicted_by(self.search.agreement(self.T_map_base(T_odom_base).xyt, beams))

    def _prepare(self, scan: Scan, T_start_end: SE2 | None) -> Beams:
        lidar = self._lidars[scan.sensor]
        return prepare(scan, lidar.T_base_lidar, T_start_end, self.config.range_limits(lidar.spec))

    def _restart(self, poses: Array, watch: AgreementWatch) -> None:
        self.cloud, self._at, self.watch = Cloud.even(poses), _Located(), watch
        if self._fine is not None:
            self._fine.forget()

    def _check(self, T_odom_base: SE2) -> None:
        if not self.initialised:
            raise ValueError("the filter has no initial pose")
        if not np.isfinite(T_odom_base.xyt).all():
            raise ValueError("odometry is not finite")

    def _moved_enough(self, T_last_base: SE2 | None) -> bool:
        if self.watch.updates == 0 or T_last_base is None:
            return True
        x, y, yaw = T_last_base.xyt.tolist()
        return math.hypot(x, y) >= self.config.update_min_d or abs(yaw) >= self.config.update_min_a

    def _predict(self, T_last_base: SE2) -> None:
        """Move cloud and fine pose by odometry since the last update."""
        c = self.config
        step = motion_model.decompose(T_last_base)
        std = motion_model.noise_std(step, (c.alpha1, c.alpha2, c.alpha3, c.alpha4))
        poses = self.cloud.poses
        motion_model.move(poses, step, self._rng.standard_normal(poses.shape) * std)
        if self._fine is not None:
            self._fine.predict(T_last_base, step, std)

    def _weigh(self, beams: Beams) -> None:
        likelihood = self.search.log_likelihood if self.lost else self._sensor.weigh
        self.cloud = self.cloud.weighed(likelihood(self.cloud.poses, beams))

    def _resample(self, beams: Beams) -> None:
        share = self.watch.search_share()
        if share > 0.0:
            self.cloud = self.cloud.resampled(self.config, self._rng, self._found(share, beams), share)
        elif self.cloud.due(self.config, self.watch.updates + 1):
            self.cloud = self.cloud.resampled(self.config, self._rng)

    def _found(self, share: float, beams: Beams) -> Array | None:
        """Poses from a search, in random order; None if they explain the scan hardly better than the estimate
        does.

        The neighbourhood is searched first: wheels slip more often than robots are kidnapped, and many
        buildings have a distant place that looks like this one. Where the search leads back to the estimate,
        it is the scans that are worse than expected.
        """
        count, at = int(share * self.config.max_particles) + 1, self._at
        if at.T_map_odom is None or at.T_odom_base is None or self.watch.anywhere:
            self.searches += 1
            return self.search.draw(count, beams, self._rng)
        here = at.T_map_odom @ at.T_odom_base
        near = self.search.draw(count, beams, self._rng, here.xyt)
        far = self.search.draw(count, beams, self._rng)
        (place, gain_near), (_, gain_far) = (self._place_of(found, beams) for found in (near, far))
        found, gain = (near, gain_near) if gain_near > gain_far - ALIKE else (far, gain_far)
        if gain <= self.search.agreement(here.xyt, beams) + DIFFERENT:
            if not self.agrees and narrow(place.core) and agree(here, place):
                self.watch.confirm()
            return None
        self.searches += 1
        return found

    def _place_of(self, poses: Array, beams: Beams) -> tuple[Estimate, float]:
        """The main cluster of equally likely poses (n, 3), and the agreement of scan and map there."""
        there = main_cluster(poses, Cloud.even(poses).weights)
        return there, self.search.agreement(there.T_map_base.xyt, beams)

    def _estimate_pose(self, beams: Beams, T_base_odom: SE2) -> None:
        estimate = main_cluster(self.cloud.poses, self.cloud.weights)
        T_map_base = estimate.T_map_base
        if self._fine is not None:
            T_map_base = self._fine.correct(estimate, beams.points)
        self._at.estimate, self._at.T_map_odom = estimate, T_map_base @ T_base_odom
        self.watch.update(self.search.agreement(T_map_base.xyt, beams))
