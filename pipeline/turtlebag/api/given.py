"""What a person passes to `import turtlebag`: each check raises one line that names the argument."""

from __future__ import annotations

import inspect
import json
import math
import operator
import os
import textwrap
from collections.abc import Iterable, Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from turtlebag.datasets import types
from turtlebag.datasets.errors import InputError
from turtlebag.datasets.parts import name_of, told_kind
from turtlebag.datasets.plurals import one
from turtlebag.datasets.se2 import SE2, Array
from turtlebag.datasets.types import Imu, LidarSpec, Scan
from turtlebag.datasets.yaml_files import parsed

PathLike = str | os.PathLike[str]
Pose = SE2 | Sequence[float] | np.ndarray
"""x, y [m] and yaw [rad]: three numbers, or an SE2."""
FARTHEST = 1e9
LATEST_NS = 2**62


def number(value: Any, what: str, expected: str, low: float = -math.inf, high: float = math.inf) -> float:
    """A number between the two; InputError says what was expected if it is not."""
    try:
        found = math.nan if isinstance(value, str | bytes) else float(value)
    except (TypeError, ValueError, OverflowError):
        found = math.nan
    if not low < found < high:
        raise InputError(f"{what}: expected {expected}, not {in_a_line(value)}")
    return found


def in_a_line(value: object) -> str:
    """A value as one line of limited length."""
    return textwrap.shorten(repr(value), 100, placeholder=" ...")


def pose(value: Pose, what: str) -> SE2:
    """A pose from three numbers; InputError names `what` if it is not one."""
    given = value.xyt if isinstance(value, SE2) else value
    xyt = _three(given)
    if xyt is None or np.abs(xyt).max() > FARTHEST:
        raise InputError(
            f"{what}: expected three finite numbers x, y, yaw in metres and radians, not {in_a_line(given)}"
        )
    return SE2.from_xyt(*xyt.tolist())


def _three(values: Any) -> Array | None:
    """Three finite numbers as an array (3,); None for anything else."""
    try:
        found = np.asarray(values, dtype=np.float64)
    except (TypeError, ValueError, OverflowError):
        return None
    return found if found.shape == (3,) and np.isfinite(found).all() else None


def initial_pose(value: Pose | str | None, *words: str) -> SE2 | str | None:
    """The initial pose: a pose, one of the words, or None; InputError for anything else."""
    if value is None or (isinstance(value, str) and value in words):
        return value
    if isinstance(value, str):
        raise InputError(f"initial_pose: expected x, y, yaw or {' or '.join(words)}, not {value!r}")
    return pose(value, "initial_pose")


def pose_text(pose: SE2) -> str:
    """A pose as the command line takes it, with all digits."""
    return ",".join(repr(float(number)) for number in pose.xyt)


def laser(laser: Pose | None, upside_down: bool) -> str | None:
    """The pose of a laser as the command line takes it; InputError if it is not one."""
    if laser is not None:
        return pose_text(pose(laser, "laser")) + (",upside-down" if upside_down else "")
    if upside_down:
        raise InputError("upside_down: give laser, the pose of the laser on the robot, with it")
    return None


def text(value: PathLike, what: str, kind: str = "a name or a path") -> str:
    """A name or a path as text; InputError names `what` if it is neither."""
    text = os.fspath(value) if isinstance(value, str | os.PathLike) else None
    if not isinstance(text, str) or not text or "\0" in text:
        shown = repr(value) if isinstance(value, str | bytes) else told_kind(value)
        raise InputError(f"{what}: expected {kind}, not {shown}")
    return text


def path(value: PathLike, what: str) -> Path:
    """A path; InputError names `what` if it is not one."""
    return Path(text(value, what, "a path"))


def path_if(value: PathLike | None, what: str) -> Path | None:
    """A path, if there is one."""
    return None if value is None else path(value, what)


def items(values: Iterable[Any], what: str) -> list[Any]:
    """The values of any list; InputError names `what` if it is not one, such as a text."""
    if isinstance(values, str | bytes | os.PathLike) or not isinstance(values, Iterable):
        raise InputError(f"{what}: expected a list, not {told_kind(values)}")
    return list(values)


def part(part: Any) -> Any:
    """The name `module:Class` of a user's class; anything else unchanged."""
    return name_of(part) if inspect.isclass(part) else part


def planner(planner: str | type | None) -> str | None:
    """The name of a planner, given by it or as a class."""
    return None if planner is None else text(part(planner), "planner", "a name or a class")


def settings(settings: Mapping[str, Any] | None, **more: Any) -> list[str]:
    """`{"loops.match": "open3d"}` as `loops.match=open3d`, which --set takes; classes by their names. `more`
    are settings with arguments of their own; None does not change them."""
    if not isinstance(settings, Mapping | None):
        raise InputError(
            f'settings: expected a mapping such as {{"loops.match": "open3d"}}, not {told_kind(settings)}'
        )
    chosen = {key: value for key, value in more.items() if value is not None}
    return [f"{key}={_value_text(value, key)}" for key, value in {**(settings or {}), **chosen}.items()]


def _value_text(value: Any, key: str) -> str:
    value = part(value)
    if isinstance(value, str) and value and parsed(value, where=key) == value:
        return value
    try:
        return json.dumps(value, default=lambda one: one.tolist())
    except (TypeError, AttributeError):
        raise InputError(
            f"settings {key}: expected a number, text, list or class, not {in_a_line(value)}"
        ) from None


def seed(seed: int) -> int:
    """A seed; InputError if it is not one."""
    if isinstance(seed, bool) or not isinstance(seed, int | np.integer) or seed < 0:
        raise InputError(f"seed: expected a whole number, 0 or more, not {in_a_line(seed)}")
    return int(seed)


def require_kind(value: object, kind: type, what: str) -> None:
    """InputError unless it is of this kind."""
    if not isinstance(value, kind):
        raise InputError(f"{what}: expected {one(kind.__name__)}, not {told_kind(value)}")


def scan(scan: Scan, last: Scan | None) -> Scan:
    """A scan that meets the requirements: increasing integer stamp [ns], (n_beams,) float32, always the same
    lidar. Ranges may be inf or NaN (REP-117)."""
    require_kind(scan, Scan, "scan")
    require_kind(scan.lidar, LidarSpec, "scan.lidar")
    stamp = _stamp(scan.stamp_ns, "scan.stamp_ns")
    try:
        ranges = np.asarray(scan.ranges, dtype=np.float32)
    except (TypeError, ValueError, OverflowError):
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


def odometry(
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
        found = pose(odometry, "odometry")
    if not first and _kind(found) != _kind(last):
        raise InputError(f"odometry: was {_kind(last)} for earlier scans, is {_kind(found)} now")
    return found  # type: ignore[return-value]


def imu(imu: Iterable[Imu]) -> list[Imu]:
    """Samples with finite (3,) arrays and increasing stamps."""
    last, samples = -LATEST_NS, items(imu, "imu")
    for sample in samples:
        require_kind(sample, Imu, "imu")
        stamp = _stamp(sample.stamp_ns, "imu.stamp_ns")
        if stamp <= last:
            raise InputError(f"imu.stamp_ns: {stamp} is not after the sample before")
        last = stamp
        for name in ("angular_velocity", "linear_acceleration"):
            values = getattr(sample, name)
            if _three(values) is None:
                raise InputError(f"imu.{name}: expected three finite numbers, not {in_a_line(values)}")
    return samples


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
