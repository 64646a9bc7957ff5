"""The constraint of a pose graph, in the plane or in space, the loop that may become one, and the graph."""

from __future__ import annotations

import enum
import math
from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import ClassVar

import numpy as np
from numpy.typing import NDArray

from turtlebag.datasets.se2 import SE2, Array


class Kind(enum.StrEnum):
    """What a constraint comes from; its value is the word in files."""

    STEP = "step"
    """The scans of two successive keys."""
    WHEELS = "odometry"
    """The calibrated odometry between two successive keys."""
    STEADY = "steady"
    """A motion that neither scans nor wheels observed: constant velocity, with little weight."""
    LOOP = "loop"
    """A place seen again."""
    PAIR = "pair"
    """Two keys that see the same, by the joint refinement."""
    BORDER = "border"
    """The last key of a recording and the first of the next."""


ALONG_THE_LOG = frozenset({Kind.STEP, Kind.WHEELS, Kind.STEADY})
"""Kinds of constraints between successive keys of one recording."""


@dataclass(frozen=True, eq=False)
class Constraint:
    """`T_i_j`, the pose of key j relative to key i, with its information in the frame of j.

    In the plane (3,) and (3, 3); in space (4, 4) and (6, 6), rotation first. `cauchy` is the width of the
    Cauchy kernel in standard deviations, 0 for none and CAUCHY where measurements may be wrong.
    """

    CAUCHY: ClassVar[float] = 2.0

    i: int
    j: int
    T_i_j: Array
    information: Array
    kind: Kind
    cauchy: float = 0.0


@dataclass(frozen=True, eq=False)
class Loop:
    """Key i at key j's place: `T_j_i` (3,), in space (4, 4), the quality of the fit, and the verdict.

    `score` is that of the search, `overlap` the share of points that fit, `gate_m` how far the search went
    (NaN for place recognition in the plane), and `violation` the share of points that violates the other's
    free space (NaN but for place recognition in the plane).
    """

    i: int
    j: int
    T_j_i: Array
    score: float
    overlap: float
    rmse: float
    information: Array
    verdict: str = "candidate"
    gate_m: float = math.nan
    violation: float = math.nan

    @property
    def accepted(self) -> bool:
        """Whether it entered the graph."""
        return self.verdict == "accepted"


@dataclass(frozen=True, eq=False)
class Graph:
    """The graph of a session: key poses, constraints (those of scans over bridged breaks without weight),
    records of all loop candidates, and the breaks of the log that no loop bridges (keys - 1,)."""

    T_map_keys: SE2
    constraints: list[Constraint]
    loops: list[Loop]
    recognised: list[Loop]
    unbridged: NDArray[np.bool_]


def firm(loops: Sequence[Constraint]) -> list[Constraint]:
    """Loops without their kernels, with which a distant start would make outliers of all of them."""
    return [replace(loop, cauchy=0.0) for loop in loops]
