"""CARMEN logs (.clf, .log), the format of the public SLAM logs: planar scans with odometry poses.

One message a line: `FLASER n r_1..r_n x y theta odom_x odom_y odom_theta ipc_stamp host logger_stamp`.
The first pose is the laser's, the second the robot's. FLASER lines do not state the field of
view: it is half a circle, -90 degrees first. `ROBOTLASER1` lines state theirs.
"""

from __future__ import annotations

import math
from collections import Counter
from dataclasses import replace
from pathlib import Path
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from turtlebag.datasets.bags.plausibility import (
    FAR_M,
    driven_in_millimetres,
    ranges_in_millimetres,
    stands_still,
)
from turtlebag.datasets.bags.scans import Geometry, on_one_grid
from turtlebag.datasets.errors import InputError
from turtlebag.datasets.findings import Finding, lines_of
from turtlebag.datasets.no_return_range import no_return_value
from turtlebag.datasets.number_text import decimal, decimals, whole
from turtlebag.datasets.plurals import counted
from turtlebag.datasets.se2 import SE2, Array
from turtlebag.datasets.trajectories import stamp_from_text
from turtlebag.datasets.types import NOTHING_M, LidarSpec, Recording, Stamps

FAR = 81.83
"""A SICK's readings from here on are codes for "no return", and no planar lidar of these logs sees farther
[m]."""

_HALF_CIRCLES = (180, 181, 360, 361)
"""Numbers of beams of a SICK that sees half a circle."""

_END_OF_TIME_S = 2.0**31
"""ROS's seconds are 32 bits wide; a larger stamp is damage, and so is one before 1970."""


class _Line(NamedTuple):
    """A scan line: its readings, then the laser's and the robot's pose, (beams + 6,), and its line number."""

    values: Array
    stamp_ns: int
    number: int
    view: tuple[float, float] | None
    """First angle and increment, where the line states them."""
    range_max: float
    """The largest range that it states, else FAR [m]."""

    @property
    def beams(self) -> int:
        """Number of its readings."""
        return len(self.values) - 6


def is_carmen(content: bytes) -> bool:
    """Whether the beginning of a file looks like a CARMEN log."""
    head = content[:65536]
    known = (b"FLASER", b"ROBOTLASER1", b"RLASER", b"ODOM", b"PARAM", b"SYNC")
    lines = filter(None, (line.split(None, 1) for line in head.split(b"\n")))
    return head.startswith(b"# CARMEN") or any(
        (len(words) == 2 and words[0] in known) or words[0].startswith(b"RAWLASER") for words in lines
    )


def parse_carmen(content: bytes, path: Path, *, T_base_lidar: SE2 | None, notes: list[str]) -> Recording:
    """Recording from the unpacked content of a log; `path` names it in messages."""
    found, params, broken, rear = _collect(content)
    lines = found[b"FLASER"] or found[b"ROBOTLASER1"]
    keys = _geometries(lines, notes)
    stamps, values, lidar = _on_one_grid(lines, keys, broken, notes)
    if not len(stamps):
        what = "only damaged scan lines" if broken else "no FLASER or ROBOTLASER1 line"
        raise InputError(f"{path}: {what} in the log; is it a CARMEN log with laser data?")
    if broken:
        notes.append(f"{counted(len(broken), 'damaged line')} skipped, the first is line {min(broken)}")
    if rear:
        notes.append(f"{rear} rear laser scans (RLASER) not used")
    n = lidar.n_beams
    if stands_still(stamps):
        notes.append(f"every stamp is {stamps[0] * 1e-9:.6f}; only the order of the file is known")
    values = _in_metres(values, stamps, notes)
    backwards = int(np.count_nonzero(np.diff(stamps) < 0))
    if backwards:
        notes.append(f"stamps go back {counted(backwards, 'time')}; file order kept")
    poses_lidar, poses_base = SE2.from_array(values[:, n : n + 3]), SE2.from_array(values[:, n + 3 :])
    if T_base_lidar is None:
        T_base_lidar = _laser_pose(poses_base, poses_lidar, params, notes)
    ranges, range_max = _normalised(values[:, :n], lidar.range_max, notes)
    return Recording(
        source=str(path),
        stamps_ns=stamps,
        ranges=ranges,
        lidar=replace(lidar, range_max=range_max, scan_time=_period(stamps)),
        T_base_lidar=T_base_lidar,
        T_odom_base=poses_base,
        notes=tuple(notes),
    )


