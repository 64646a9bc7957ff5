"""The contract of a back end: it finds the poses that fit a pose graph's constraints best."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Annotated, Protocol

from pydantic import Field

from turtlebag.datasets.parts import Answer, chosen, part_of
from turtlebag.datasets.se2 import SE2
from turtlebag.pipeline.slam.factors import Constraint
from turtlebag.pipeline.slam.pose_graph import Gtsam

BackEndName = Annotated[
    str, part_of("gtsam"), Field(description="solves the pose graph", exclude_if=lambda name: name == "gtsam")
]


class BackEnd(Protocol):
    """Solves pose graphs of the plane. It may change nothing that it is given."""

    def __init__(self) -> None:
        """One is made for each map."""
        ...

    def optimise(self, T_map_keys: SE2, constraints: Sequence[Constraint], iterations: int = 30) -> SE2:
        """The poses (n,) of least cost, searched from `T_map_keys`, the first of which is held.

        Each constraint adds the squared error of `T_i_j`, the pose of key j seen from key i, weighed by its
        `information` (3, 3) in the frame of j; with a Cauchy kernel of `cauchy` standard deviations where
        that is not 0. Every key is joined to others, but by constraints whose information may be zero along a
        direction, or altogether. The search ends after so many iterations, or when nothing moves any more.
        """
        ...


def make_back_end(name: str) -> BackEnd:
    """The back end of that name; InputError where it is the user's own and not to be had."""
    made: BackEnd = chosen(name, {"gtsam": Gtsam}, BackEnd)()
    return made


def solved(
    back_end: BackEnd, T_map_keys: SE2, constraints: Sequence[Constraint], iterations: int = 30
) -> SE2:
    """What a back end finds; InputError where that are not as many poses, all finite."""
    found = back_end.optimise(T_map_keys, constraints, iterations)
    answer = Answer(back_end, "optimise")
    answer.require_a(SE2, found)
    answer.require_finite("poses", found.xyt, len(T_map_keys), 3)
    return found
