"""The contract of a global planner: it finds a path on a map."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any, Protocol

from turtlebag.datasets.se2 import SE2
from turtlebag.datasets.types import RobotModel
from turtlebag.planners.costmap import Costmap


class NoPath(Exception):
    """There is no path, or the search ended without one; the text says which and why."""


@dataclass(frozen=True, eq=False)
class Plan:
    """A path in the map frame, (n,) poses from start to goal, and its origin.

    `length` [m]; `margin` [m] is the guaranteed clearance of the footprint. `planner` is its
    planner: the requested one, or a fallback.
    """

    poses: SE2
    length: float
    margin: float
    planner: str


class GlobalPlanner(Protocol):
    """Finds one path; a new planner is made for each. It must not modify its inputs."""

    def __init__(self, config: Any) -> None:
        """`config` are the settings `plan`, a `turtlebag.planners.global_plan.PlanConfig`."""
        ...

    def plan(self, costmap: Costmap, model: RobotModel, T_map_start: SE2, T_map_goal: SE2, seed: int) -> Plan:
        """A path along which the footprint is free of lethal cells, from start to goal.

        The footprint is free at the goal; at the start it may touch something, and the way off it is part
        of the path. There are at least two poses, at most a few cells apart, each heading along the path.
        Raises NoPath with the reason if there is none. The same seed gives the same path.
        """
        ...