def _collect(content: bytes) -> tuple[dict[bytes, list[_Line]], dict[bytes, bytes], list[int], int]:
    """Scan lines by kind, parameters, numbers of the damaged lines and the count of rear scans."""
    found: dict[bytes, list[_Line]] = {b"FLASER": [], b"ROBOTLASER1": []}
    params: dict[bytes, bytes] = {}
    broken: list[int] = []
    rear = 0
    for number, line in enumerate(content.split(b"\n"), start=1):
        kind = next(iter(line.split(None, 1)), b"")
        if kind in found:
            try:
                found[kind].append(_parsed(kind, line.decode("latin-1").split(), number))
            except (ValueError, IndexError, OverflowError):
                broken.append(number)
        elif kind == b"PARAM":
            words = line.split()
            if len(words) > 2:
                params[words[1]] = words[2]
        elif kind == b"RLASER":
            rear += 1
    return found, params, broken, rear


def _parsed(kind: bytes, words: list[str], number: int) -> _Line:
    """One scan line; ValueError or IndexError when its fields do not add up."""
    if kind == b"FLASER":
        n, first = whole(words[1]), 2
        poses = first + n
        if len(words) != poses + 9:
            raise ValueError("wrong number of fields")
        view, range_max = None, FAR
    else:
        n, first = whole(words[8]), 9
        poses = first + n + 1 + whole(words[first + n])
        if len(words) != poses + 14:
            raise ValueError("wrong number of fields")
        view, range_max = (decimal(words[2]), decimal(words[4])), decimal(words[5])
    if n < 1:
        raise ValueError("no beams")
    if not 0.0 <= decimal(words[-3]) < _END_OF_TIME_S:
        raise ValueError("an impossible stamp")
    stamp = stamp_from_text(words[-3])
    values = np.array(decimals(words[first : first + n] + words[poses : poses + 6]))
    if not (np.abs(values[-6:]) < FAR_M).all():
        raise ValueError("an impossible pose")
    return _Line(values, stamp, number, view, range_max)


def _geometries(lines: list[_Line], notes: list[str]) -> list[Geometry | None]:
    """The beams of each scan; None if the field of view is unknown. FLASER lines do not give it: the half
    circle is that of the SICK's numbers of beams, and of the most frequent number."""
    sizes = Counter(line.beams for line in lines)
    usual = sizes.most_common(1)[0][0] if sizes else 0
    known = set(sizes)
    if lines and lines[0].view is None:
        known = {*_HALF_CIRCLES, usual}
        if usual and usual not in _HALF_CIRCLES:
            notes.append(f"{usual} beams: a field of view of 180 degrees is assumed")
        if sizes.keys() - known:
            unknown = sum(count for n, count in sizes.items() if n not in known)
            notes.append(f"{counted(unknown, 'scan')} with other than {usual} beams skipped")
    return [_geometry(line) if line.beams in known else None for line in lines]


def _geometry(line: _Line) -> Geometry:
    n = line.beams
    first, step = line.view or (-math.pi / 2.0, math.pi / max(n - n % 2, 1))
    return Geometry(first, first + (n - 1) * step, step, 0.0, line.range_max, n)


