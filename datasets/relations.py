"""Relations of the SLAM benchmark (Kuemmerle et al. 2009): true relative poses between two stamps."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

from turtlebag.datasets.errors import InputError
from turtlebag.datasets.files import read_unpacked
from turtlebag.datasets.se2 import SE2
from turtlebag.datasets.trajectories import NumberLines
from turtlebag.datasets.types import Stamps


@dataclass(frozen=True, eq=False)
class Relations:
    """True relative poses `T_a_b` (n,) of the robot at stamps a and b."""

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
    lines = NumberLines.of(path, content.decode("ascii", "replace"))
    if not lines.lines:
        raise InputError(f"{path}: no relations in the file")
    _, _, x, y, _, _, _, yaw = lines.numbers(8, "'t1 t2 x y z roll pitch yaw'").T
    return Relations(lines.stamps(0), lines.stamps(1), SE2.from_xyt(x, y, yaw))
