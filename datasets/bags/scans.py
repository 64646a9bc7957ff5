"""LaserScan messages as one matrix of ranges with one beam geometry, for all drivers' conventions."""

from __future__ import annotations

import math
from collections import Counter
from collections.abc import Iterable, Iterator, Sequence
from dataclasses import replace
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from turtlebag.datasets.bags.decode import RawScan
from turtlebag.datasets.bags.plausibility import directed, limits_in_millimetres, ranges_in_millimetres
from turtlebag.datasets.findings import Finding
from turtlebag.datasets.no_return_range import no_return_value
from turtlebag.datasets.plurals import counted
from turtlebag.datasets.se2 import Array
from turtlebag.datasets.types import LidarSpec, Stamps

Ranges = NDArray[np.float32]

_OVERSAMPLING = 4
"""Beams of a grid for one of the scanner, where the scanner's own angles change from scan to scan."""
_LONGEST_SWEEP_S = 60.0
_SLOWER = 1.2
"""Times between scans that a sweep may seem to take."""
_FASTEST_HZ = 80.0
"""No lidar's head turns faster (SICK LMS 2xx: 75 Hz)."""
_ALL_ROUND = 0.95
"""Share of a turn over which the beams of a lidar that surely turns are spread."""
_ALIGNED = 0.05
"""Share of an increment that beams may lie beside the grid's without mattering."""
_WORTH_SAYING = 0.01
"""Share of readings that is more than noise (0.2 % are at range_max in the simulated house)."""


class Geometry(NamedTuple):
    """What must be equal for two scans to share their beams; the sweep time may vary with the motor."""

    angle_min: float
    angle_max: float
    increment: float
    range_min: float
    range_max: float
    n: int

    def step(self) -> float:
        """Angle between beams, also where the driver left the increment 0."""
        return self.increment or (self.angle_max - self.angle_min) / max(self.n - 1, 1)

    def usable(self) -> bool:
        """Whether the beams have directions."""
        return math.isfinite(self.angle_max) and directed(self.angle_min, self.step(), self.n)


def assemble(
    topic: str, scans: Sequence[RawScan], log_times: Stamps, findings: list[Finding]
) -> tuple[Ranges, LidarSpec]:
    """(n_scans, n_beams) REP-117 ranges and the beam geometry of a topic's scans; ValueError without one.

    The angles are those of `on_one_grid`, the readings in metres and normalised. `log_times` (n_scans,) [ns].
    """
    keys = [_geometry(scan) for scan in scans]
    usable = Counter(key for key in keys if key.usable())
    if not usable:
        key = Counter(keys).most_common(1)[0][0]
        raise ValueError(f"{key.n} readings from {key.angle_min:g} rad on, {key.step():g} rad apart")
    lidar = _lidar(topic, usable.most_common(1)[0][0], scans, findings)
    ranges, lidar = on_one_grid(topic, [scan.ranges for scan in scans], keys, lidar, findings)
    findings += _empty(topic, scans, log_times)
    lidar = _in_metres(topic, ranges, lidar, findings)
    return _normalised(topic, ranges, lidar, findings), lidar


def on_one_grid(
    topic: str,
    scans: Sequence[NDArray[np.floating]],
    keys: Sequence[Geometry],
    lidar: LidarSpec,
    findings: list[Finding],
) -> tuple[Ranges, LidarSpec]:
    """Scans of any geometries as (n_scans, n_beams), and the beams they are put on.

    `lidar` is the most frequent geometry, which is kept. Scans of another are resampled to the nearest
    beam, which leaves NaN where they have none; a scanner whose angles change all the time (LDS-02,
    interlacing SICKs) is put on a finer grid, so that no reading is turned by more than an eighth of
    its increment.
    """
    usable = Counter(key for key in keys if key.usable())
    other = len(scans) - usable.most_common(1)[0][1]
    sizes = sorted({key.n for key in usable})
    varied = f" ({sizes[0]}..{sizes[-1]} readings)" if len(sizes) > 1 else ""
    beside = sum(number for key, number in usable.items() if not _aligned(key, lidar))
    if beside > 0.1 * len(scans):
        lidar = _finer(lidar)
        what, remedy = "the beam angles change from scan to scan", f"put on a grid of {lidar.n_beams} beams"
        findings.append(Finding("fence-post", topic, what + varied, other, remedy=remedy))
    elif len(usable) > 1:
        what, remedy = f"{other} scans of another geometry", f"resampled to {lidar.n_beams} beams"
        findings.append(Finding("fence-post", topic, what + varied, other, remedy=remedy))
    if len(usable) < len(set(keys)):
        count = sum(key not in usable for key in keys)
        what = f"{counted(count, 'scan')} without a usable geometry"
        findings.append(Finding("beam angles", topic, what, count, remedy="left empty"))
    ranges = np.full((len(scans), lidar.n_beams), np.nan, dtype=scans[0].dtype)
    places = {key: _places(key, lidar) for key in usable}
    for row, scan, key in zip(ranges, scans, keys, strict=True):
        if key in usable:
            beams = places[key]
            row[beams[beams >= 0]] = scan[beams >= 0]
    return ranges, lidar


