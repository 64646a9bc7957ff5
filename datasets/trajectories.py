"""TUM trajectory files: `t x y z qx qy qz qw`, one pose a line."""

from __future__ import annotations

import math
from pathlib import Path
from typing import TextIO

import numpy as np

from turtlebag.datasets.errors import InputError
from turtlebag.datasets.se2 import SE2, Array
from turtlebag.datasets.se3 import quaternions
from turtlebag.datasets.types import Stamps, Trajectory


def stamp_text(stamp_ns: int) -> str:
    """Exact decimal seconds: 6 decimals, 9 where the stamp has them."""
    whole, fraction = divmod(abs(stamp_ns), 10**9)
    digits = f"{fraction:09d}"
    return f"{'-' if stamp_ns < 0 else ''}{whole}.{digits[:6] if digits.endswith('000') else digits}"


_END_OF_TIME_NS = 2**62
"""The difference of any two stamps before it fits 64 bits."""


def stamp_from_text(text: str) -> int:
    """Exact integer nanoseconds from decimal seconds (digits past the ninth are cut).

    ValueError when it is no number or more than 146 years from 0.
    """
    if "e" in text.lower():
        seconds = float(text)
        stamp = round(seconds * 1e9) if abs(seconds) < 1e10 else _END_OF_TIME_NS
    else:
        sign = -1 if text.startswith("-") else 1
        whole, _, fraction = text.lstrip("+-").partition(".")
        stamp = sign * (int(whole or "0") * 10**9 + int(fraction[:9].ljust(9, "0")))
    if abs(stamp) >= _END_OF_TIME_NS:
        raise ValueError(f"{text} s is not a plausible time")
    return stamp


def save_tum(trajectory: Trajectory, path: Path) -> None:
    """Write one line per pose, in order."""
    with path.open("w") as file:
        write_tum(trajectory, file)


def write_tum(trajectory: Trajectory, file: TextIO) -> None:
    """Append one line per pose, in order."""
    for stamp, (x, y, yaw) in zip(trajectory.stamps_ns.tolist(), trajectory.poses.xyt.tolist(), strict=True):
        qz, qw = math.sin(yaw / 2.0), math.cos(yaw / 2.0)
        file.write(f"{stamp_text(stamp)} {x:.9f} {y:.9f} 0 0 0 {qz:.12f} {qw:.12f}\n")


def save_tum_3d(stamps_ns: Stamps, T: Array, path: Path) -> None:
    """Write one line per pose in space, (n, 4, 4), in order."""
    with path.open("w") as file:
        for stamp, xyz, q in zip(
            stamps_ns.tolist(), T[:, :3, 3].tolist(), quaternions(T).tolist(), strict=True
        ):
            place = " ".join(f"{value:.9f}" for value in xyz)
            turn = " ".join(f"{value:.12f}" for value in q)
            file.write(f"{stamp_text(stamp)} {place} {turn}\n")


def load_tum(path: Path) -> Trajectory:
    """Read a TUM file (comments and blank lines allowed); only the planar part is kept."""
    if not path.is_file():
        raise InputError(f"{path}: no such trajectory file")
    stamps: list[int] = []
    rows: list[list[float]] = []
    try:
        lines = path.read_text().splitlines()
    except UnicodeDecodeError:
        raise InputError(f"{path}: not a text file") from None
    for number, line in enumerate(lines, start=1):
        parts = line.split()
        if not parts or parts[0].startswith("#"):
            continue
        try:
            stamp, row = stamp_from_text(parts[0]), [float(value) for value in parts[1:]]
        except ValueError:
            raise InputError(f"{path}, line {number}: not numbers") from None
        if len(row) != 7 or not all(abs(value) < 1e100 for value in row):
            raise InputError(f"{path}, line {number}: expected 't x y z qx qy qz qw', all finite")
        stamps.append(stamp)
        rows.append(row)
    if not rows:
        raise InputError(f"{path}: no poses")
    x, y, _, qx, qy, qz, qw = np.array(rows).T
    yaw = np.arctan2(2.0 * (qw * qz + qx * qy), 1.0 - 2.0 * (qy**2 + qz**2))
    return Trajectory(np.array(stamps, dtype=np.int64), SE2.from_xyt(x, y, yaw))
