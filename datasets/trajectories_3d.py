"""Trajectories in space as other systems write them: TUM, KITTI and EuRoC files."""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np

from turtlebag.datasets.bags.plausibility import FAR_M
from turtlebag.datasets.errors import InputError
from turtlebag.datasets.number_text import decimal, whole
from turtlebag.datasets.se2 import Array
from turtlebag.datasets.se3 import lifted, planar, rotations
from turtlebag.datasets.trajectories import TUM_LINE, W_FIRST, NumberLines, only_rolls
from turtlebag.datasets.types import Stamps, Trajectory

SIDEWAYS = 0.1
"""A path that is broader than this share of its length leads not only ahead."""
FORMATS = "a trajectory has 8 numbers a line (TUM), 12 (KITTI), or commas between them (EuRoC csv)"


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
    """Read a TUM, KITTI or EuRoC file, detected by its first line. InputError for anything else.

    KITTI has no stamps: they are in `times` (seconds, one a line), or there is one pose for each of the
    recording's scans, `scans_ns`.
    """
    lines = NumberLines.read(path)
    if csv := any("," in word for word in lines.lines[0][1]):
        parted = [(number, " ".join(words).replace(",", " ").split()) for number, words in lines.lines]
        lines = replace(lines, lines=[(number, words) for number, words in parted if words])
    first = lines.lines[0][1] if lines.lines else []
    if len(first) == 12 and not csv:
        return Trajectory3D(_kitti_stamps(lines, times, scans_ns), _kitti(lines))
    if times is not None:
        raise InputError(f"{path}: has its own stamps; leave out --system-times")
    if csv:
        rows = lines.numbers(8, "'t [ns], x, y, z, qw, qx, qy, qz, ...'", at_least=True)
        return Trajectory3D(_nanoseconds(lines), _poses(lines, rows[:, 1:4], rows[:, [5, 6, 7, 4]]))
    if len(first) != 8:
        raise lines.wrong(0, f"{len(first)} words; {FORMATS}")
    rows = lines.numbers(8, TUM_LINE)
    # A body that rolls in space is possible, in a pipe, say; but it moves where it looks.
    if only_rolls(rows[:, 4:8]) and np.ptp(rows[:, 2]) > SIDEWAYS * np.ptp(rows[:, 1]):
        raise InputError(f"{path}: {W_FIRST}")
    return Trajectory3D(lines.stamps(), _poses(lines, rows[:, 1:4], rows[:, 4:8]))


def _check_places(lines: NumberLines, xyz: Array) -> None:
    """Beyond these, squares of distances are no numbers any more."""
    far = np.flatnonzero(np.abs(xyz).max(axis=1) > FAR_M)
    if len(far):
        raise lines.wrong(int(far[0]), "its position is implausibly far away")


def _poses(lines: NumberLines, xyz: Array, q: Array) -> Array:
    _check_places(lines, xyz)
    norm = np.linalg.norm(q, axis=1)
    bad = np.flatnonzero(np.abs(norm - 1.0) > 0.1)
    if len(bad):
        raise lines.wrong(int(bad[0]), f"its quaternion has length {norm[bad[0]]:.3g}, not 1")
    T = np.zeros((len(xyz), 4, 4))
    T[:, :3, :3] = rotations(q / norm[:, None])
    T[:, :3, 3] = xyz
    T[:, 3, 3] = 1.0
    return T


def _kitti(lines: NumberLines) -> Array:
    rows = lines.numbers(12, "the 12 numbers of a 3 x 4 pose")
    T = np.zeros((len(rows), 4, 4))
    T[:, :3] = rows.reshape(-1, 3, 4)
    T[:, 3, 3] = 1.0
    _check_places(lines, T[:, :3, 3])
    R = T[:, :3, :3]
    off = np.abs(R @ np.swapaxes(R, 1, 2) - np.eye(3)).max(axis=(1, 2))
    bad = np.flatnonzero((off > 0.05) | (np.linalg.det(R) < 0.0))
    if len(bad):
        raise lines.wrong(int(bad[0]), "not a pose, its 3 x 3 part is not a rotation")
    return T


def _kitti_stamps(poses: NumberLines, times: Path | None, scans_ns: Stamps) -> Stamps:
    path, count = poses.path, len(poses.lines)
    if times is None:
        if count == len(scans_ns):
            return scans_ns
        raise InputError(
            f"{path}: KITTI poses have no times, and {count} poses do not match {len(scans_ns)} scans; "
            "give their times (seconds, one per line) with --system-times"
        )
    lines = NumberLines.read(times)
    if len(lines.lines) != count:
        raise InputError(f"{times}: {len(lines.lines)} times for the {count} poses of {path}")
    for index, (_, words) in enumerate(lines.lines):
        if len(words) != 1:
            raise lines.wrong(index, f"expected one time in seconds, got {len(words)} words")
    return lines.stamps()


def _nanoseconds(lines: NumberLines) -> Stamps:
    stamps = []
    for index, (_, (word, *_)) in enumerate(lines.lines):
        try:
            stamp = whole(word) if word.lstrip("+-").isdigit() else decimal(word)
        except ValueError:
            stamp = math.nan
        if stamp != stamp or stamp != int(stamp) or abs(stamp) >= 2**62:
            raise lines.wrong(index, f"expected a whole number of nanoseconds (EuRoC csv), not {word}")
        stamps.append(int(stamp))
    return np.array(stamps, dtype=np.int64)