def _geometry(scan: RawScan) -> Geometry:
    angle_min, angle_max, increment, _, _, range_min, range_max = scan.geometry
    return Geometry(angle_min, angle_max, increment, range_min, range_max, len(scan.ranges))


def _lidar(topic: str, key: Geometry, scans: Sequence[RawScan], findings: list[Finding]) -> LidarSpec:
    """The beams of the most frequent geometry, with what drivers leave out or state wrongly made up for."""
    step, range_min, range_max = key.step(), key.range_min, key.range_max
    steps = (key.angle_max - key.angle_min) / step if step else 0.0
    if not key.increment and key.n > 1:
        remedy = f"angle_min and angle_max say {step:g} rad"
        findings.append(Finding("beam angles", topic, "angle_increment is 0", len(scans), remedy=remedy))
    if abs(steps - (key.n - 1)) > 0.5:
        implied = f"angle_min, angle_max and the increment imply {round(steps) + 1}"
        what = f"{key.n} readings, but {implied}"
        findings.append(Finding("fence-post", topic, what, len(scans), remedy="the increment is used"))
    if not (math.isfinite(range_min) and range_min >= 0.0):
        range_min = 0.0
    if not (math.isfinite(range_max) and range_max > range_min):
        range_max = 100.0
    if (range_min, range_max) != (key.range_min, key.range_max):
        what = f"valid ranges {key.range_min:g}..{key.range_max:g} m"
        remedy = f"{range_min:g}..{range_max:g} m used"
        findings.append(Finding("range limits", topic, what, len(scans), remedy=remedy))
    times = [_median(scan.geometry[index] for scan in scans) for index in (3, 4)]
    turn = key.n * abs(step) / (2.0 * math.pi)
    times[0] = _increment(topic, times, turn, scans, findings)
    return LidarSpec(key.n, key.angle_min, step, range_min, range_max, times[0], times[1])


def _increment(
    topic: str, times: list[float], turn: float, scans: Sequence[RawScan], findings: list[Finding]
) -> float:
    """The time between beams [s] as far as it can be believed, where drivers state it and the time of a scan
    as `times`, of beams over a `turn` of the head."""
    sweep_s, period_s = abs(times[0]) * len(scans[0].ranges), _period_s(scans)
    every = f", a scan comes every {period_s:.3f} s" if math.isfinite(period_s) else ""
    what, increment = f"time_increment implies a sweep of {sweep_s:.3f} s{every}", times[0]
    if sweep_s > min(_LONGEST_SWEEP_S, _SLOWER * period_s):
        increment, remedy = 0.0, "taken as 0"
    elif turn > _ALL_ROUND and 0.0 < sweep_s * _FASTEST_HZ < turn:
        what, remedy = f"{what}, and no lidar turns that fast", "taken as 0"
        increment = 0.0
    elif turn > _ALL_ROUND and times == [0.0, 0.0]:
        what = "time_increment and scan_time are 0: how long a sweep takes is unknown"
        remedy = "taken as 0"
    else:
        return increment
    findings.append(Finding("sweep time", topic, what, len(scans), remedy=remedy))
    return increment


def _period_s(scans: Sequence[RawScan]) -> float:
    """The usual time from scan to scan [s], or the mean if it is longer: stamps may come in bursts; infinite
    where they do not tell it."""
    stamps = np.array([scan.stamp_ns for scan in scans], dtype=np.int64)
    steps = np.diff(stamps) * 1e-9
    period = max(float(np.median(steps)), float(np.mean(steps))) if len(steps) else 0.0
    return period if period > 0.0 else math.inf


def _empty(topic: str, scans: Sequence[RawScan], log_times: Stamps) -> Iterator[Finding]:
    """Scans without a number or without a return."""
    nothing = np.array([bool(np.isnan(scan.ranges).all()) for scan in scans])
    returns = np.array([bool((np.isfinite(scan.ranges) & (scan.ranges > 0.0)).any()) for scan in scans])
    for empty, what in ((nothing, "are NaN only"), (~nothing & ~returns, "have no return at all")):
        if count := int(np.count_nonzero(empty)):
            first = int(log_times[np.argmax(empty)])
            yield Finding("empty scans", topic, f"{count} of {len(scans)} scans {what}", count, first)


