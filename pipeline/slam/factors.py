"""The constraint of a pose graph, in the plane or in space."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Literal

from turtlebag.datasets.se2 import Array

Kind = Literal["step", "odometry", "steady", "loop", "pair"]


@dataclass(frozen=True, eq=False)
class Constraint:
    """`T_i_j`, the pose of key j relative to key i, with its information in the frame of j.

    In the plane (3,) and (3, 3); in space (4, 4) and (6, 6), rotation first. `cauchy` is the width of the
    Cauchy kernel in standard deviations, 0 for none.
    """

    i: int
    j: int
    T_i_j: Array
    information: Array
    kind: Kind
    cauchy: float = 0.0


def firm(loops: Sequence[Constraint]) -> list[Constraint]:
    """Loops without their kernels, with which a distant start would make outliers of all of them."""
    return [replace(loop, cauchy=0.0) for loop in loops]
