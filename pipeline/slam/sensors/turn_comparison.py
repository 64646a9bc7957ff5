"""Compares the turns of scans and odometry: corrects late odometry, flipped lidars and wrong sweep times.

While the robot turns, the scans alone show how; the delay is the shift at which the odometry shows the
same turns. Deskewing depends on the odometry, so the scans are deskewed again with the result until it
no longer changes.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import replace
from functools import cache, partial
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from turtlebag.datasets.durations import nanoseconds, seconds
from turtlebag.datasets.motion import fastest, known_motion, way_and_turn, without_gap
from turtlebag.datasets.robust import cauchy_cost, sigma_by_median
from turtlebag.datasets.se2 import Array, wrap
from turtlebag.datasets.types import LidarSpec, Recording, Recording3D, Trajectory
from turtlebag.pipeline.slam.odometry.line_icp import Lines
from turtlebag.pipeline.slam.odometry.track import Track, TrackingConfig
from turtlebag.pipeline.slam.odometry.tracker import track_log
from turtlebag.pipeline.slam.scans.range_noise import RangeNoise, range_noise
from turtlebag.pipeline.slam.scans.scans import Scans
from turtlebag.pipeline.slam.sensors.gyro_slip import turns_with

# Delays considered [s].
DELAYS_S = np.arange(-120, 121, 2) / 100.0
# A smaller delay moves the robot by less than matching corrects; if odometry comes less often, its interval,
# PERIOD_S at most: CARMEN pairs scans with odometry up to 0.15 s off, and no map suffers.
LEAST_S = 0.05
# Number of stretches, scans of each, and their least distance [s].
STRETCHES, SCANS, PERIOD_S = 24, 8, 0.2
# Turns are compared over this many scans: odometry that comes only with scans is smooth in between.
SPAN = 3
# The log-likelihood ratio of all stretches together that establishes a delay or an upside-down lidar, which
# at least this many stretches must contribute to equally: wheels that slip once are not a late clock.
LIKELIER, AGREEING = 30.0, 4.0
ROUNDS = 6
# Whether another time between beams is more likely is computed for every third stretch first, and for all
# unless these make it so much less likely that the others could hardly outweigh it.
FIRST = 3
# Turns that differ by this share, and by this much [rad], belong to two robots: the odometry of other drives
# was off by 0.95 to 3.7 times the turns of the scans, that of the same drive in 60 logs by 0.01 to 0.6 times.
UNLIKE, UNLIKE_RAD = 0.8, 0.03
# Scans farther apart than this [s], tracked alone, miss turns, so they cannot tell whose odometry it is, nor
# how the lidar sweeps (of the synthetic logs with a scan a second, five lost their odometry and one had its
# sweeps reversed: 25 and 2.5 m off).
JUDGES_S = 0.5


class Timing(NamedTuple):
    """The delay of the odometry [s], negative if it is early; whether the lidar is mounted the other way up
    than declared; the time between beams [s] if it differs from the declared one; and whether scans and
    odometry turn together at all, which the odometry of another drive does not."""

    late_s: float = 0.0
    over: bool = False
    time_increment: float | None = None
    alike: bool = True


def in_step(recording: Recording, timing: Timing) -> Recording:
    """The recording with its odometry shifted to the time of its scans, its lidar flipped and its sweeps
    timed as the comparison says; unchanged if there is nothing to correct."""
    late_s, over, time_increment, _ = timing
    if time_increment is not None:
        way = (
            "in the opposite direction to what"
            if recording.lidar.time_increment
            else "beam by beam, not at once as"
        )
        said = f"the lidar sweeps {way} the log says (judged by the turns of scans and odometry); corrected"
        lidar = replace(recording.lidar, time_increment=time_increment)
        recording = replace(recording, lidar=lidar, notes=(*recording.notes, said))
    if over:
        said = (
            "scans and odometry turn in opposite directions: assuming the laser is mounted the other way up"
        )
        recording = replace(recording, lidar=recording.lidar.turned_over(), notes=(*recording.notes, said))
    recording = _shifted(recording, late_s) if late_s != 0.0 else recording
    return replace(recording, turned_over=not turns_with(recording)) if over else recording


def _shifted(recording: Recording, late_s: float) -> Recording:
    stream, late_ns = odometry_stream(recording), nanoseconds(late_s)
    shifted = Trajectory(stream.stamps_ns - late_ns, stream.poses)
    said = f"{abs(late_s):.2f} s {'behind' if late_s > 0.0 else 'ahead of'} the scans"
    return replace(
        recording,
        T_odom_base=stream.at(recording.stamps_ns + late_ns),
        odometry=None if recording.odometry is None else shifted,
        odometry_late_s=late_s,
        notes=(*recording.notes, f"the odometry runs {said} (judged by the turns of both); corrected"),
    )


def delay_metrics(recording: Recording | Recording3D) -> dict[str, float]:
    """`odometry_late_s` [s] of a recording with corrected odometry, else empty."""
    late_s = recording.odometry_late_s if isinstance(recording, Recording) else 0.0
    return {"odometry_late_s": late_s} if late_s else {}


def compared_turns(recording: Recording) -> Timing:
    """The comparison of the turns of scans and odometry; empty without odometry."""
    if recording.T_odom_base is None or len(recording) < 2:
        return Timing()
    stream = odometry_stream(recording)
    usual = usual_period(recording)
    thin = slice(None, None, thinning(recording))
    scans = replace(
        recording,
        stamps_ns=recording.stamps_ns[thin],
        ranges=recording.ranges[thin],
        T_odom_base=recording.T_odom_base[thin],
        odometry=stream,
    )
    # each stretch is tracked once for a lidar and a delay
    turned = cache(partial(_turned, scans, range_noise(scans, scans.lidar.range_max)))
    compared = partial(_turns, scans, _starts(scans), turned)
    judges, lidar = usual <= JUDGES_S, recording.lidar
    late_s, over, sweep, others = 0.0, False, None, _sweeps(recording, usual) if judges else []
    for _ in range(ROUNDS):
        turns = compared(lidar, late_s)
        found, against = delay_of(turns)
        if against and not over:
            lidar, over = lidar.turned_over(), True
            continue
        settled = lidar.time_increment == 0.0 or abs(found - late_s) < LEAST_S / 2.0
        late_s = found
        if settled:
            other, others = _other_sweep(compared, lidar, late_s, others), []
            if other is None:
                break
            sweep, lidar = other, replace(lidar, time_increment=other)
    interval = seconds(float(np.median(np.diff(stream.stamps_ns)))) if len(stream) > 1 else 0.0
    least_s = min(max(LEAST_S, interval), PERIOD_S)
    return Timing(late_s if abs(late_s) >= least_s else 0.0, over, sweep, turns.alike or not judges)


def _sweeps(recording: Recording, usual_s: float) -> list[float]:
    """Alternative times between beams [s]: the reverse direction or, if none is declared, a full turn per
    scan."""
    said = recording.lidar.time_increment
    if said != 0.0:
        return [-said]
    turn = usual_s * abs(recording.lidar.angle_increment) / (2.0 * np.pi)
    return [turn, -turn]


def _other_sweep(
    compared: Callable[..., Turns], lidar: LidarSpec, late_s: float, others: Sequence[float]
) -> float | None:
    """The alternative time between beams [s] with which scans and odometry clearly agree better; None if
    there is none."""
    best, gained = None, 0.0
    for time_increment in others:
        other = replace(lidar, time_increment=time_increment)
        if _gain(compared(lidar, late_s, FIRST), compared(other, late_s, FIRST)).sum() < -LIKELIER / FIRST:
            continue
        gain = _gain(compared(lidar, late_s), compared(other, late_s))
        if _surely(gain) and gain.sum() > gained:
            best, gained = time_increment, float(gain.sum())
    return best


def _gain(turns: Turns, other: Turns) -> Array:
    """The log-likelihood ratio in favour of the other, by stretch (STRETCHES,)."""
    sigma = min(turns.sigma, other.sigma)
    return turns.least(sigma) - other.least(sigma)


def odometry_stream(recording: Recording) -> Trajectory:
    """The odometry at its own rate, or else that of the scans."""
    if recording.odometry is not None:
        return recording.odometry
    assert recording.T_odom_base is not None
    stamps, first = np.unique(recording.stamps_ns, return_index=True)
    return Trajectory(stamps, recording.T_odom_base[first])


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
        """The costs of each stretch at each delay, (2, delays, STRETCHES)."""
        of_stretch = self.stretch[:, None] == np.arange(STRETCHES)
        return np.asarray(cauchy_cost((self.off / sigma) ** 2) @ of_stretch)

    def least(self, sigma: float) -> Array:
        """The costs of each stretch at the delay at which both turn together best."""
        costs = self.costs(sigma)[0]
        return np.asarray(costs[int(costs.sum(axis=1).argmin())])


def delay_of(turns: Turns) -> tuple[float, bool]:
    """The delay [s] at which odometry and scans turn together, else 0; and whether they turn against each
    other."""
    with_it, against = turns.costs(turns.sigma)
    best, none = int(with_it.sum(axis=1).argmin()), len(DELAYS_S) // 2
    mirrored = against[int(against.sum(axis=1).argmin())]
    if _surely(with_it[best] - mirrored):
        return 0.0, True
    return (float(DELAYS_S[best]) if _surely(with_it[none] - with_it[best]) else 0.0), False


def _surely(gain: Array) -> bool:
    """Whether the stretches together make something that much more likely, each by (n,) as a logarithm."""
    return bool(gain.sum() >= LIKELIER and gain.sum() ** 2 >= AGREEING * (gain**2).sum())


def _starts(scans: Recording) -> list[int]:
    """First scans of the stretches in which the turning changes most, and the odometry does not jump."""
    assert scans.T_odom_base is not None
    waits, moved = seconds(np.diff(scans.stamps_ns)), way_and_turn(scans.T_odom_base.steps())
    known = without_gap(waits)
    starts = np.arange(0, len(scans) - SCANS, SCANS)
    if not len(starts) or not known.any():
        return []
    jumped = known & (moved > fastest(moved[known], waits[known]) * waits[:, None]).any(axis=1)
    rate = np.where(known, wrap(np.diff(scans.T_odom_base.yaw)) / np.where(known, waits, 1.0), 0.0)
    change = np.add.reduceat(np.minimum(np.abs(np.diff(rate, append=rate[-1:])), 1.0), starts)
    change, starts = (of[~np.logical_or.reduceat(jumped, starts)] for of in (change, starts))
    chosen: list[int] = starts[np.sort(np.argsort(-change, kind="stable")[:STRETCHES])].tolist()
    return chosen


def _turns(
    scans: Recording,
    starts: list[int],
    turned: Callable[[LidarSpec, float, int], Array],
    lidar: LidarSpec,
    late_s: float,
    every: int = 1,
) -> Turns:
    """The turns by scans and by odometry in one of `every` stretches, the sweeps of the lidar deskewed as if
    the odometry were this late."""
    spans, stream = [turned(lidar, late_s, start) for start in starts[::every]], odometry_stream(scans)
    times, yaw = seconds(stream.stamps_ns - scans.stamps_ns[0]), np.unwrap(stream.poses.yaw)
    begin, end, by_scans = np.concatenate([np.zeros((0, 3)), *spans]).T
    later = DELAYS_S[:, None]
    reported = np.interp(end + later, times, yaw) - np.interp(begin + later, times, yaw)
    stretch = np.repeat(np.arange(len(spans)), [*map(len, spans)])
    return Turns(np.stack([by_scans - reported, by_scans + reported]), stretch)


def _turned(scans: Recording, noise: RangeNoise, lidar: LidarSpec, late_s: float, start: int) -> Array:
    """Start and end [s] since the first scan, and turn [rad] by the scans alone, of each span of the stretch
    from `start` on, (n, 3)."""
    rows = start + np.arange(SCANS)
    track = tracked_alone(replace(scans, lidar=lidar), rows, noise, late_s)
    times = seconds(scans.stamps_ns[rows] - scans.stamps_ns[0])
    waits = np.diff(times)
    known = np.convolve(without_gap(waits) & track.usable[1:], np.ones(SPAN), "valid")
    yaw = np.unwrap(track.T_track_base.yaw)
    return np.column_stack([times[:-SPAN], times[SPAN:], yaw[SPAN:] - yaw[:-SPAN]])[known == SPAN]


def tracked_alone(
    recording: Recording, rows: NDArray[np.int64], noise: RangeNoise, late_s: float = 0.0
) -> Track:
    """Some scans (n,) tracked alone, each sweep deskewed by an odometry this late."""
    stamps_ns = recording.stamps_ns[rows]
    late = replace(recording, stamps_ns=stamps_ns + nanoseconds(late_s))
    alone = replace(
        recording,
        stamps_ns=stamps_ns,
        ranges=recording.ranges[rows],
        T_odom_base=None,
        odometry=None,
        imu=None,
    )
    return track_log(Scans(alone, alone.lidar.range_max, noise, known_motion(late)), TrackingConfig(), Lines)


def thinning(recording: Recording) -> int:
    """Every so many scans are PERIOD_S apart."""
    return max(1, round(PERIOD_S / usual_period(recording)))


def usual_period(recording: Recording) -> float:
    """Median time between scans [s]; PERIOD_S if the clock stands still."""
    waits = seconds(np.diff(recording.stamps_ns))
    return float(np.median(waits[waits > 0.0])) if (waits > 0.0).any() else PERIOD_S