def _in_metres(topic: str, ranges: Ranges, lidar: LidarSpec, findings: list[Finding]) -> LidarSpec:
    """The lidar in metres, and its readings in place, where a driver wrote millimetres."""
    if not ranges_in_millimetres(ranges[:: 1 + len(ranges) // 200], lidar.range_max):
        return lidar
    ranges /= np.float32(1000.0)
    what = "the readings exceed any lidar's range"
    findings.append(Finding("millimetres", topic, what, len(ranges), remedy="read as millimetres"))
    if not limits_in_millimetres(lidar.range_max):
        return lidar
    return replace(lidar, range_min=lidar.range_min / 1000.0, range_max=lidar.range_max / 1000.0)


def _median(values: Iterable[float]) -> float:
    """Median of what is finite, 0 when nothing is."""
    finite = [value for value in values if math.isfinite(value)]
    return float(np.median(finite)) if finite else 0.0


def _finer(lidar: LidarSpec) -> LidarSpec:
    """The same sweep on a finer grid; full circles keep a whole number of beams."""
    span = lidar.n_beams * abs(lidar.angle_increment)
    whole_turn = abs(span - 2.0 * math.pi) < 2.0 * abs(lidar.angle_increment)
    n = _OVERSAMPLING * lidar.n_beams
    step = math.copysign((2.0 * math.pi if whole_turn else span) / n, lidar.angle_increment)
    share = step / lidar.angle_increment
    return replace(lidar, n_beams=n, angle_increment=step, time_increment=lidar.time_increment * share)


def _offsets(key: Geometry, lidar: LidarSpec) -> Array:
    """Where the beams of a geometry fall on the grid of `lidar`, in beams of the grid, (n,)."""
    angles = key.angle_min + key.step() * np.arange(key.n)
    half = 0.5 * abs(lidar.angle_increment)
    ahead = np.sign(lidar.angle_increment) * (angles - lidar.angle_min)
    return ((ahead + half) % (2.0 * math.pi) - half) / abs(lidar.angle_increment)


def _same_beams(key: Geometry, lidar: LidarSpec) -> bool:
    return lidar.angle_increment == 0.0 or (key.angle_min, key.step()) == (
        lidar.angle_min,
        lidar.angle_increment,
    )


def _aligned(key: Geometry, lidar: LidarSpec) -> bool:
    """Whether the beams of a geometry lie on those of `lidar`."""
    if _same_beams(key, lidar):
        return True
    offsets = _offsets(key, lidar)
    return float(np.abs(offsets - np.rint(offsets)).max()) <= _ALIGNED


def _places(key: Geometry, lidar: LidarSpec) -> NDArray[np.int64]:
    """Index on the grid for each beam of a geometry, -1 for those outside it."""
    if _same_beams(key, lidar):  # also where the last beam meets the first, as Gazebo's does
        return np.where(np.arange(key.n) < lidar.n_beams, np.arange(key.n), -1)
    places = np.rint(_offsets(key, lidar)).astype(np.int64)
    if abs(lidar.n_beams * abs(lidar.angle_increment) - 2.0 * math.pi) < abs(lidar.angle_increment) / 2.0:
        places %= lidar.n_beams
    return np.where((places >= 0) & (places < lidar.n_beams), places, -1)


def _normalised(topic: str, ranges: Ranges, lidar: LidarSpec, findings: list[Finding]) -> Ranges:
    """REP-117: 0 and below is no measurement, from range_max on no return, within range_min too near."""
    with np.errstate(invalid="ignore"):
        zero = np.isfinite(ranges) & (ranges <= 0.0)
        far = np.isfinite(ranges) & lidar.silent(ranges)
        near = (ranges > 0.0) & (ranges < np.float32(lidar.range_min))
    ranges[zero], ranges[far], ranges[near] = np.nan, np.inf, -np.inf
    limit = no_return_value(ranges)
    piled = np.isfinite(ranges) & (ranges >= limit)
    ranges[piled] = np.inf
    for kind, which, what, remedy in (
        ("zero readings", zero, "are 0", "read as invalid, not as free space"),
        ("no-return readings", far, "are at or past range_max", "read as no return"),
        ("no-return readings", piled, f"pile up at {limit:g} m", "read as no return"),
    ):
        share, count = float(which.mean()), int(np.count_nonzero(which))
        if share >= _WORTH_SAYING or (which is piled and count):
            findings.append(
                Finding(kind, topic, f"{100.0 * share:.1f} % of the readings {what}", count, remedy=remedy)
            )
    return ranges
