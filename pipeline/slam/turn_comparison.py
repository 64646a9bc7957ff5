"""Odometry that comes late, or runs ahead, by a constant, or turns the other way than the scans: undone.

In stretches where the robot turns, the scans alone say how it turned; the delay is the one at which the
odometry says the same. A lidar that turns has its sweeps undone by the odometry, so they are undone
again by what was found until that stays the same.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from turtlebag.datasets.bags.scans import turned_over
from turtlebag.datasets.se2 import Array, wrap
from turtlebag.datasets.types import Recording, Recording3D, Trajectory
from turtlebag.pipeline.slam.align import CAUCHY
from turtlebag.pipeline.slam.clouds import GAP_S, USABLE_M, make_clouds, sweep_motion
from turtlebag.pipeline.slam.course import track_log
from turtlebag.pipeline.slam.gyro import turns_with
from turtlebag.pipeline.slam.line_tracking import Lines
from turtlebag.pipeline.slam.range_noise import PER_MEDIAN, RangeNoise, range_noise
from turtlebag.pipeline.slam.track import TrackingConfig

# Delays looked at [s].
DELAYS_S = np.arange(-120, 121, 2) / 100.0
# A smaller one moves the robot by less than what matching makes good; of odometry that comes less often, its
# interval, PERIOD_S at most: CARMEN pairs scans with odometry up to 0.15 s off, and no map suffers.
LEAST_S = 0.05
# Stretches that are looked at and scans of each, this far apart at least [s].
STRETCHES, SCANS, PERIOD_S = 32, 8, 0.2
# Turns are compared over so many scans: odometry that comes with the scans alone is smooth in between.
SPAN = 3
# So much likelier (logarithm) must all stretches together make a delay, or a lidar upside down, and this
# many of equal weight or more must carry that: wheels that slip once are no clock that is late.
LIKELIER, AGREEING = 30.0, 4.0
ROUNDS = 4


def in_step(recording: Recording, late_s: float, over: bool) -> Recording:
    """The recording with its odometry, so much late [s], at the time of its scans, and its lidar turned over
    or not; as it is where nothing is to be done."""
    if over:
        said = (
            "scans and odometry turn in opposite directions: assuming the laser is mounted the other way up"
        )
        recording = replace(recording, lidar=turned_over(recording.lidar), notes=(*recording.notes, said))
    recording = _shifted(recording, late_s) if late_s != 0.0 else recording
    return replace(recording, turned_over=not turns_with(recording)) if over else recording


def _shifted(recording: Recording, late_s: float) -> Recording:
    stream, late_ns = _stream(recording), round(late_s * 1e9)
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
    """`odometry_late_s` [s] of a recording whose odometry was undone, else nothing."""
    late_s = recording.odometry_late_s if isinstance(recording, Recording) else 0.0
    return {"odometry_late_s": late_s} if late_s else {}


def compared_turns(recording: Recording) -> tuple[float, bool]:
    """How late the odometry is [s], negative when it runs ahead, and whether the lidar hangs the other way up
    than said; 0 and False where there is no odometry or nothing shows it."""
    if recording.T_odom_base is None or len(recording) < 2:
        return 0.0, False
    stream = _stream(recording)
    waits = np.diff(recording.stamps_ns) * 1e-9
    usual = float(np.median(waits[waits > 0.0])) if (waits > 0.0).any() else PERIOD_S
    thin = slice(None, None, max(1, round(PERIOD_S / usual)))
    scans = replace(
        recording,
        stamps_ns=recording.stamps_ns[thin],
        ranges=recording.ranges[thin],
        T_odom_base=recording.T_odom_base[thin],
        odometry=stream,
    )
    late_s, over = 0.0, False
    for _ in range(ROUNDS):
        found, against = _delay(scans, late_s)
        if against and not over:
            scans, over = replace(scans, lidar=turned_over(scans.lidar)), True
            continue
        settled = recording.lidar.time_increment == 0.0 or abs(found - late_s) < LEAST_S / 2.0
        late_s = found
        if settled:
            break
    interval = float(np.median(np.diff(stream.stamps_ns))) * 1e-9 if len(stream) > 1 else 0.0
    least_s = min(max(LEAST_S, interval), PERIOD_S)
    return late_s if abs(late_s) >= least_s else 0.0, over


def _stream(recording: Recording) -> Trajectory:
    if recording.odometry is not None:
        return recording.odometry
    assert recording.T_odom_base is not None
    stamps, first = np.unique(recording.stamps_ns, return_index=True)
    return Trajectory(stamps, recording.T_odom_base[first])


def _delay(scans: Recording, late_s: float) -> tuple[float, bool]:
    """The delay [s] at which odometry and scans turn together, the sweeps undone as of `late_s`, else 0; and
    whether they turn against each other."""
    noise = range_noise(scans, USABLE_M)
    spans = [_turns(scans, late_s, stretch, noise) for stretch in _stretches(scans)]
    spans = [one for one in spans if len(one)]
    if not spans:
        return 0.0, False
    stream = _stream(scans)
    times, yaw = (stream.stamps_ns - scans.stamps_ns[0]) * 1e-9, np.unwrap(stream.poses.yaw)
    begin, end, turned = np.concatenate(spans).T
    later = DELAYS_S[:, None]
    told = np.interp(end + later, times, yaw) - np.interp(begin + later, times, yaw)
    of_stretch = np.cumsum([0, *[len(one) for one in spans]])[:-1]
    off = np.stack([turned - told, turned + told])
    sigma = max(PER_MEDIAN * float(np.median(np.abs(off), axis=2).min()), 1e-3)
    with_it, against = np.log1p((off / (CAUCHY * sigma)) ** 2)
    best, none = int(with_it.sum(axis=1).argmin()), len(DELAYS_S) // 2
    mirrored = against[int(against.sum(axis=1).argmin())]
    if _surely(np.add.reduceat(with_it[best] - mirrored, of_stretch)):
        return 0.0, True
    sure = _surely(np.add.reduceat(with_it[none] - with_it[best], of_stretch))
    return (float(DELAYS_S[best]) if sure else 0.0), False


def _surely(gain: Array) -> bool:
    """Whether the stretches together make something so much likelier, each by (n,) as a logarithm."""
    return bool(gain.sum() >= LIKELIER and gain.sum() ** 2 >= AGREEING * (gain**2).sum())


def _stretches(scans: Recording) -> list[NDArray[np.int64]]:
    """Rows of the scans of each stretch in which the turning changes most."""
    assert scans.T_odom_base is not None
    waits = np.diff(scans.stamps_ns) * 1e-9
    known = (waits > 0.0) & (waits < GAP_S)
    rate = np.where(known, wrap(np.diff(scans.T_odom_base.yaw)) / np.where(known, waits, 1.0), 0.0)
    starts = np.arange(0, len(scans) - SCANS, SCANS)
    if not len(starts):
        return []
    change = np.add.reduceat(np.minimum(np.abs(np.diff(rate, append=rate[-1:])), 1.0), starts)
    chosen = np.sort(np.argsort(-change, kind="stable")[:STRETCHES])
    return [start + np.arange(SCANS) for start in starts[chosen]]


def _turns(scans: Recording, late_s: float, rows: NDArray[np.int64], noise: RangeNoise) -> Array:
    """Begin and end [s] since the first scan, and turn [rad] by the scans alone, over each span, (n, 3)."""
    part = replace(scans, stamps_ns=scans.stamps_ns[rows], ranges=scans.ranges[rows], T_odom_base=None)
    late = replace(part, stamps_ns=part.stamps_ns + round(late_s * 1e9))
    motion = sweep_motion(late) if scans.lidar.time_increment != 0.0 else None
    alone = replace(part, odometry=None, imu=None)
    clouds = make_clouds(alone, USABLE_M, motion, noise)
    track = track_log(alone, clouds, TrackingConfig(), USABLE_M, range(1, len(rows)), Lines)
    seconds = (part.stamps_ns - scans.stamps_ns[0]) * 1e-9
    waits = np.diff(seconds)
    known = np.convolve((waits > 0.0) & (waits < GAP_S) & track.usable[1:], np.ones(SPAN), "valid")
    yaw = np.unwrap(track.T_track_base.yaw)
    return np.column_stack([seconds[:-SPAN], seconds[SPAN:], yaw[SPAN:] - yaw[:-SPAN]])[known == SPAN]
