"""TUM trajectory files: `t x y z qx qy qz qw`, one pose a line."""

from __future__ import annotations

import math
from dataclasses import dataclass
from pathlib import Path
from typing import TextIO

import numpy as np

from turtlebag.datasets.errors import InputError
from turtlebag.datasets.number_text import decimal, decimals, whole
from turtlebag.datasets.se2 import SE2, Array, wrap
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
    seconds = decimal(text)
    if "e" in text.lower():
        stamp = round(seconds * 1e9) if abs(seconds) < 1e10 else _END_OF_TIME_NS
    else:
        sign = -1 if text.startswith("-") else 1
        before, _, after = text.lstrip("+-").partition(".")
        stamp = sign * (whole(before or "0") * 10**9 + whole(after[:9].ljust(9, "0")))
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


COVARIANCES = "poses_with_covariance.csv"
"""Name of the file that lies beside a trajectory.tum."""


def save_covariances(trajectory: Trajectory, covariance: Array, folder: Path) -> None:
    """Write COVARIANCES: each pose with its covariance (n, 3, 3) in the frame that it is given in."""
    lines = ["stamp,x,y,yaw,xx,xy,xyaw,yy,yyaw,yawyaw"]
    upper = covariance[:, *np.triu_indices(3)].tolist()
    for stamp, pose, moments in zip(
        trajectory.stamps_ns.tolist(), trajectory.poses.xyt.tolist(), upper, strict=True
    ):
        numbers = ",".join([*(f"{value:.9f}" for value in pose), *(f"{value:.9e}" for value in moments)])
        lines.append(f"{stamp_text(stamp)},{numbers}")
    (folder / COVARIANCES).write_text("\n".join(lines) + "\n")


def save_tum_3d(stamps_ns: Stamps, T: Array, path: Path) -> None:
    """Write one line per pose in space, (n, 4, 4), in order."""
    with path.open("w") as file:
        for stamp, xyz, q in zip(
            stamps_ns.tolist(), T[:, :3, 3].tolist(), quaternions(T).tolist(), strict=True
        ):
            place = " ".join(f"{value:.9f}" for value in xyz)
            turn = " ".join(f"{value:.12f}" for value in q)
            file.write(f"{stamp_text(stamp)} {place} {turn}\n")


LARGEST = 100_000_000
"""Bytes of a trajectory file that are read at most: a million poses."""


@dataclass(frozen=True)
class NumberLines:
    """The lines of a text file that are no comment and not blank, by their numbers, as words.

    What is asked of them and is not there is an InputError that names the file and the line.
    """

    path: Path
    lines: list[tuple[int, list[str]]]

    @staticmethod
    def of(path: Path, text: str) -> NumberLines:
        """The words of a text, parted by white space."""
        lines = [(number, line.split()) for number, line in enumerate(text.splitlines(), start=1)]
        return NumberLines(path, [(number, words) for number, words in lines if words and words[0][0] != "#"])

    @staticmethod
    def read(path: Path) -> NumberLines:
        """Those of a trajectory file; InputError when it has none."""
        if not path.is_file():
            raise InputError(f"{path}: no such trajectory file")
        if (size := path.stat().st_size) > LARGEST:
            raise InputError(f"{path}: {size / 1e6:.0f} MB; a trajectory has at most {LARGEST / 1e6:.0f} MB")
        try:
            found = NumberLines.of(path, path.read_text(encoding="utf-8-sig"))
        except UnicodeDecodeError:
            raise InputError(f"{path}: not a text file") from None
        if not found.lines:
            raise InputError(f"{path}: no poses")
        return found

    def wrong(self, index: int, what: str) -> InputError:
        """The error for an invalid line."""
        return InputError(f"{self.path}, line {self.lines[index][0]}: {what}")

    def numbers(self, count: int, expected: str, *, at_least: bool = False) -> Array:
        """Its words as finite numbers, (n, count); with `at_least` more words may follow."""
        rows = []
        for index, (_, words) in enumerate(self.lines):
            try:
                row = decimals(words[:count] if at_least else words)
            except ValueError:
                raise self.wrong(index, f"not numbers; expected {expected}") from None
            if len(row) != count or not all(abs(value) < 1e100 for value in row):
                raise self.wrong(index, f"expected {expected}, all finite")
            rows.append(row)
        return np.array(rows).reshape(-1, count)

    def stamps(self, column: int = 0) -> Stamps:
        """A column of seconds, (n,) [ns]."""
        stamps = []
        for index, (_, words) in enumerate(self.lines):
            try:
                stamps.append(stamp_from_text(words[column]))
            except (ValueError, OverflowError):
                raise self.wrong(index, f"{words[column]} is not a time in seconds") from None
        return np.array(stamps, dtype=np.int64)


TUM_LINE = "'t x y z qx qy qz qw'"
W_FIRST = f"its quaternions have w first, as it seems (they roll and never turn); expected {TUM_LINE}"
LEVEL = 0.02
"""Sine of half the angle by which a body may pitch and yaw, and still only rolls: 2.3 degrees."""
ROLL_RAD = 1.0
"""No robot on the ground rolls that far."""


def only_rolls(q: Array) -> bool:
    """Whether poses with quaternions x, y, z, w (n, 4) only roll, and do it by far.

    So look the poses of a robot on the ground whose w stands first: its turns about z are read as turns
    about x. One that turned by less than `ROLL_RAD` is not noticed.
    """
    q = q / np.maximum(np.linalg.norm(q, axis=1, keepdims=True), 1e-9)
    roll = 2.0 * np.arctan2(q[:, 0], q[:, 3])
    across = np.hypot(q[:, 1], q[:, 2]).max()
    return bool(across < LEVEL and np.abs(wrap(roll - roll[0])).max() > ROLL_RAD)


def load_tum(path: Path) -> Trajectory:
    """Read a TUM file (comments and blank lines allowed); only the planar part is kept."""
    lines = NumberLines.read(path)
    rows = lines.numbers(8, TUM_LINE)
    if len(none := np.flatnonzero(~rows[:, 4:8].any(axis=1))):
        raise lines.wrong(int(none[0]), "its quaternion is zero")
    if only_rolls(rows[:, 4:8]):
        raise InputError(f"{path}: {W_FIRST}")
    _, x, y, _, qx, qy, qz, qw = rows.T
    yaw = np.arctan2(2.0 * (qw * qz + qx * qy), 1.0 - 2.0 * (qy**2 + qz**2))
    return Trajectory(lines.stamps(), SE2.from_xyt(x, y, yaw))