def _on_one_grid(
    lines: list[_Line], keys: list[Geometry | None], broken: list[int], notes: list[str]
) -> tuple[Stamps, Array, LidarSpec]:
    """Stamps (n,), readings and the two poses (n, n_beams + 6) in the file's order, and the beams.

    Rows whose beams have no directions are left out and counted in `broken`.
    """
    known = [(line, key) for line, key in zip(lines, keys, strict=True) if key is not None]
    broken.extend(line.number for line, key in known if not key.usable())
    good = [(line, key) for line, key in known if key.usable()]
    if not good:
        return np.empty(0, dtype=np.int64), np.empty((0, 6)), LidarSpec(1, 0.0, 0.0, 0.0, FAR)
    stamps = np.array([line.stamp_ns for line, _ in good], dtype=np.int64)
    rows, found = [line.values for line, _ in good], [key for _, key in good]
    main = Counter(found).most_common(1)[0][0]
    lidar = LidarSpec(main.n, main.angle_min, main.increment, 0.0, max(main.range_max, NOTHING_M))
    if len(set(found)) == 1:
        return stamps, np.array(rows), lidar
    findings: list[Finding] = []
    readings, lidar = on_one_grid("", [row[:-6] for row in rows], found, lidar, findings)
    notes += lines_of(findings)
    return stamps, np.hstack([readings, [row[-6:] for row in rows]]), lidar


def _in_metres(values: Array, stamps: Stamps, notes: list[str]) -> Array:
    """The readings and poses of `_on_one_grid` in metres, where a program wrote millimetres."""
    scale = np.ones(values.shape[1])
    if ranges_in_millimetres(values[:: 1 + len(values) // 200, :-6], FAR):
        notes.append("the readings exceed any lidar's range; read as millimetres")
        scale[:-6] = 1e-3
    if driven_in_millimetres(stamps, values[:, -3:-1]):
        notes.append("the robot would be implausibly fast; its poses read as millimetres")
        scale[[-6, -5, -3, -2]] = 1e-3
    return values if (scale == 1.0).all() else values * scale


def _normalised(readings: Array, stated: float, notes: list[str]) -> tuple[NDArray[np.float32], float]:
    """REP-117 ranges and the largest range: codes for "no return" become +inf, readings <= 0 NaN. `stated` is
    the largest range by the log, which is wrong if most readings are longer."""
    readings = np.where(readings > 0.0, readings, np.nan)
    believed = np.count_nonzero(readings < stated) > np.count_nonzero(readings >= stated)
    end = min(stated, FAR) if believed else FAR
    # a long code does not hide a short one
    limit = min(no_return_value(np.where(readings < end, readings, np.nan)), end)
    far = readings >= limit
    near = readings[~far & np.isfinite(readings)]
    if not near.size:
        notes.append("no beam of the whole log measured anything")
    elif far.any():
        least, measured = readings[far].min(), np.count_nonzero(np.isfinite(readings))
        notes.append(
            f"readings of {least:g} m and more are 'no return' ({100.0 * far.sum() / measured:.1f} %)"
        )
    range_max = float(math.floor(near.max()) + 1) if near.size else FAR
    ranges = np.where(far, np.inf, readings).astype(np.float32)
    return ranges, range_max


def _laser_pose(T_odom_base: SE2, T_odom_lidar: SE2, params: dict[bytes, bytes], notes: list[str]) -> SE2:
    """Where the laser sits on the robot: from the two poses of each line, else from the parameters."""
    relative = (T_odom_base.inverse() @ T_odom_lidar).xyt
    median = np.median(relative, axis=0)
    deviation = np.median(np.abs(relative - median), axis=0)
    if deviation.max() < 2e-3 and np.abs(median).max() > 1e-4:
        return SE2.from_array(np.round(median, 4))
    try:
        offset = decimal(params.get(b"robot_frontlaser_offset", b"0").decode("latin-1"))
    except ValueError:
        offset = 0.0
    if deviation.max() >= 2e-3:
        notes.append(
            f"laser and robot poses are not rigidly linked; laser taken {offset:g} m ahead of the robot"
        )
    return SE2.from_xyt(offset, 0.0, 0.0)


def _period(stamps: Stamps) -> float:
    """Usual time between scans [s]."""
    steps = np.diff(stamps)
    steps = steps[steps > 0]
    return float(np.median(steps)) * 1e-9 if steps.size else 0.0
