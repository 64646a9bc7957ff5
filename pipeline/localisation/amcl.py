"""Adaptive Monte Carlo localisation: where on a known map is the robot, and so where is `odom`.

Fox 2003 (KLD-sampling), Thrun, Burgard, Fox: Probabilistic Robotics, chapters 4, 6 and 8 (augmented MCL).
"""

from __future__ import annotations

import math

import numpy as np

from turtlebag.datasets.grid import OccupancyGrid
from turtlebag.datasets.se2 import SE2, Array, wrap
from turtlebag.datasets.types import LidarSpec, Scan
from turtlebag.pipeline.localisation import motion, sampling
from turtlebag.pipeline.localisation.beams import Beams, prepare
from turtlebag.pipeline.localisation.estimate import Estimate, main_cluster
from turtlebag.pipeline.localisation.field import distance_field
from turtlebag.pipeline.localisation.fine_pose import FinePose
from turtlebag.pipeline.localisation.free_space import FreeSpace
from turtlebag.pipeline.localisation.global_search import GlobalSearch
from turtlebag.pipeline.localisation.parameters import AmclConfig
from turtlebag.pipeline.localisation.push_detection import StandingWatch
from turtlebag.pipeline.localisation.sensor import LikelihoodField

# Agreement of scan and map at the right place, before anything was seen: where both averages start.
NOMINAL_AGREEMENT = 0.8
# Random particles are mixed in from this share on (less is people and boxes in view), and at most so many.
LEAST_STRANGERS, MOST_STRANGERS = 0.25, 0.5
# A place found by a search must explain so much more of the scan than where the robot seems to be.
BETTER_BY = 0.1
# A place found far away must explain so much more of the scan than one near by.
NEARER_BY = 0.05
# Filter updates from one search to the next while lost.
FIRST_PAUSE, LONGEST_PAUSE = 2, 64
# Agreement below this part of the best so far is worth a second look, so many updates apart.
FADED, SECOND_LOOK_PAUSE = 0.9, 24

