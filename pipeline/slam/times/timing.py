"""When the sensors measured: the delay of the odometry and the sweep of the lidar, by comparing them.

The turns of both give the delay, and whether the lidar is mounted the other way up; pairs of scans that turn
differently give how long a sweep takes, which way, and where in the array it begins. Each depends on the
other, because the scans are deskewed with both, so both are estimated until neither changes.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from functools import cache, partial
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from turtlebag.datasets.durations import nanoseconds, seconds
from turtlebag.datasets.motion import NEARLY_ALWAYS, way_and_turn
from turtlebag.datasets.se2 import Array
from turtlebag.datasets.sensor_times import Estimate, SensorTimes
from turtlebag.datasets.types import LidarSpec, Recording, Stamps, Trajectory
from turtlebag.pipeline.slam.scans.range_noise import RangeNoise, range_noise
from turtlebag.pipeline.slam.times.beam_times import (
    SectorTimes,
    all_round,
    believed_s,
    best_sweep,
    has_sectors,
    near_start,
    sector_of,
    sector_times,
)
from turtlebag.pipeline.slam.times.stretches import (
    odometry_stream,
    thinned_scans,
    tracked_alone,
    turning,
    usual_period,
)
from turtlebag.pipeline.slam.times.turn_comparison import Turns, agreeing, delay_of, surely, turns_of

# A smaller delay moves the robot by less than matching corrects; if odometry comes less often, its interval,
# MOST_S at most: CARMEN pairs scans with odometry up to 0.15 s off, and no map suffers.
LEAST_S, MOST_S = 0.05, 0.2
ROUNDS = 8
# Scans between which a robot turns by more than this [rad] at its fastest, tracked alone, miss turns, so they
# cannot tell whose odometry it is, nor how the lidar sweeps (of the synthetic logs with a scan a second, five
# lost their odometry and one had its sweeps reversed: 25 and 2.5 m off).
JUDGES_RAD = 0.5
# Shares of the period: sectors that are off by less (rms) do not show in a map; parts of the array that are
# farther apart than in logs of one lidar (at most 0.01 in 7 logs; 0.23 in three merged ones) are two lidars.
LEAST_SHARE, MERGED_SHARE = 0.04, 0.1
# An estimate with a larger standard deviation, as a share of the period or of all beams, is none.
UNSURE_SHARE = 0.1


class Timing(NamedTuple):
    """What to correct: the delay of the odometry [s], negative if it is early; whether the lidar is mounted
    the other way up than declared; its beams, if their times are not as declared; and whether scans and
    odometry turn together at all, which the odometry of another drive does not. `times` is what is known."""

    late_s: float = 0.0
    over: bool = False
    lidar: LidarSpec | None = None
    alike: bool = True
    times: SensorTimes = SensorTimes()


class Belief(NamedTuple):
    """When the beams are taken, and how late the odometry is [s]."""

    lidar: LidarSpec
    late_s: float = 0.0


class Seen(NamedTuple):
    """What the stretches of a drive show, deskewed as a belief says: their turns, and the times of the
    sectors by each, if these are asked for."""

    turns: Turns
    sectors: list[SectorTimes]

    def gain(self, later_s: Array) -> Array:
        """The log-likelihood ratio in favour of sectors that are taken later (SECTORS,) [s], by stretch."""
        return np.array([one.gain(later_s) for one in self.sectors])

    @property
    def misfit(self) -> Array:
        """How badly the scans of each stretch match, 0 to 1."""
        return np.array([one.misfit for one in self.sectors])


Look = Callable[[Belief], Seen]


def compared_times(recording: Recording, *, deskew: bool = True) -> Timing:
    """The comparison of the times of scans and odometry, and if these are to be deskewed, of beams; empty
    without odometry."""
    if recording.T_odom_base is None or len(recording) < 2:
        return Timing()
    period_s, scans = usual_period(recording), thinned_scans(recording)
    T_odom_base = scans.T_odom_base
    assert T_odom_base is not None
    turns = way_and_turn(T_odom_base.steps())[:, 1]
    judges = bool(np.quantile(turns, NEARLY_ALWAYS) <= JUDGES_RAD)
    swept = deskew and judges and has_sectors(recording.lidar)
    noise = range_noise(scans, scans.lidar.range_max)
    look = cache(partial(_look, scans, noise, turning(scans), period_s if swept else 0.0))
    believed, over = _settled(look, recording.lidar, period_s, swept)
    if swept and all_round(believed.lidar):
        believed = _begun(look, believed, recording.lidar, period_s)
    declared = recording.lidar.turned_over() if over else recording.lidar
    apart_s = _apart_s(look, believed, period_s)
    if believed.lidar != declared:
        as_said, over_as_said = _settled(look, recording.lidar, period_s, False)
        earlier = believed_s(declared) - believed_s(believed.lidar)
        sure = np.std(earlier) > LEAST_SHARE * period_s and surely(-look(believed).gain(earlier))
        sharper = agreeing(look(as_said).misfit - look(believed).misfit)
        if not (sure and sharper) or apart_s > 0.0:
            believed, over = as_said, over_as_said
            declared = recording.lidar.turned_over() if over else recording.lidar
    seen, stream = look(believed), odometry_stream(recording)
    times = replace(_times(look, believed, over, period_s), apart_s=apart_s)
    interval = seconds(float(np.median(np.diff(stream.stamps_ns)))) if len(stream) > 1 else 0.0
    least_s = min(max(LEAST_S, interval), MOST_S)
    late_s = believed.late_s if abs(believed.late_s) >= least_s else 0.0
    lidar = None if believed.lidar == declared else believed.lidar
    return Timing(late_s, bool(over), lidar, seen.turns.alike or not judges, times)


def _settled(look: Look, said: LidarSpec, period_s: float, swept: bool) -> tuple[Belief, bool | None]:
    """The belief that explains what it lets be seen, from what a log says on; and whether the lidar is
    mounted the other way up. It keeps its sweep unless another is asked for, and seems better."""
    belief, over, free = Belief(said), None, False
    for _ in range(ROUNDS):
        seen, before = look(belief), belief
        late_s, against = delay_of(seen.turns)
        if against and not over:
            belief, over = Belief(belief.lidar.turned_over()), True
            continue
        over = over or against
        belief = belief._replace(late_s=late_s)
        if swept:
            sweep = best_sweep(belief.lidar, seen.sectors, period_s)
            later = believed_s(sweep.lidar) - believed_s(belief.lidar)
            free = free or bool(np.std(later) > LEAST_SHARE * period_s)
        if free:
            # the turns of scans are those of the middle of their sweeps
            belief = Belief(sweep.lidar, round(late_s - float(later.mean()), 2))
        still = belief.lidar == before.lidar or np.std(later) < 0.25 * LEAST_SHARE * period_s
        if still and abs(belief.late_s - before.late_s) < LEAST_S / 2.0:
            break
    return belief, over


def _begun(look: Look, belief: Belief, said: LidarSpec, period_s: float) -> Belief:
    """The belief with the first beam with which the scans match best, where the sweep is not as a log says.

    Beams that are taken a whole period apart from where they are believed to be match nothing, and do not
    show in the times of the sectors.
    """
    sweep, lidar = best_sweep(belief.lidar, look(belief).sectors, period_s), belief.lidar
    if lidar.sweep_s == said.sweep_s and abs(sweep.lidar.sweep_s - said.sweep_s) < LEAST_SHARE * period_s:
        return belief
    step = lidar.n_beams // 16
    while step > 0:
        for first in (lidar.first_beam - step, lidar.first_beam + step):
            other = belief._replace(lidar=replace(lidar, first_beam=first % lidar.n_beams))
            if look(other).misfit.sum() < look(belief).misfit.sum():
                belief, lidar = other, other.lidar
                break
        else:
            step //= 2
    first = 0 if near_start(lidar) else lidar.first_beam
    return belief._replace(lidar=best_sweep(lidar, look(belief).sectors, period_s, first).lidar)


def _times(look: Look, belief: Belief, over: bool | None, period_s: float) -> SensorTimes:
    """What the stretches say about the times, deskewed as is believed."""
    seen = look(belief)
    delay, sweep, first = seen.turns.delay, None, None
    if belief.late_s != 0.0:  # it is established, and by the middle of the sweeps
        delay = delay._replace(value=belief.late_s)
    sectors_s: tuple[float, ...] = ()
    if seen.sectors:
        best = best_sweep(belief.lidar, seen.sectors, period_s, belief.lidar.first_beam)
        sectors_s = tuple((believed_s(best.lidar) + best.rest_s).tolist())
        periods = 1.0 / ((1.0 - 1.0 / best.lidar.n_beams) * period_s)
        way = np.copysign(periods, best.lidar.time_increment)
        sweep = Estimate(float(way) * best.lidar.sweep_s, periods * best.sigma_s)
        first = Estimate(float(best.lidar.first_beam), best.first_sigma)
        sweep = sweep if sweep.sigma < UNSURE_SHARE else None
        known = sweep and all_round(best.lidar) and first.sigma < UNSURE_SHARE * best.lidar.n_beams
        first = first if known else None
    return SensorTimes(delay if delay.sigma < LEAST_S else None, sweep, first, over, sectors_s=sectors_s)


def _apart_s(look: Look, belief: Belief, period_s: float) -> float:
    """The time between parts of the array that no sweep explains [s], 0 if there is none."""
    seen = look(belief)
    if not seen.sectors:
        return 0.0
    best = best_sweep(belief.lidar, seen.sectors, period_s)
    gain = seen.gain(best.later_s) - seen.gain(best.later_s - best.rest_s)
    merged = surely(gain) and float(np.std(best.rest_s)) > MERGED_SHARE * period_s
    return float(np.ptp(best.rest_s)) if merged else 0.0


def _look(
    scans: Recording, noise: RangeNoise, stretches: list[NDArray[np.int64]], period_s: float, belief: Belief
) -> Seen:
    """What the stretches show with such a belief; the times of the sectors only for a period above 0."""
    stream, lidar = odometry_stream(scans), belief.lidar
    believed, tracks, sectors = replace(scans, lidar=lidar), [], []
    for rows in stretches:
        clouds, track, beams = tracked_alone(believed, rows, noise, belief.late_s)
        tracks.append(track)
        if period_s > 0.0:
            twists = _twists(stream, scans.stamps_ns[rows] + nanoseconds(belief.late_s), period_s)
            sectors.append(sector_times(clouds, sector_of(lidar, beams), twists, track.T_track_base.xyt))
    return Seen(turns_of(tracks, [scans.stamps_ns[rows] for rows in stretches], stream), sectors)


def _twists(stream: Trajectory, stamps_ns: Stamps, period_s: float) -> Array:
    """Mean twists (n, 3) of the base over a period from stamps (n,) on [m/s, rad/s]."""
    motion = stream.at(stamps_ns).inverse() @ stream.at(stamps_ns + nanoseconds(period_s))
    x, y, turn = motion.xyt.T
    c, s = np.cos(0.5 * turn), np.sin(0.5 * turn)
    return np.column_stack([c * x + s * y, c * y - s * x, turn]) / period_s
