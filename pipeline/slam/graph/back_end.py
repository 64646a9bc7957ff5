"""The contract of a back end: it finds the poses that fit a pose graph's constraints best."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Annotated, Protocol

from pydantic import Field

from turtlebag.datasets.parts import chosen, part_of
from turtlebag.datasets.se2 import SE2
from turtlebag.pipeline.slam.graph.constraints import Constraint
from turtlebag.pipeline.slam.graph.pose_graph import Gtsam

BackEndName = Annotated[
    str, part_of("gtsam"), Field(description="solves the pose graph", exclude_if=lambda name: name == "gtsam")
]


class BackEnd(Protocol):
    """Solves planar pose graphs. It must not modify its inputs."""

    def __init__(self) -> None:
        """A new back end is made for each map."""
        ...

    def optimise(self, T_map_keys: SE2, constraints: Sequence[Constraint], iterations: int = 30) -> SE2:
        """The poses (n,) of least cost, starting from `T_map_keys`; the first is fixed.

        Each constraint adds the squared error of `T_i_j`, the pose of key j relative to key i, weighted by
        its `information` (3, 3) in the frame of j; with a Cauchy kernel of `cauchy` standard deviations
        unless that is 0. The graph is connected, but the information of a constraint may be zero along a
        direction, or altogether. The search ends after `iterations`, or when it has converged.
        """
        ...


def make_back_end(name: str) -> BackEnd:
    """The back end of that name; InputError if it is a user's class that cannot be loaded."""
    made: BackEnd = chosen(name, {"gtsam": Gtsam}, BackEnd)()
    return made
