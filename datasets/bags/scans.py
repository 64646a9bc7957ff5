"""LaserScan messages into one matrix of ranges with one geometry, whatever the driver's habits."""

from __future__ import annotations

import math
from collections import Counter
from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from datasets.bags.decode import RawScan
from datasets.se2 import wrap
from datasets.types import LidarSpec

Ranges = NDArray[np.float32]
Geometry = tuple[tuple[float, ...], int]


def assemble(scans: Sequence[RawScan], notes: list[str]) -> tuple[Ranges, LidarSpec]:
    """(n_scans, n_beams) REP-117 ranges and the geometry of the beams; ValueError when there is none.

    The most frequent geometry is kept. Scans of another are resampled to the nearest beam, which
    leaves NaN where they have none.
    """
    keys: list[Geometry] = [(scan.geometry, len(scan.ranges)) for scan in scans]
    usable = Counter(key for key in keys if _usable(*key))
    if not usable:
        raise ValueError("no scan has a usable geometry")
    main = usable.most_common(1)[0][0]
    lidar = _lidar(main, notes)
    ranges = np.full((len(scans), lidar.n_beams), np.nan, dtype=np.float32)
    same = [index for index, key in enumerate(keys) if key == main]
    ranges[same] = [scans[index].ranges for index in same]
    maps: dict[Geometry, NDArray[np.int64]] = {}
    for index, key in enumerate(keys):
        if key != main and key in usable:
            if key not in maps:
                maps[key] = _nearest_beams(_increment(*key), key, lidar)
            picked = maps[key]
            ranges[index, picked >= 0] = scans[index].ranges[picked[picked >= 0]]
    if len(usable) > 1:
        notes.append(f"{len(scans) - len(same)} scans of another geometry resampled to {lidar.n_beams} beams")
    if len(usable) < len(set(keys)):
        notes.append(f"{sum(key not in usable for key in keys)} scans without a usable geometry left empty")
    return _normalised(ranges, lidar, notes), lidar


def _usable(geometry: tuple[float, ...], n: int) -> bool:
    angle_min, angle_max, increment, *_ = geometry
    return (
        n > 0
        and all(map(math.isfinite, (angle_min, angle_max, increment)))
        and (increment != 0.0 or angle_max != angle_min or n == 1)
    )


def _increment(geometry: tuple[float, ...], n: int) -> float:
    angle_min, angle_max, increment, *_ = geometry
    return increment if increment else (angle_max - angle_min) / max(n - 1, 1)


def _lidar(key: Geometry, notes: list[str]) -> LidarSpec:
    geometry, n = key
    angle_min, angle_max, _, time_increment, scan_time, range_min, range_max = geometry
    increment = _increment(*key)
    steps = (angle_max - angle_min) / increment if increment else 0.0
    if abs(steps - (n - 1)) > 0.5:
        notes.append(
            f"angle_max speaks of {round(steps) + 1} beams, the scans have {n}; the increment is believed"
        )
    if not (math.isfinite(range_min) and range_min >= 0.0):
        range_min = 0.0
    if not (math.isfinite(range_max) and range_max > range_min):
        notes.append(f"range_max is {range_max:g}; 100 m used")
        range_max = 100.0
    return LidarSpec(
        n,
        angle_min,
        increment,
        range_min,
        range_max,
        time_increment if math.isfinite(time_increment) else 0.0,
        scan_time if math.isfinite(scan_time) else 0.0,
    )


def _nearest_beams(increment: float, key: Geometry, lidar: LidarSpec) -> NDArray[np.int64]:
    """For each beam of `lidar` the index of the nearest one of another geometry, -1 without one."""
    (angle_min, *_), n = key
    own = angle_min + increment * np.arange(n)
    difference = np.abs(wrap(lidar.angles[:, None] - own))
    nearest = difference.argmin(axis=1)
    close = difference[np.arange(lidar.n_beams), nearest] <= 0.51 * abs(lidar.angle_increment)
    return np.where(close, nearest, -1)


def _normalised(ranges: Ranges, lidar: LidarSpec, notes: list[str]) -> Ranges:
    """REP-117: 0 and below is no measurement, past range_max no return, within range_min too near."""
    with np.errstate(invalid="ignore"):
        zero = np.isfinite(ranges) & (ranges <= 0.0)
        far = np.isfinite(ranges) & (ranges > np.float32(lidar.range_max))
        near = (ranges > 0.0) & (ranges < np.float32(lidar.range_min))
    ranges[zero], ranges[far], ranges[near] = np.nan, np.inf, -np.inf
    if zero.any():
        notes.append(
            f"{100.0 * zero.mean():.1f} % of the readings are 0: taken for invalid, not for free space"
        )
    if far.any():
        notes.append(f"{100.0 * far.mean():.1f} % of the readings are past range_max: taken for no return")
    return ranges


def turned_over(ranges: Ranges, lidar: LidarSpec) -> tuple[Ranges, LidarSpec]:
    """The scans of a lidar mounted upside down, as one of the upright geometry would have given them."""
    last = lidar.angle_min + (lidar.n_beams - 1) * lidar.angle_increment
    upright = LidarSpec(
        lidar.n_beams,
        -last,
        lidar.angle_increment,
        lidar.range_min,
        lidar.range_max,
        -lidar.time_increment,
        lidar.scan_time,
    )
    return np.ascontiguousarray(ranges[:, ::-1]), upright
