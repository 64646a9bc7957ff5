"""Trajectories in space as other systems write them: TUM, KITTI and EuRoC files."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from turtlebag.datasets.errors import InputError
from turtlebag.datasets.se2 import Array
from turtlebag.datasets.se3 import lifted, planar, rotations
from turtlebag.datasets.trajectories import stamp_from_text
from turtlebag.datasets.types import Stamps, Trajectory

FORMATS = "a trajectory has 8 numbers a line (TUM), 12 (KITTI), or commas between them (EuRoC csv)"
FARTHEST_M = 1e8
Lines = list[tuple[int, list[str]]]


@dataclass(frozen=True, eq=False)
class Trajectory3D:
    """Stamped poses in space, `T` (n, 4, 4), in the order of their source."""

    stamps_ns: Stamps
    T: Array

    @staticmethod
    def of(trajectory: Trajectory) -> Trajectory3D:
        """A planar trajectory in space."""
        return Trajectory3D(trajectory.stamps_ns, lifted(trajectory.poses))

    def planar(self) -> Trajectory:
        """x, y and yaw."""
        return Trajectory(self.stamps_ns, planar(self.T))

    def __len__(self) -> int:
        return len(self.stamps_ns)

    def __getitem__(self, chosen: Any) -> Trajectory3D:
        """The poses that an index array, a mask or a slice picks."""
        return Trajectory3D(self.stamps_ns[chosen], self.T[chosen])

    def in_time(self) -> Trajectory3D:
        """Sorted by stamp; of several poses with one stamp the first."""
        stamps, first = np.unique(self.stamps_ns, return_index=True)
        return Trajectory3D(stamps, self.T[first])


def read_trajectory_3d(path: Path, times: Path | None, scans_ns: Stamps) -> Trajectory3D:
    """Read a TUM, KITTI or EuRoC file; which one, its first line tells. InputError for anything else.

    KITTI has no stamps: they are in `times` (seconds, one a line), or there is one pose for each of the
    recording's scans, `scans_ns`.
    """
    lines, csv = _lines(path)
    first = lines[0][1]
    if len(first) == 12 and not csv:
        stamps = _kitti_stamps(path, len(lines), times, scans_ns)
        return Trajectory3D(stamps, _kitti(path, lines))
    if times is not None:
        raise InputError(f"{path}: has its own stamps; leave out --rival-times")
    if csv:
        rows = _rows(path, lines, 8, "'t [ns], x, y, z, qw, qx, qy, qz, ...'", at_least=True)
        stamps = np.array([_nanoseconds(path, number, words[0]) for number, words in lines], dtype=np.int64)
        return Trajectory3D(stamps, _poses(path, lines, rows[:, 1:4], rows[:, [5, 6, 7, 4]]))
    if len(first) != 8:
        raise InputError(f"{path}, line {lines[0][0]}: {len(first)} words; {FORMATS}")
    rows = _rows(path, lines, 8, "'t x y z qx qy qz qw'")
    stamps = np.array([_seconds(path, number, words[0]) for number, words in lines], dtype=np.int64)
    return Trajectory3D(stamps, _poses(path, lines, rows[:, 1:4], rows[:, 4:8]))


def _lines(path: Path) -> tuple[Lines, bool]:
    """(number, words) of every line that is no comment and not blank, and whether commas part the words."""
    if not path.is_file():
        raise InputError(f"{path}: no such trajectory file")
    try:
        text = path.read_text(encoding="utf-8-sig")
    except UnicodeDecodeError:
        raise InputError(f"{path}: not a text file; {FORMATS}") from None
    told = [
        (number, line)
        for number, line in enumerate(text.splitlines(), start=1)
        if line.strip() and not line.lstrip().startswith("#")
    ]
    if not told:
        raise InputError(f"{path}: no poses")
    csv = "," in told[0][1]
    return [(number, line.replace(",", " ").split() if csv else line.split()) for number, line in told], csv


def _rows(path: Path, lines: Lines, count: int, expected: str, *, at_least: bool = False) -> Array:
    rows = []
    for number, words in lines:
        try:
            row = [float(word) for word in (words[:count] if at_least else words)]
        except ValueError:
            raise InputError(f"{path}, line {number}: not numbers; expected {expected}") from None
        if len(row) != count or not all(abs(value) < 1e100 for value in row):
            raise InputError(f"{path}, line {number}: expected {expected}, all finite")
        rows.append(row)
    return np.array(rows)


def _check_places(path: Path, lines: Lines, xyz: Array) -> None:
    """Beyond these, squares of distances are no numbers any more."""
    far = np.flatnonzero(np.abs(xyz).max(axis=1) > FARTHEST_M)
    if len(far):
        raise InputError(
            f"{path}, line {lines[int(far[0])][0]}: its position is farther than any place on Earth"
        )


def _poses(path: Path, lines: Lines, xyz: Array, q: Array) -> Array:
    _check_places(path, lines, xyz)
    norm = np.linalg.norm(q, axis=1)
    bad = np.flatnonzero(np.abs(norm - 1.0) > 0.1)
    if len(bad):
        raise InputError(
            f"{path}, line {lines[int(bad[0])][0]}: its quaternion has length {norm[bad[0]]:.3g}, not 1"
        )
    T = np.zeros((len(xyz), 4, 4))
    T[:, :3, :3] = rotations(q / norm[:, None])
    T[:, :3, 3] = xyz
    T[:, 3, 3] = 1.0
    return T


def _kitti(path: Path, lines: Lines) -> Array:
    rows = _rows(path, lines, 12, "the 12 numbers of a 3 x 4 pose")
    T = np.zeros((len(rows), 4, 4))
    T[:, :3] = rows.reshape(-1, 3, 4)
    T[:, 3, 3] = 1.0
    _check_places(path, lines, T[:, :3, 3])
    R = T[:, :3, :3]
    off = np.abs(R @ np.swapaxes(R, 1, 2) - np.eye(3)).max(axis=(1, 2))
    bad = np.flatnonzero((off > 0.05) | (np.linalg.det(R) < 0.0))
    if len(bad):
        raise InputError(f"{path}, line {lines[int(bad[0])][0]}: not a pose, its 3 x 3 part is no rotation")
    return T


def _kitti_stamps(path: Path, count: int, times: Path | None, scans_ns: Stamps) -> Stamps:
    if times is None:
        if count == len(scans_ns):
            return scans_ns
        raise InputError(
            f"{path}: KITTI poses have no times, and {count} poses cannot be those of {len(scans_ns)} scans; "
            "give their times (seconds, one a line) by --rival-times"
        )
    lines, _ = _lines(times)
    if len(lines) != count:
        raise InputError(f"{times}: {len(lines)} times for the {count} poses of {path}")
    stamps = [_seconds(times, number, _only(times, number, words)) for number, words in lines]
    return np.array(stamps, dtype=np.int64)


def _only(path: Path, number: int, words: Sequence[str]) -> str:
    if len(words) != 1:
        raise InputError(f"{path}, line {number}: expected one time in seconds, got {len(words)} words")
    return words[0]


def _seconds(path: Path, number: int, word: str) -> int:
    try:
        return stamp_from_text(word)
    except (ValueError, OverflowError):
        raise InputError(f"{path}, line {number}: {word} is no time in seconds") from None


def _nanoseconds(path: Path, number: int, word: str) -> int:
    try:
        stamp = int(word) if word.lstrip("+-").isdigit() else float(word)
    except ValueError:
        stamp = math.nan
    if stamp != stamp or stamp != int(stamp) or abs(stamp) >= 2**62:
        raise InputError(
            f"{path}, line {number}: {word} is no whole number of nanoseconds, which a EuRoC csv begins with"
        )
    return int(stamp)
