"""Logs made harder, each in one known way: a function of a `Known` and a Generator."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from benchmarks.known_logs import Known, Mask
from turtlebag.datasets.relations import Relations
from turtlebag.datasets.se2 import SE2, wrap
from turtlebag.datasets.seeds import stream
from turtlebag.datasets.types import ImuLog, Trajectory

Mode = Callable[[Known, np.random.Generator], Known]


def disturbed(log: Known, kind: str, seed: int = 1) -> Known:
    """The log in one of MODES or KINDS."""
    return (MODES | KINDS)[kind](log, stream(seed, kind))


def stretch(log: Known, share: float, rng: np.random.Generator) -> Mask:
    """Scans of one stretch of the log, (n,)."""
    return log.around(log.places(1, rng), share * log.recording.duration())


def carried(log: Known, rng: np.random.Generator) -> Known:
    """A robot that is carried for a tenth of the log: no scans meanwhile, and wheels that stand still."""
    away = stretch(log, 0.1, rng)
    moved = log.odometry.steps()
    moved[away[:-1]] = 0.0
    return log.with_steps(moved).with_scans(~away)


# Odometry.


def bias(log: Known, rng: np.random.Generator) -> Known:
    """Wheels 5 % long that turn by a degree a metre."""
    moved = log.odometry.steps()
    moved[:, 0] *= 1.05
    moved[:, 2] += np.deg2rad(1.0) * np.abs(moved[:, 0])
    return log.with_steps(moved)


def noisy(log: Known, rng: np.random.Generator) -> Known:
    """Wheel noise of 5 % of the way, and of 10 degrees a radian turned."""
    moved = log.odometry.steps()
    way, turn = np.hypot(moved[:, 0], moved[:, 1]), np.abs(moved[:, 2])
    n = len(moved)
    moved[:, 0] += 0.05 * way * rng.standard_normal(n)
    moved[:, 2] += 0.17 * turn * rng.standard_normal(n) + 0.03 * way * rng.standard_normal(n)
    return log.with_steps(moved)


def late(log: Known, rng: np.random.Generator) -> Known:
    """Odometry 0.3 s late."""
    t, T = log.times, log.odometry
    order = np.argsort(t, kind="stable")
    yaw = np.unwrap(T.yaw[order])
    x, y, yaw = (np.interp(t - 0.3, t[order], values) for values in (T.x[order], T.y[order], yaw))
    return log.with_odometry(SE2.from_xyt(x, y, yaw))


def stuck(log: Known, rng: np.random.Generator) -> Known:
    """Odometry that stands still for 3 s in five turns, and never makes up for it."""
    moved = log.odometry.steps()
    moved[log.around(log.places(5), 3.0)[:-1]] = 0.0
    return log.with_steps(moved)


def jump(log: Known, rng: np.random.Generator) -> Known:
    """Odometry that jumps by 2 m and 60 degrees three times."""
    moved = log.odometry.steps()
    for i in log.places(3, rng):
        way = rng.uniform(-np.pi, np.pi)
        moved[i] += [2.0 * np.cos(way), 2.0 * np.sin(way), np.deg2rad(60.0)]
    return log.with_steps(moved)


def wheels_times(log: Known, rng: np.random.Generator, factor: float) -> Known:
    """Wheels that say so many times the way for a tenth of the log: spinning, or counting the wrong way."""
    moved = log.odometry.steps()
    moved[stretch(log, 0.1, rng)[:-1], :2] *= factor
    return log.with_steps(moved)


def yaw_bias(log: Known, rng: np.random.Generator) -> Known:
    """Odometry that turns by 1.5 degrees a second, and no gyro to tell."""
    moved = log.odometry.steps()
    moved[:, 2] += np.deg2rad(1.5) * np.diff(log.times)
    return log.with_steps(moved).recorded(imu=None)


def mirrored_odometry(log: Known) -> Known:
    """Left and right wheel exchanged, and no gyro to tell."""
    first = log.odometry[0]
    return log.recorded(imu=None).with_odometry(first @ mirrored(first.inverse() @ log.odometry))


# Ranges.


def drop30(log: Known, rng: np.random.Generator) -> Known:
    """No return on 30 % of the beams."""
    return log.without_returns(rng.random(log.recording.ranges.shape) < 0.3)


def noise3(log: Known, rng: np.random.Generator) -> Known:
    """Noise of 3 cm on every range."""
    ranges = log.recording.ranges
    noised = np.maximum(ranges + 0.03 * rng.standard_normal(ranges.shape), 0.05)
    return log.with_ranges(np.where(np.isfinite(ranges), noised, ranges))


def elsewhere(log: Known, rng: np.random.Generator) -> Known:
    """A tenth of the scans were taken at another time, half a log away."""
    there = stretch(log, 0.1, rng)
    other = np.roll(log.recording.ranges, len(there) // 2, axis=0)
    ranges = np.where(there[:, None], other, log.recording.ranges)
    reference = np.where(there[:, None], np.nan, log.reference.xyt)
    return replace(log.with_ranges(ranges), reference=SE2(reference))


def repeated(log: Known, rng: np.random.Generator) -> Known:
    """A lidar that says the same for 5 s, three times."""
    index = np.arange(len(log.recording))
    held = log.around(log.places(3, rng), 5.0)
    return log.with_ranges(log.recording.ranges[np.maximum.accumulate(np.where(held, 0, index))])


def blocked(log: Known, rng: np.random.Generator) -> Known:
    """Half of the view is blocked by something 0.3 m away that rides along."""
    r = log.recording
    hidden = wrap(r.lidar.angles - rng.uniform(-np.pi, np.pi)) > 0.0
    return log.with_ranges(np.where(hidden, np.float32(0.3), r.ranges))


def ghosts(log: Known, rng: np.random.Generator) -> Known:
    """People about: a fifth of all scans have a quarter of their beams end somewhere short."""
    ranges = log.recording.ranges.copy()
    for scan in np.flatnonzero(rng.random(len(ranges)) < 0.2):
        first, width = rng.integers(ranges.shape[1]), ranges.shape[1] // 4
        beams = np.arange(first, first + width) % ranges.shape[1]
        ranges[scan, beams] = np.fmin(ranges[scan, beams], rng.uniform(0.4, 2.0))
    return log.with_ranges(ranges)


def floor(log: Known, rng: np.random.Generator) -> Known:
    """A lidar that tips forward when it brakes: a tenth of the scans see the floor 1.5 m ahead."""
    r = log.recording
    ahead = np.cos(r.lidar.angles)
    strip = np.where(ahead > 0.5, 1.5 / np.maximum(ahead, 0.5), np.inf)
    tipped = rng.random(len(r)) < 0.1
    return log.with_ranges(np.where(tipped[:, None], np.fmin(r.ranges, strip), r.ranges))


# Time.


def jitter(log: Known, rng: np.random.Generator) -> Known:
    """Stamps of scans that are off by up to half the time between two."""
    r = log.recording
    away = rng.uniform(-0.5, 0.5, len(r)) * float(np.median(np.diff(r.stamps_ns)))
    away[[0, -1]] = 0.0
    stamps = np.maximum.accumulate(r.stamps_ns + away.astype(np.int64))
    return log.recorded(stamps_ns=stamps + np.arange(len(r)))


# The lidar says of itself what is not so.


def stamps_back(log: Known, rng: np.random.Generator) -> Known:
    """Stamps of scans that jump back by 10 s once and go on from there: odometry is that of another time."""
    r, stamps = log.recording, log.recording.stamps_ns.copy()
    stamps[log.places(1, rng)[0] :] -= 10 * 10**9
    driven = r.odometry or Trajectory(r.stamps_ns, log.odometry)
    return log.recorded(stamps_ns=stamps, T_odom_base=driven.at(stamps))


def turned_at(log: Known, share: float, beam: int) -> Known:
    """A lidar whose sweep takes `share` of what it says, and whose array begins at another beam."""
    r, lidar = log.recording, log.recording.lidar
    first = lidar.angle_min + beam * lidar.angle_increment
    said = replace(lidar, angle_min=first, time_increment=share * lidar.time_increment)
    return log.recorded(lidar=said, ranges=np.roll(r.ranges, -beam, axis=1))


def narrower(log: Known, rng: np.random.Generator) -> Known:
    """An angle increment that is 4 % too small."""
    lidar = log.recording.lidar
    return log.recorded(lidar=replace(lidar, angle_increment=0.96 * lidar.angle_increment))


def merged(log: Known, rng: np.random.Generator) -> Known:
    """Two lidars in one topic: a half of each scan is that of the scan before."""
    ranges, half = log.recording.ranges.copy(), log.recording.ranges.shape[1] // 2
    ranges[1:, half:] = log.recording.ranges[:-1, half:]
    return log.with_ranges(ranges)


def rolled(log: Known, beams: NDArray[np.int64]) -> Known:
    """Each scan turned by so many beams (n,)."""
    ranges = log.recording.ranges
    which = (np.arange(ranges.shape[1]) + beams[:, None]) % ranges.shape[1]
    return log.with_ranges(np.take_along_axis(ranges, which, axis=1))


def loose(log: Known, rng: np.random.Generator) -> Known:
    """A lidar that sits loose: every five seconds it turns a little, by up to 4 degrees."""
    at = rng.uniform(-4.0, 4.0, int(log.times.max() / 5.0) + 2)[(log.times / 5.0).astype(int)]
    return rolled(log, np.rint(np.deg2rad(at) / log.recording.lidar.angle_increment).astype(np.int64))


def bumped(log: Known, rng: np.random.Generator) -> Known:
    """A lidar that somebody bumps into: from then on it is turned by 6 degrees."""
    after = np.arange(len(log.times)) >= log.places(1, rng)[0]
    return rolled(log, after * round(np.deg2rad(6.0) / log.recording.lidar.angle_increment))


def slow_clock(log: Known, rng: np.random.Generator) -> Known:
    """A lidar whose clock loses a second in 200."""
    r = log.recording
    stamps = r.stamps_ns[0] + (0.995 * (r.stamps_ns - r.stamps_ns[0])).astype(np.int64)
    return log.recorded(stamps_ns=stamps)


def swapped(log: Known, rng: np.random.Generator) -> Known:
    """Scans that overtake each other: one in ten changes places with the next."""
    order = np.arange(len(log.recording))
    for k in np.flatnonzero(rng.random(len(order) - 1) < 0.1).tolist():
        order[[k, k + 1]] = order[[k + 1, k]]
    return log.with_ranges(log.recording.ranges[order])


def resent(log: Known, rng: np.random.Generator) -> Known:
    """A driver that sends one scan in five twice, in place of the next."""
    index = np.arange(len(log.recording))
    return log.with_ranges(log.recording.ranges[np.where(rng.random(len(index)) < 0.2, index - 1, index)])


def flat_tyre(log: Known, rng: np.random.Generator) -> Known:
    """A wheel that becomes smaller: from then on odometry turns by 8 degrees a metre."""
    moved = log.odometry.steps()
    after = np.arange(len(moved)) >= log.places(1, rng)[0]
    moved[:, 2] += after * np.deg2rad(8.0) * moved[:, 0]
    return log.with_steps(moved)


def crosstalk(log: Known, rng: np.random.Generator) -> Known:
    """Another lidar in the room: a tenth of the beams end somewhere short."""
    ranges = log.recording.ranges
    short = rng.uniform(0.15, 1.0, ranges.shape) * np.where(np.isfinite(ranges), ranges, 3.0)
    return log.with_ranges(np.where(rng.random(ranges.shape) < 0.1, short, ranges))


# All of it.


def mirrored(T: SE2) -> SE2:
    """Poses in the mirror that stands along the x axis."""
    return SE2.from_array(T.xyt * [1.0, -1.0, -1.0])


def mirror(log: Known, rng: np.random.Generator) -> Known:
    """The world in a mirror: left is right for scans, odometry, gyro and truth."""
    r, imu, pairs = log.mirrored_scans().recording, log.recording.imu, log.relations
    if r.odometry is not None:
        r = replace(r, odometry=replace(r.odometry, poses=mirrored(r.odometry.poses)))
    if imu is not None:
        turned, pushed = imu.angular_velocity * [-1.0, 1.0, -1.0], imu.linear_acceleration * [1.0, -1.0, 1.0]
        r = replace(r, imu=ImuLog(imu.stamps_ns, turned, pushed))
    recording = replace(r, T_base_lidar=mirrored(r.T_base_lidar), T_odom_base=mirrored(log.odometry))
    relations = replace(pairs, T_a_b=mirrored(pairs.T_a_b))
    return replace(log, recording=recording, reference=mirrored(log.reference), relations=relations)


def reverse(log: Known, rng: np.random.Generator) -> Known:
    """The log played backwards. ValueError for a lidar whose beams are not taken all at once."""
    r, pairs = log.recording, log.relations
    if r.lidar.time_increment != 0.0:
        raise ValueError(f"{r.source}: a turning lidar cannot be played backwards")
    ends = r.stamps_ns[0] + r.stamps_ns[-1]
    if (driven := r.odometry) is not None:
        r = replace(r, odometry=Trajectory(ends - driven.stamps_ns[::-1], driven.poses[::-1]))
    if (imu := r.imu) is not None:
        turned, pushed = -imu.angular_velocity[::-1], imu.linear_acceleration[::-1]
        r = replace(r, imu=ImuLog(ends - imu.stamps_ns[::-1], turned, pushed))
    stamps, T_odom_base = ends - r.stamps_ns[::-1], log.odometry[::-1]
    recording = replace(r, stamps_ns=stamps, ranges=r.ranges[::-1], T_odom_base=T_odom_base)
    relations = Relations(ends - pairs.stamps_a_ns, ends - pairs.stamps_b_ns, pairs.T_a_b)
    return replace(log, recording=recording, reference=log.reference[::-1], relations=relations)


MODES: dict[str, Mode] = {
    "gap3": lambda log, rng: log.with_scans(~log.around(log.places(5), 3.0)),
    "gap20": lambda log, rng: log.with_scans(~log.around(log.places(3, rng), 20.0)),
    "half": lambda log, rng: log.with_scans(slice(None, None, 2)),
    "third": lambda log, rng: log.with_scans(slice(None, None, 3)),
    "bias": bias,
    "noisy": noisy,
    "late": late,
    "stuck": stuck,
    "jump": jump,
    "range8": lambda log, rng: log.shortened(8.0),
    "fov120": lambda log, rng: log.without_returns(log.outside(120.0)),
    "drop30": drop30,
    "noise3": noise3,
    "mirror": mirror,
    "reverse": reverse,
}
"""gap3 loses 3 s of scans in each of five turns, gap20 20 s three times; half and third keep every second
and third scan; range8 sees 8 m far, fov120 120 degrees wide."""
KINDS: dict[str, Mode] = {
    **{name: MODES[name] for name in ("gap3", "half", "bias", "late", "stuck", "drop30")},
    "short sight": lambda log, rng: log.shortened(0.4 * log.recording.lidar.range_max),
    "elsewhere": elsewhere,
    "slipped": lambda log, rng: wheels_times(log, rng, 3.0),
    "mirrored scans": lambda log, rng: log.mirrored_scans(),
    **{name: MODES[name] for name in ("gap20", "third", "noisy", "jump", "fov120", "noise3")},
    "repeated": repeated,
    "counted back": lambda log, rng: wheels_times(log, rng, -1.0),
    "carried": carried,
    "yaw bias": yaw_bias,
    "mirrored odometry": lambda log, rng: mirrored_odometry(log),
    "long ranges": lambda log, rng: log.with_ranges(1.05 * log.recording.ranges),
    "blocked": blocked,
    "jitter": jitter,
    "ghosts": ghosts,
    "floor": floor,
    "other odometry": lambda log, rng: log.with_odometry(log.odometry[::-1]),
    "stamps back": stamps_back,
    "sweep of a twentieth": lambda log, rng: turned_at(log, 0.05, 0),
    "increment": narrower,
    "one metre": lambda log, rng: log.with_ranges(np.ones(log.recording.ranges.shape)),
    "reversed sweep": lambda log, rng: turned_at(log, -1.0, 0),
    "start in mid-sweep": lambda log, rng: turned_at(log, 1.0, log.recording.ranges.shape[1] // 2),
    "merged": merged,
    "loose": loose,
    "bumped": bumped,
    "slow clock": slow_clock,
    "swapped": swapped,
    "resent": resent,
    "flat tyre": flat_tyre,
    "crosstalk": crosstalk,
    "steps of 5 cm": lambda log, rng: log.with_ranges(np.round(20.0 * log.recording.ranges) / 20.0),
}
"""How a log is disturbed, by kind; `plain` is undisturbed, and of the half of its case's number."""
SCORED = (
    "gap20", "third", "noisy", "fov120", "noise3", "counted back", "carried", "yaw bias", "long ranges",
    "blocked", "jitter", "ghosts", "floor", "other odometry", "steps of 5 cm", "reversed sweep",
    "start in mid-sweep", "merged", "loose", "bumped", "slow clock", "swapped", "resent", "flat tyre",
    "crosstalk",
)  # fmt: skip
"""Kinds that only tell how good the self-check is."""
