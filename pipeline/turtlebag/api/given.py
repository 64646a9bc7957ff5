"""Poses and samples that are passed to `import turtlebag`, checked where a wrong one would spoil a map."""

from __future__ import annotations

import os
from collections.abc import Iterable, Sequence

import numpy as np

from turtlebag.datasets import types
from turtlebag.datasets.errors import InputError
from turtlebag.datasets.se2 import SE2
from turtlebag.datasets.types import Imu, Scan
from turtlebag.pipeline.stages.requests.options import pose as xyt_of

PathLike = str | os.PathLike[str]
Pose = SE2 | Sequence[float] | np.ndarray
"""x, y [m] and yaw [rad]: three numbers, or an SE2."""
LATEST_NS = 2**62


def pose(value: Pose, what: str) -> SE2:
    """A pose from three numbers; InputError names `what` where they are not finite."""
    try:
        return SE2.from_xyt(*xyt_of(value))
    except ValueError as error:
        raise InputError(f"{what}: {error}") from None


def scan(scan: Scan, last: Scan | None) -> Scan:
    """A scan that meets the requirements: increasing stamp [ns], (n_beams,) float32, always the same lidar.
    Ranges may be inf or NaN (REP-117)."""
    _require_later(scan.stamp_ns, None if last is None else last.stamp_ns, "scan")
    ranges = np.asarray(scan.ranges, dtype=np.float32)
    if ranges.shape != (scan.lidar.n_beams,):
        raise InputError(
            f"scan.ranges: has shape {ranges.shape}; its lidar has {scan.lidar.n_beams} beams, "
            f"so it must be ({scan.lidar.n_beams},)"
        )
    if last is not None and scan.lidar != last.lidar:
        raise InputError("scan.lidar: differs from that of the scans before")
    return Scan(int(scan.stamp_ns), ranges, scan.lidar, scan.sensor)


def odometry(
    odometry: Pose | types.Trajectory | None, last: SE2 | types.Trajectory | None, first: bool
) -> SE2 | types.Trajectory | None:
    """A pose, a trajectory with increasing stamps, or None; the same kind as for the earlier scans."""
    found: SE2 | types.Trajectory | None
    if isinstance(odometry, types.Trajectory):
        if len(odometry) == 0:
            raise InputError("odometry: has no poses; give those since the last scan")
        if not np.isfinite(odometry.poses.xyt).all():
            raise InputError("odometry: has poses that are not finite")
        before = last.stamps_ns[-1:] if isinstance(last, types.Trajectory) else odometry.stamps_ns[:0]
        if np.any(np.diff(np.concatenate([before, odometry.stamps_ns])) <= 0):
            raise InputError("odometry: stamps must increase, also from one scan to the next")
        found = odometry
    else:
        found = None if odometry is None else pose(odometry, "odometry")
    if not first and _kind(found) != _kind(last):
        raise InputError(f"odometry: was {_kind(last)} for earlier scans, is {_kind(found)} now")
    return found


def imu(imu: Iterable[Imu]) -> list[Imu]:
    """Samples with finite (3,) arrays and increasing stamps."""
    samples, last = list(imu), None
    for sample in samples:
        _require_later(sample.stamp_ns, last, "imu")
        last = sample.stamp_ns
        for name in ("angular_velocity", "linear_acceleration"):
            values = np.asarray(getattr(sample, name), dtype=np.float64)
            if values.shape != (3,) or not np.isfinite(values).all():
                raise InputError(f"imu.{name}: expected three finite numbers, not {values.tolist()}")
    return samples


def _require_later(stamp_ns: int, last_ns: int | None, what: str) -> None:
    if abs(stamp_ns) > LATEST_NS:
        raise InputError(f"{what}.stamp_ns: {stamp_ns} is not a time in nanoseconds")
    if last_ns is not None and stamp_ns <= last_ns:
        raise InputError(f"{what}.stamp_ns: {stamp_ns} is not after the last one's, {last_ns}")


def _kind(odometry: object) -> str:
    if odometry is None:
        return "none"
    return "a trajectory" if isinstance(odometry, types.Trajectory) else "a pose"
