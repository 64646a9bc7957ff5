"""Relations of the SLAM benchmark (Kuemmerle et al. 2009): true relative poses between two stamps."""

from __future__ import annotations

import math
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from turtlebag.datasets.errors import InputError
from turtlebag.datasets.files import read_unpacked
from turtlebag.datasets.se2 import SE2
from turtlebag.datasets.trajectories import stamp_from_text
from turtlebag.datasets.types import Stamps


@dataclass(frozen=True, eq=False)
class Relations:
    """True poses `T_a_b` (n,) of the robot at stamp b as seen from the robot at stamp a."""

    stamps_a_ns: Stamps
    stamps_b_ns: Stamps
    T_a_b: SE2

    def __len__(self) -> int:
        return len(self.stamps_a_ns)


def load_relations(path: Path) -> Relations:
    """Read `t1 t2 x y z roll pitch yaw` lines; the planar part is kept."""
    if not path.is_file():
        raise InputError(f"{path}: no such relations file")
    content, problem = read_unpacked(path)
    if problem:
        raise InputError(f"{path}: {problem.split(': ', 1)[1]}; fetch it again")
    stamps: list[tuple[int, int]] = []
    poses: list[tuple[float, float, float]] = []
    for number, line in enumerate(content.decode("ascii", "replace").splitlines(), start=1):
        parts = line.split()
        if not parts or parts[0].startswith("#"):
            continue
        try:
            pair = stamp_from_text(parts[0]), stamp_from_text(parts[1])
            x, y, _, _, _, yaw = (float(text) for text in parts[2:])
        except (ValueError, IndexError):
            raise InputError(f"{path}, line {number}: expected 't1 t2 x y z roll pitch yaw'") from None
        if not all(map(math.isfinite, (x, y, yaw))):
            raise InputError(f"{path}, line {number}: a value is not finite")
        stamps.append(pair)
        poses.append((x, y, yaw))
    if not stamps:
        raise InputError(f"{path}: no relations in the file")
    a, b = np.array(stamps, dtype=np.int64).T
    return Relations(a, b, SE2.from_array(poses))
