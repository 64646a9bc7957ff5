"""Parameters of the particle filter, named as ROS and Nav2 amcl name them."""

from __future__ import annotations

import math

from pydantic import Field, model_validator

from turtlebag.datasets.settings import Settings
from turtlebag.datasets.types import LidarSpec


class AmclConfig(Settings, allow_inf_nan=False):
    """Settings of `turtlebag.pipeline.localisation.amcl.Amcl`; lengths in m, angles in rad.

    Names shared with ROS amcl mean the same here. Values differ where measured better for a lidar of
    3.5 m and 1 cm: ROS's sigma_hit of 0.2 m and its odometry noise are far too wide to reach 1 cm.
    """

    min_particles: int = Field(default=500, ge=2, le=100_000)
    """Fewest particles."""
    max_particles: int = Field(default=2000, ge=2, le=100_000)
    """Most particles, as while the robot may be anywhere."""
    kld_err: float = Field(default=0.02, gt=0.0)
    """Largest error of the particles' distribution, as KLD sampling bounds it (Fox 2003)."""
    kld_z: float = Field(default=2.33, gt=0.0)
    """Quantile of the normal distribution for that bound: 2.33 is 99 %."""

    update_min_d: float = Field(default=0.05, ge=0.0)
    """Distance [m] after which the next scan is used."""
    update_min_a: float = Field(default=0.05, ge=0.0)
    """Turn [rad] after which the next scan is used."""
    resample_interval: int = Field(default=1, ge=1)
    """Scans used between resamplings."""
    selective_resampling: bool = True
    """Resample only when fewer than half of the particles count."""

    # Differential odometry: the sums below are VARIANCES (Thrun's text, Nav2); ROS 1's plain "diff"
    # hands the same sums over as standard deviations.
    alpha1: float = Field(default=0.02, ge=0.0)
    """Variance of rotation from rotation [rad^2/rad^2]."""
    alpha2: float = Field(default=0.02, ge=0.0)
    """Variance of rotation from translation [rad^2/m^2]."""
    alpha3: float = Field(default=0.01, ge=0.0)
    """Variance of translation from translation [m^2/m^2]."""
    alpha4: float = Field(default=0.005, ge=0.0)
    """Variance of translation from rotation [m^2/rad^2]."""

    max_beams: int = Field(default=60, ge=1, le=10_000)
    """Beams of a scan that are compared with the map."""
    laser_min_range: float = -1.0
    """Shorter ranges are not used [m]; -1: the lidar's own limit."""
    laser_max_range: float = -1.0
    """Longer ranges are not used [m]; -1: the lidar's own limit."""
    likelihood_max_dist: float = Field(default=2.0, gt=0.0, le=100.0)
    """Distance from a wall beyond which a beam's likelihood falls no further [m]."""
    sigma_hit: float = Field(default=0.05, gt=0.0)
    """Standard deviation of a beam's end from the wall [m]."""
    z_hit: float = Field(default=0.7, gt=0.0)
    """Weight of beams that end at a wall of the map."""
    z_rand: float = Field(default=0.3, gt=0.0)
    """Weight of beams that end anywhere."""

    recovery_alpha_slow: float = Field(default=0.001, ge=0.0, le=1.0)
    """Rate of the slow average of the scans' likelihood; a fast one below it brings random particles."""
    recovery_alpha_fast: float = Field(default=0.1, ge=0.0, le=1.0)
    """Rate of the fast average."""

    refine: bool = True
    """Estimate the pose more finely than by the mean of the particles."""

    initial_cov_xx: float = Field(default=0.25, ge=0.0)
    """Variance of an initial pose in x [m^2]."""
    initial_cov_yy: float = Field(default=0.25, ge=0.0)
    """Variance of an initial pose in y [m^2]."""
    initial_cov_aa: float = Field(default=(math.pi / 12.0) ** 2, ge=0.0)
    """Variance of an initial heading [rad^2]."""

    @model_validator(mode="after")
    def _check(self) -> AmclConfig:
        if self.min_particles > self.max_particles:
            raise ValueError(f"min_particles {self.min_particles} exceeds max_particles {self.max_particles}")
        if self.recovery_alpha_slow > self.recovery_alpha_fast:
            raise ValueError("recovery_alpha_slow must not exceed recovery_alpha_fast")
        return self

    def range_limits(self, lidar: LidarSpec) -> tuple[float, float]:
        """Ranges [m] that are used of a lidar's: its own, or narrower."""
        low, high = self.laser_min_range, self.laser_max_range
        return (
            lidar.range_min if low < 0.0 else low,
            lidar.range_max if high < 0.0 else min(high, lidar.range_max),
        )