# A single scan of which the map explains less than this part of the usual share speaks against the estimate.
CONTRADICTED = 0.7


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
    ) -> None:
        self.config = config
        self._rng = rng
        self._T_base_lidar = T_base_lidar
        self._limits = (
            config.laser_min_range if config.laser_min_range >= 0.0 else lidar.range_min,
            min(config.laser_max_range, lidar.range_max)
            if config.laser_max_range >= 0.0
            else lidar.range_max,
        )
        self._field = distance_field(grid, config.likelihood_max_dist)
        self._sensor = LikelihoodField(config, self._field, self._limits[1])
        self.searches = 0
        """How often poses from a search over the whole map were taken in."""
        self.pushes = 0
        """How often a scan was taken in because someone had pushed the standing robot."""
        self._beams: Beams | None = None
        self._search = GlobalSearch(self._field, FreeSpace(grid), config, self._limits[1])
        self._fine = FinePose(grid, config) if config.refine else None
        self._poses = np.zeros((0, 3))
        self._weights = np.zeros(0)
        self._T_odom_base: SE2 | None = None  # odometry at the last filter update
        self._T_map_odom: SE2 | None = None
        self._estimate: Estimate | None = None
        self._slow = self._fast = NOMINAL_AGREEMENT
        self._best = 0.0
        self._standing = StandingWatch()
        self._updates = self._next_search = 0
        self._pause = FIRST_PAUSE

    @property
    def initialised(self) -> bool:
        """Whether the filter was told, or told to find out, where it is."""
        return len(self._poses) > 0

    @property
    def converged(self) -> bool:
        """Whether the whole cloud is one narrow cluster (see `convergence_xy`, `convergence_yaw`)."""
        if self._estimate is None:
            return False
        std = np.sqrt(np.diag(self._estimate.covariance))
        return bool(
            max(std[0], std[1]) <= self.config.convergence_xy and std[2] <= self.config.convergence_yaw
        )

    @property
    def T_map_odom(self) -> SE2:
        """Odometry's frame on the map; ValueError before the first update."""
        if self._T_map_odom is None:
            raise ValueError("the filter has no pose yet: initialise it and update it with a scan")
        return self._T_map_odom

    def T_map_base(self, T_odom_base: SE2) -> SE2:
        """The estimate now, given odometry now."""
        return self.T_map_odom @ T_odom_base

    @property
    def covariance(self) -> Array:
        """Covariance of the whole cloud about the estimate at the last update, (3, 3): x, y, yaw."""
        if self._estimate is None:
            raise ValueError("the filter has no pose yet: initialise it and update it with a scan")
        return self._estimate.covariance

    @property
    def beams(self) -> Beams | None:
        """The scan of the last update; None before the first."""
        return self._beams

    @property
    def search(self) -> GlobalSearch:
        """How well the map explains a scan from any pose."""
        return self._search

    @property
    def particles(self) -> SE2:
        """The cloud in the map frame, (n,)."""
        return SE2(self._poses.copy())

    @property
    def size(self) -> int:
        """How many particles there are."""
        return len(self._poses)

    @property
    def weights(self) -> Array:
        """Normalised weights, (n,)."""
        return self._weights.copy()

    def initialise(
        self, T_map_base: SE2, covariance: Array | None = None, T_odom_base: SE2 | None = None
    ) -> None:
        """Spread the cloud about a pose estimate (covariance (3, 3), default: initial_cov_*).

        With `T_odom_base`, the odometry now, `T_map_odom` is set at once; otherwise the pose is taken
        to hold at the next scan.
        """
        c = self.config
        if covariance is None:
            covariance = np.diag([c.initial_cov_xx, c.initial_cov_yy, c.initial_cov_aa])
        noise = self._rng.multivariate_normal(np.zeros(3), covariance, size=c.max_particles, method="eigh")
        poses = T_map_base.xyt + noise
        poses[:, 2] = wrap(poses[:, 2])
        self._restart(poses)
        self._T_odom_base = T_odom_base
        if T_odom_base is not None:
            self._T_map_odom = T_map_base @ T_odom_base.inverse()

    def initialise_globally(self) -> None:
        """Forget every pose: the next scan is compared with the whole free space."""
        self._restart(self._search.uniform(self.config.max_particles, self._rng))
        self._fast = 0.0

    def update(self, scan: Scan, T_odom_base: SE2, T_odom_base_end: SE2 | None = None) -> bool:
        """Take in a scan; True when the filter used it, False when the robot had hardly moved.

        A scan of a standing robot is used when it shows that someone has pushed it.

        `T_odom_base` is odometry at the scan's stamp, `T_odom_base_end` at the end of the sweep (stamp
        + n_beams * time_increment), with which a turning lidar's motion is undone. ValueError when
        the filter is not initialised or odometry is not finite.
        """
        self._check(T_odom_base)
        T_last_base = None if self._T_odom_base is None else self._T_odom_base.inverse() @ T_odom_base
        spread = None
        if self._moved_enough(T_last_base):
            self._standing.moved()
        else:
            spread = self._pushed(scan, T_odom_base)
            if spread is None:
                return False
        T_base_odom = T_odom_base.inverse()
        sweep = None if T_odom_base_end is None else T_base_odom @ T_odom_base_end
        beams = prepare(scan, self._T_base_lidar, sweep, self._limits)
        if T_last_base is not None:
            self._predict(T_last_base)
        if spread is not None:
            self.pushes += 1
            self._poses += self._rng.standard_normal(self._poses.shape) * spread
            self._poses[:, 2] = wrap(self._poses[:, 2])
        self._T_odom_base, self._beams = T_odom_base, beams
        if len(beams) > 0:
            self._weigh(beams)
            self._resample(beams)
        self._estimate_pose(beams, T_base_odom)
        self._updates += 1
        return True

    def contradicted(self, scan: Scan, T_odom_base: SE2, T_odom_base_end: SE2) -> bool:
        """Whether a scan, used or not, speaks against the estimate: it explains far less than usual of it."""
        if self._T_map_odom is None:
            return False
        beams = prepare(scan, self._T_base_lidar, T_odom_base.inverse() @ T_odom_base_end, self._limits)
        agreement = self._search.agreement((self._T_map_odom @ T_odom_base).xyt, beams)
        return agreement < CONTRADICTED * self._slow

    def _restart(self, poses: Array) -> None:
        self._poses = poses
        self._weights = np.full(len(poses), 1.0 / len(poses))
        self._T_odom_base = self._T_map_odom = self._estimate = None
        self._slow = self._fast = NOMINAL_AGREEMENT
        self._best = 0.0
        self._standing.moved()
        self._updates = self._next_search = 0
        self._pause = FIRST_PAUSE
        if self._fine is not None:
            self._fine.forget()

    def _check(self, T_odom_base: SE2) -> None:
        if not self.initialised:
            raise ValueError("the filter has no initial pose")
        if not np.isfinite(T_odom_base.xyt).all():
            raise ValueError("odometry is not finite")

    def _moved_enough(self, T_last_base: SE2 | None) -> bool:
        if self._updates == 0 or T_last_base is None:
            return True
        x, y, yaw = T_last_base.xyt.tolist()
        return math.hypot(x, y) >= self.config.update_min_d or abs(yaw) >= self.config.update_min_a

    def _pushed(self, scan: Scan, T_odom_base: SE2) -> Array | None:
        """Spread of the cloud (3,) where someone has pushed the standing robot; None where nobody has."""
        if not self.converged:
            return None
        beams: list[Beams] = []

        def agreement(poses: Array) -> Array:
            if not beams:
                beams.append(prepare(scan, self._T_base_lidar, None, self._limits))
            return self._search.agreements(poses, beams[0])

        return self._standing.pushed(scan, T_odom_base, self.T_map_base(T_odom_base).xyt, agreement)

    def _predict(self, T_last_base: SE2) -> None:
        """Move cloud and fine pose by odometry since the last update."""
        c = self.config
        step = motion.decompose(T_last_base)
        std = motion.noise_std(step, (c.alpha1, c.alpha2, c.alpha3, c.alpha4))
        motion.move(self._poses, step, self._rng.standard_normal(self._poses.shape) * std)
        if self._fine is not None:
            self._fine.predict(T_last_base, step, std)

    @property
    def agreement(self) -> float:
        """Share of the scans of late that the map explains at the estimate, 0 to 1."""
        return self._fast

    @property
    def agrees(self) -> bool:
        """Whether the scans of late agree with the map at the estimate as well as those of long."""
        return self._stranger_share() == 0.0

    @property
    def lost(self) -> bool:
        """Whether the cloud is wide or the scans have stopped to agree with the map at its place."""
        return not (self.converged and self.agrees)

    def _search_share(self) -> float:
        """Share of particles to draw from a search now: all at a global start, then now and then while lost.

        A search that did not help is not repeated at once: the pause doubles, so a place that does not
        look like the map (a moved wardrobe) does not cost a search every scan.
        """
        if self._fast == 0.0:
            return 1.0
        share = self._stranger_share()
        if share == 0.0:
            self._pause = FIRST_PAUSE
            return self._second_look()
        if self._updates < self._next_search:
            return 0.0
        self._next_search = self._updates + self._pause
        self._pause = min(2 * self._pause, LONGEST_PAUSE)
        return share

    def _second_look(self) -> float:
        """Share for a search while nothing seems wrong but scans agree less than they once did.

        In the twin of a place almost all agrees; only a search shows that the other one agrees better.
        """
        if self._fast >= FADED * self._best or self._updates < self._next_search:
            return 0.0
        self._next_search = self._updates + SECOND_LOOK_PAUSE
        return LEAST_STRANGERS

    def _stranger_share(self) -> float:
        """Augmented MCL: how far the agreement of late is below that of long."""
        if self.config.recovery_alpha_slow <= 0.0:
            return 0.0
        share = 1.0 - self._fast / self._slow
        return min(share, MOST_STRANGERS) if share >= LEAST_STRANGERS else 0.0

    def _weigh(self, beams: Beams) -> None:
        log_weights = np.log(np.maximum(self._weights, 1e-300))
        if self.lost:
            log_weights += self._search.log_likelihood(self._poses, beams)
        else:
            log_weights += self._sensor.weigh(self._poses, beams)
        weights = np.exp(log_weights - log_weights.max())
        self._weights = weights / weights.sum()

    def _resample(self, beams: Beams) -> None:
        c = self.config
        share = self._search_share()
        if share == 0.0:
            if (self._updates + 1) % c.resample_interval:
                return
            if c.selective_resampling and sampling.effective_size(self._weights) > 0.5 * len(self._poses):
                return
        found = self._found(share, beams) if share > 0.0 else None
        pool = sampling.low_variance(self._weights, c.max_particles, self._rng.random())
        drawn = self._poses[self._rng.permutation(pool)]
        bins = sampling.bin_numbers(drawn, c.kld_bin_xy, c.kld_bin_yaw)
        count = sampling.kld_count(bins, c.kld_err, c.kld_z, c.min_particles)
        strangers = 0 if found is None else int(share * count)
        kept = self._poses[sampling.low_variance(self._weights, count - strangers, self._rng.random())]
        if found is not None:
            kept = np.concatenate([kept, found[:strangers]])
        self._poses = kept
        self._weights = np.full(len(kept), 1.0 / len(kept))

    def _found(self, share: float, beams: Beams) -> Array | None:
        """Poses from a search, in random order; None when they explain the scan hardly better than we do.

        The neighbourhood goes first: wheels slip more often than robots are carried off, and many a
        building has a far place that looks as this one does.
        """
        c = self.config
        count = int(share * c.max_particles) + 1
        if self._T_map_odom is None or self._T_odom_base is None or self._fast == 0.0:
            self.searches += 1
            return self._search.draw(count, beams, self._rng)
        here = self._T_map_odom @ self._T_odom_base
        near = self._search.draw(count, beams, self._rng, here.xyt)
        far = self._search.draw(count, beams, self._rng)
        gain_near, gain_far = (self._agreement_of(found, beams) for found in (near, far))
        found, gain = (near, gain_near) if gain_near > gain_far - NEARER_BY else (far, gain_far)
        if gain <= self._search.agreement(here.xyt, beams) + BETTER_BY:
            return None
        self.searches += found is far
        return found

    def _agreement_of(self, poses: Array, beams: Beams) -> float:
        """Agreement of scan and map at the main cluster of equally likely poses (n, 3)."""
        c = self.config
        weights = np.full(len(poses), 1.0 / len(poses))
        there = main_cluster(poses, weights, c.kld_bin_xy, c.kld_bin_yaw).T_map_base
        return self._search.agreement(there.xyt, beams)

    def _estimate_pose(self, beams: Beams, T_base_odom: SE2) -> None:
        self._estimate = main_cluster(
            self._poses, self._weights, self.config.kld_bin_xy, self.config.kld_bin_yaw
        )
        T_map_base = self._estimate.T_map_base
        if self._fine is not None:
            T_map_base = self._fine.correct(self._estimate, beams.points)
        self._T_map_odom = T_map_base @ T_base_odom
        self._watch(self._search.agreement(T_map_base.xyt, beams))

    def _watch(self, agreement: float) -> None:
        """Slow and fast averages of how well scans agree with the map at the estimate."""
        c = self.config
        self._slow += c.recovery_alpha_slow * (agreement - self._slow)
        self._fast += (c.recovery_alpha_fast if self._fast > 0.0 else 1.0) * (agreement - self._fast)
        self._best = max(self._best, self._fast)
