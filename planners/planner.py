"""The contract of a global planner: it finds a path on a map."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any, Protocol

from turtlebag.datasets.parts import Answer
from turtlebag.datasets.se2 import SE2
from turtlebag.datasets.types import RobotModel
from turtlebag.planners.costmap import Costmap


class NoPath(Exception):
    """There is certainly no path, or none was found; the text says which and why."""


@dataclass(frozen=True, eq=False)
class Plan:
    """A path in the map frame, (n,) poses from start to goal, and how it came about.

    `length` [m], `margin` [m] the room it keeps round the footprint as far as it is known. `planner` is what
    found it: the planner asked, or one of the last resorts.
    """

    poses: SE2
    length: float
    margin: float
    planner: str


class GlobalPlanner(Protocol):
    """Finds one path; it is made anew for each. It may change nothing that it is given."""

    def __init__(self, config: Any) -> None:
        """With the settings of the section `plan`, a `turtlebag.planners.global_plan.PlanConfig`."""
        ...

    def plan(self, costmap: Costmap, model: RobotModel, T_map_start: SE2, T_map_goal: SE2, seed: int) -> Plan:
        """A path along which the footprint is free of lethal cells, from start to goal.

        The footprint is free at the goal; at the start it may touch something, and the way off that is part
        of the path. Poses are at most a few cells apart, two at least, each heading the way to go. Raises
        NoPath with the reason where there is none. The same seed gives the same path.
        """
        ...


def require_plan(planner: GlobalPlanner, plan: object) -> None:
    """InputError unless it is what `plan` must return."""
    answer = Answer(planner, "plan")
    answer.require_a(Plan, plan)
    assert isinstance(plan, Plan)
    answer.require_kind("poses", plan.poses, SE2)
    answer.require_kind("planner", plan.planner, str)
    if len(plan.poses) < 2:
        raise answer.wrong("a path needs at least two poses")
    answer.require_finite("poses", plan.poses.xyt, len(plan.poses), 3)
    for what in ("length", "margin"):
        answer.require_finite(what, getattr(plan, what))
    if plan.length < 0.0:
        raise answer.wrong("length is negative")
