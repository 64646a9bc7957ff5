"""The contract of a global planner: it finds a path on a map."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Annotated, Protocol

from pydantic import Field

from turtlebag.datasets.parts import part_of
from turtlebag.datasets.se2 import SE2
from turtlebag.datasets.settings import Settings
from turtlebag.datasets.types import RobotModel
from turtlebag.planners.costmap import Costmap
from turtlebag.planners.ompl_planner import OmplConfig


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


class PlanConfig(Settings, allow_inf_nan=False):
    """Distances in metres."""

    planner: Annotated[str, part_of("ompl", "lattice")] = Field(
        default="ompl", exclude_if=lambda name: name == "ompl"
    )
    """`ompl`, `lattice` (the footprint in every heading, without OMPL), or your own class."""
    ompl: OmplConfig = OmplConfig()
    margins: tuple[Annotated[float, Field(ge=0.0, le=10.0)], ...] = Field(
        default=(0.10, 0.07, 0.04, 0.0), min_length=1, max_length=20
    )
    """Margins around the circumscribed circle, tried in this order; the last one only if needed."""
    stretch: float = Field(default=1.05, ge=1.0, le=10.0)
    """Longest path for the sake of a wider margin, relative to the shortest one with the last margin."""
    inflation_radius: float = Field(default=0.35, gt=0.0, le=10.0)
    """Distance from the disc within which obstacles push the path away."""

    @property
    def name(self) -> str:
        """The planner's name: an OMPL planner, or a user's class."""
        return self.ompl.name if self.planner == "ompl" else self.planner


class GlobalPlanner(Protocol):
    """Finds one path; a new planner is made for each. It must not modify its inputs."""

    def __init__(self, config: PlanConfig) -> None:
        """`config` are the settings `plan`."""
        ...

    def plan(self, costmap: Costmap, model: RobotModel, T_map_start: SE2, T_map_goal: SE2, seed: int) -> Plan:
        """A path along which the footprint is free of lethal cells, from start to goal.

        The footprint is free at the goal; at the start it may touch something, and the way off it is part
        of the path. There are at least two poses, at most a few cells apart, each heading along the path.
        Raises NoPath with the reason if there is none. The same seed gives the same path.
        """
        ...
