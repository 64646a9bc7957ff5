"""Compares the turns of scans and odometry: late odometry, flipped lidars, odometry of another drive.

While the robot turns, the scans alone show how; the delay is the shift at which the odometry shows the
same turns.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from turtlebag.datasets.durations import seconds
from turtlebag.datasets.motion import without_gap
from turtlebag.datasets.robust import cauchy_cost, sigma_by_median
from turtlebag.datasets.se2 import Array
from turtlebag.datasets.sensor_times import Estimate
from turtlebag.datasets.types import Stamps, Trajectory
from turtlebag.pipeline.slam.odometry.track import Track

# Delays considered [s].
DELAYS_S = np.arange(-120, 121, 2) / 100.0
# Turns are compared over this many scans: odometry that comes only with scans is smooth in between.
SPAN = 3
# The log-likelihood ratio of all stretches together that establishes a delay, an upside-down lidar or another
# sweep, which at least this many stretches must contribute to equally: wheels that slip once are not a late
# clock.
LIKELIER, AGREEING = 30.0, 4.0
# Turns that differ by this share, and by this much [rad], belong to two robots: the odometry of other drives
# was off by 0.95 to 3.7 times the turns of the scans, that of the same drive in 60 logs by 0.01 to 0.6 times.
UNLIKE, UNLIKE_RAD = 0.8, 0.03


class Turns(NamedTuple):
    """The turns of scans in spans (n,) of some stretches minus and plus those of the odometry at each delay,
    (2, delays, n) [rad]."""

    off: Array
    stretch: NDArray[np.int64]

    @property
    def sigma(self) -> float:
        """Standard deviation at the best delay [rad]."""
        least = sigma_by_median(self.off, axis=2).min() if len(self.stretch) else 0.0
        return max(float(least), 1e-3)

    @property
    def alike(self) -> bool:
        """Whether they differ by less than the scans turn, or by little, at some delay."""
        if not len(self.stretch):
            return True
        turned = np.abs(self.off.mean(axis=0)).mean()
        return bool(np.abs(self.off[0]).mean(axis=1).min() < max(UNLIKE * turned, UNLIKE_RAD))

    def costs(self, sigma: float) -> Array:
        """The costs of each stretch at each delay, (2, delays, stretches)."""
        of_stretch = self.stretch[:, None] == np.arange(self.stretch.max(initial=-1) + 1)
        return np.asarray(cauchy_cost((self.off / sigma) ** 2) @ of_stretch)

    @property
    def delay(self) -> Estimate:
        """The delay [s] at which they agree best, by the parabola of the costs about the least one."""
        costs = self.costs(self.sigma)[0].sum(axis=1)
        best, step = int(costs.argmin()), float(DELAYS_S[1] - DELAYS_S[0])
        around = costs[np.clip([best - 1, best, best + 1], 0, len(costs) - 1)]
        curvature = float(around[0] - 2.0 * around[1] + around[2]) / step**2
        if curvature <= 0.0:
            return Estimate(0.0, np.inf)
        aside = float(np.clip(0.5 * (around[0] - around[2]) / (curvature * step), -0.5 * step, 0.5 * step))
        # spans of successive scans overlap
        return Estimate(float(DELAYS_S[best]) + aside, float(np.sqrt(SPAN / curvature)))


def delay_of(turns: Turns) -> tuple[float, bool | None]:
    """The delay [s] at which odometry and scans turn together, else 0; and whether they turn against each
    other, None if that does not show."""
    with_it, against = turns.costs(turns.sigma)
    best, none = int(with_it.sum(axis=1).argmin()), len(DELAYS_S) // 2
    mirrored = against[int(against.sum(axis=1).argmin())]
    if surely(with_it[best] - mirrored):
        return 0.0, True
    delay_s = float(DELAYS_S[best]) if surely(with_it[none] - with_it[best]) else 0.0
    return delay_s, False if surely(mirrored - with_it[best]) else None


def surely(gain: Array) -> bool:
    """Whether the stretches together make something that much more likely, each by (n,) as a logarithm."""
    return bool(gain.sum() >= LIKELIER and agreeing(gain))


def agreeing(gain: Array) -> bool:
    """Whether enough of the stretches contribute to a gain (n,), not a few alone."""
    return bool(gain.sum() > 0.0 and gain.sum() ** 2 >= AGREEING * (gain**2).sum())


def turns_of(tracks: Sequence[Track], stamps_ns: Sequence[Stamps], stream: Trajectory) -> Turns:
    """The turns by tracks of some stretches, whose scans have these stamps, and by odometry."""
    first_ns = stream.stamps_ns[0]
    spans = [_spans(*one, first_ns) for one in zip(tracks, stamps_ns, strict=True)]
    times, yaw = seconds(stream.stamps_ns - first_ns), np.unwrap(stream.poses.yaw)
    begin, end, by_scans = np.concatenate([np.zeros((0, 3)), *spans]).T
    later = DELAYS_S[:, None]
    reported = np.interp(end + later, times, yaw) - np.interp(begin + later, times, yaw)
    stretch = np.repeat(np.arange(len(spans)), [*map(len, spans)])
    return Turns(np.stack([by_scans - reported, by_scans + reported]), stretch)


def _spans(track: Track, stamps_ns: Stamps, first_ns: int) -> Array:
    """Start and end of each span of a stretch [s], and its turn by the scans [rad], (n, 3)."""
    times = seconds(stamps_ns - first_ns)
    known = np.convolve(without_gap(np.diff(times)) & track.usable[1:], np.ones(SPAN), "valid")
    yaw = np.unwrap(track.T_track_base.yaw)
    return np.column_stack([times[:-SPAN], times[SPAN:], yaw[SPAN:] - yaw[:-SPAN]])[known == SPAN]
