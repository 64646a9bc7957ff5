"""The lidar: beams against the outlines at its height, each at its own time, with noise."""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import Annotated, Literal

import numpy as np
from numpy.typing import NDArray
from pydantic import Field, model_validator

from turtlebag.datasets.se2 import Array
from turtlebag.datasets.settings import Settings
from turtlebag.datasets.types import LidarSpec
from turtlebag.sim.lidar_errors import LidarUnit, incidence
from turtlebag.sim.nearby import Nearby
from turtlebag.sim.raycast import beam_rays, cast
from turtlebag.sim.robots import Lidar as RobotLidar
from turtlebag.sim.robots import LidarErrors, Rate, RobotSpec
from turtlebag.sim.shapes import Sections, Solid, sections

SWEPT_M = 1.0
"""A lidar moves no farther than this in one sweep; of a faster one all outlines are looked at."""
GAZEBO_SIGMA = 0.01
"""White noise of the tutorial's lidar in Gazebo [m]."""


class LidarConfig(Settings):
    """The lidar's noise model and rate.

    `sensor`: the errors in the robot's file. `gazebo`: Gaussian noise
    of `sigma` only. `datasheet`: the LDS-01's +-15 mm below 0.5 m and +-5 % of the range beyond,
    read as three standard deviations of a beam.
    """

    turning: bool = True
    """Whether the beams of a scan are taken one after another, as the lidar turns; else all at once."""
    noise: Literal["sensor", "gazebo", "datasheet", "none"] | None = None
    """None: by `sim.sensors`; a lidar without a simulator: `gazebo`."""
    errors: LidarErrors | None = None
    """With `sensor`: numbers that replace those in the robot's file."""
    sigma: Annotated[float, Field(ge=0.0)] | None = None
    """White noise of each beam [m]. None: 0.01, with `sensor` that of `errors`."""
    rate_hz: Rate | None = None
    """Turns per second, a divisor of 30; None: as in the robot's file."""
    dropout: Annotated[float, Field(ge=0.0, le=1.0)] = 0.0
    """Chance that a beam comes back as no return (+inf)."""
    reflectivity: bool = True
    """Whether dark or transparent solids absorb beams."""

    def errors_of(self, main: RobotLidar, lidar: RobotLidar) -> LidarErrors | None:
        """The errors of one of a robot's lidars: its own, but for those set otherwise than the main one's."""
        if self.errors is None or lidar is main:
            return self.errors
        usual = main.errors.model_dump()
        told = {name: value for name, value in self.errors.model_dump().items() if value != usual[name]}
        return LidarErrors.model_validate(lidar.errors.model_dump() | told)

    @model_validator(mode="after")
    def _errors_are_used(self) -> LidarConfig:
        if self.errors is not None and self.noise not in ("sensor", None):
            raise ValueError(f"errors apply only with noise=sensor, not noise={self.noise}")
        return self


