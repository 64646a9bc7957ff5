"""Checks of a user's own arrays: each error is one line."""

from __future__ import annotations

import operator
from collections.abc import Sequence
from typing import Any

import numpy as np

from turtlebag.api.making import Pose, pose_of
from turtlebag.datasets import types
from turtlebag.datasets.errors import InputError
from turtlebag.datasets.parts import told_kind
from turtlebag.datasets.plurals import one
from turtlebag.datasets.se2 import SE2
from turtlebag.datasets.types import Imu, LidarSpec, Scan

LATEST_NS = 2**62


def require_kind(value: object, kind: type, what: str) -> None:
    """InputError unless it is of this kind."""
    if not isinstance(value, kind):
        raise InputError(f"{what}: expected {one(kind.__name__)}, not {told_kind(value)}")


def checked_scan(scan: Scan, last: Scan | None) -> Scan:
    """A scan that meets the requirements: increasing integer stamp [ns], (n_beams,) float32, always the same
    lidar. Ranges may be inf or NaN (REP-117)."""
    require_kind(scan, Scan, "scan")
    require_kind(scan.lidar, LidarSpec, "scan.lidar")
    stamp = _stamp(scan.stamp_ns, "scan.stamp_ns")
    try:
        ranges = np.asarray(scan.ranges, dtype=np.float32)
    except (TypeError, ValueError):
        raise InputError("scan.ranges: expected an array of metres") from None
    if ranges.shape != (scan.lidar.n_beams,):
        raise InputError(
            f"scan.ranges: has shape {ranges.shape}; its lidar has {scan.lidar.n_beams} beams, "
            f"so it must be ({scan.lidar.n_beams},)"
        )
    if last is not None and stamp <= last.stamp_ns:
        raise InputError(f"scan.stamp_ns: {stamp} is not after the last scan's, {last.stamp_ns}")
    if last is not None and scan.lidar != last.lidar:
        raise InputError("scan.lidar: differs from that of the scans before")
    return Scan(stamp, ranges, scan.lidar)


def checked_odometry(
    odometry: Pose | types.Trajectory | None, last: SE2 | types.Trajectory | None, first: bool
) -> SE2 | types.Trajectory | None:
    """A pose, a trajectory with increasing stamps, or None; the same kind as for the earlier scans."""
    found = odometry
    if isinstance(odometry, types.Trajectory):
        stamps = odometry.stamps_ns
        if stamps.dtype.kind not in "iu" or odometry.poses.xyt.shape != (len(stamps), 3):
            raise InputError("odometry: expected stamps (n,) in whole nanoseconds and poses (n, 3)")
        if len(odometry) == 0:
            raise InputError("odometry: has no poses; give those since the last scan")
        if not np.isfinite(odometry.poses.xyt).all():
            raise InputError("odometry: has poses that are not finite")
        before = last.stamps_ns[-1:] if isinstance(last, types.Trajectory) else stamps[:0]
        if np.any(np.diff(np.concatenate([before, stamps])) <= 0):
            raise InputError("odometry: stamps must increase, also from one scan to the next")
    elif odometry is not None:
        found = pose_of(odometry, "odometry")
    if not first and _kind(found) != _kind(last):
        raise InputError(f"odometry: was {_kind(last)} for earlier scans, is {_kind(found)} now")
    return found  # type: ignore[return-value]


def checked_imu(imu: Sequence[Imu]) -> Sequence[Imu]:
    """Samples with finite (3,) arrays and increasing stamps."""
    last = -LATEST_NS
    for sample in imu:
        require_kind(sample, Imu, "imu")
        stamp = _stamp(sample.stamp_ns, "imu.stamp_ns")
        if stamp <= last:
            raise InputError(f"imu.stamp_ns: {stamp} is not after the sample before")
        last = stamp
        for name in ("angular_velocity", "linear_acceleration"):
            values = np.asarray(getattr(sample, name))
            if values.shape != (3,) or not np.isfinite(values).all():
                raise InputError(f"imu.{name}: expected three finite numbers, not {values.tolist()}")
    return imu


def _kind(odometry: Any) -> str:
    if odometry is None:
        return "none"
    return "a trajectory" if isinstance(odometry, types.Trajectory) else "a pose"


def _stamp(value: Any, what: str) -> int:
    try:
        stamp = operator.index(value)
    except TypeError:
        raise InputError(f"{what}: expected whole nanoseconds, not {value!r}") from None
    if abs(stamp) > LATEST_NS:
        raise InputError(f"{what}: {stamp} is not a time in nanoseconds")
    return stamp