class Lidar:
    """Turns base poses over a sweep into ranges."""

    def __init__(
        self, solids: Sequence[Solid], robot: RobotSpec, config: LidarConfig, rng: np.random.Generator
    ) -> None:
        self.spec: LidarSpec = robot.lidar.spec(config.turning, config.rate_hz)
        self._config, self._rng, self._height = config, rng, robot.lidar_height
        self.surround(solids)
        self._unit = LidarUnit(config.errors or LidarErrors(), rng) if config.noise == "sensor" else None
        self._T_base_lidar = robot.T_base_lidar.xyt
        self._movers: list[Sections] = []
        self._sweep: Array = np.asarray(
            self.spec.order * (abs(self.spec.time_increment) / self.spec.scan_time), float
        )

    def surround(self, solids: Sequence[Solid]) -> None:
        """Set the solids around the lidar from now on."""
        outlines = sections([s for s in solids if s.crosses(self._height)], self._height)
        self._nearby = Nearby(outlines, self.spec.range_max + SWEPT_M)
        returns = np.concatenate([outlines.segment_return, outlines.circle_return, [1.0]])
        self._absorbed = self._config.reflectivity and bool(returns.min() < 1.0)

    def turn(self) -> tuple[float, float]:
        """Begin a turn of the head: its share of the nominal time, and how late it is stamped [s]."""
        if self._unit is None:
            return 1.0, 0.0
        return self._unit.turn(), self._unit.delay_s

    def true_ranges(
        self, poses: Array, begin: float = 0.0, end: float | None = None
    ) -> tuple[Array, NDArray[np.int64]]:
        """Distances (n_beams,) without noise or limits below, and the outline each beam hit.

        poses (k, 3): base poses in the world at equal steps. The turn of the head runs from row `begin`
        to row `end` (none: the last), both with fractions; one row for a lidar that takes all beams at
        once.
        """
        return self._cast(poses, begin, end, self.spec.angles)[:2]

    def _cast(
        self, poses: Array, begin: float, end: float | None, angles: Array
    ) -> tuple[Array, NDArray[np.int64], Array, Array, Sections]:
        """Distances, which outlines are hit, the beams' origins and directions, for the angles they point at,
        and those outlines."""
        last = float(len(poses) - 1)
        when: Array = begin + self._sweep * ((last if end is None else end) - begin)
        origins, directions, bearings = beam_rays(poses, when, self._T_base_lidar, angles)
        x, y = (0.5 * (origins[0] + origins[-1])).tolist()
        swept = float(np.abs(origins - (x, y)).max()) * math.sqrt(2.0)
        outlines = self._nearby.at(x, y) if swept <= SWEPT_M else self._nearby.everything
        limit = self.spec.range_max
        ranges, hits = cast(origins, directions, bearings, (outlines.segments, outlines.circles), limit)
        # Shorter where a mover stands in the way, each beam by where it stood in that step.
        step = np.minimum(when.astype(np.int64), len(self._movers) - 1)
        for number, moving in enumerate(self._movers):
            beams = np.nonzero(step == number)[0]
            parts = moving.segments, moving.circles
            near, _ = cast(origins[beams], directions[beams], bearings[beams], parts, limit)
            closer = near < ranges[beams]
            ranges[beams[closer]] = near[closer]
            hits[beams[closer]] = -1
        return ranges, hits, origins, directions, outlines

    def note_movers(self, outline: Sections, earlier: int) -> None:
        """Where the movers stand in the control step just taken; `earlier`: steps before it in this turn."""
        self._movers = [*self._movers[len(self._movers) - earlier :], outline]

    def measure(self, poses: Array, begin: float = 0.0, end: float | None = None) -> NDArray[np.float32]:
        """Ranges (n_beams,) as the driver would publish them (REP-117); arguments of `true_ranges`."""
        unit, angles = self._unit, self.spec.angles
        ranges, hits, origins, directions, outlines = self._cast(
            poses, begin, end, angles if unit is None else unit.directions(angles)
        )
        low, high = self.spec.range_min, self.spec.range_max
        valid = (ranges >= low) & (ranges < high)
        noisy = np.clip(ranges + self._noise(ranges) if unit is None else unit.ranges(ranges), low, high)
        out = np.where(valid, noisy, np.where(ranges < low, -np.inf, np.inf))
        if unit is not None:
            cosine = incidence(origins, directions, ranges, hits, outlines.segments, outlines.circles)
            out = np.where(unit.comes_back(cosine), out, np.inf)
        if self._absorbed:
            returns = np.concatenate([outlines.segment_return, outlines.circle_return, [1.0]])
            out = np.where(self._rng.random(len(out)) < returns[hits], out, np.inf)
        if self._config.dropout > 0.0:
            out = np.where(self._rng.random(len(out)) < self._config.dropout, np.inf, out)
        return _between(out.astype(np.float32), self.spec)

    def _noise(self, ranges: Array) -> Array:
        if self._config.noise == "none":
            return np.zeros(len(ranges))
        unit = self._rng.standard_normal(len(ranges))
        if self._config.noise != "datasheet":
            return (GAZEBO_SIGMA if self._config.sigma is None else self._config.sigma) * unit
        finite = np.where(np.isfinite(ranges), ranges, 0.0)
        return np.where(finite < 0.5, 0.015, 0.05 * finite) / 3.0 * unit


def _between(ranges: NDArray[np.float32], spec: LidarSpec) -> NDArray[np.float32]:
    """Rounding to float32 must not push a valid reading over its limits."""
    low, high = np.float32(spec.range_min), np.float32(spec.range_max)
    low = np.nextafter(low, np.float32(np.inf)) if low < spec.range_min else low
    high = np.nextafter(high, np.float32(0.0)) if high > spec.range_max else high
    finite = np.isfinite(ranges)
    return np.where(finite, np.clip(ranges, low, high), ranges)
