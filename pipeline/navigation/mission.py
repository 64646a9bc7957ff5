"""What a run is to do: the command's options, and the same checked, with map and goals loaded."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Literal

from turtlebag.datasets.grid import OccupancyGrid
from turtlebag.datasets.se2 import SE2
from turtlebag.pipeline.navigation.config import NavigateConfig
from turtlebag.planners.costmap import Area, Costmap
from turtlebag.planners.tasks.waypoints import Waypoint
from turtlebag.sim.robots import RobotSpec


@dataclass(frozen=True, eq=False)
class Request:
    """The options of a run. `initial_pose` is a pose, `start`, `global`, or None (no initial pose)."""

    task: str
    """goal, patrol, avoid or explore, or a user's `Task` class."""
    seed: int
    map_path: Path | None = None
    start: SE2 | None = None
    initial_pose: SE2 | Literal["start", "global"] | None = None
    goal: SE2 | None = None
    waypoints_path: Path | None = None
    laps: int | None = None
    timeout_s: float | None = None
    duration_s: float | None = None
    wiggle: bool = False
    teleop_override: Literal["keyboard"] | Path | None = None
    """Source of overrides: the keyboard, or a file of intervals instead of the configured ones."""
    keepout: tuple[Area, ...] | None = None
    """Keep-out areas; None for the world's own."""
    keepout_path: Path | None = None
    """The file that the areas were read from."""


@dataclass(frozen=True, eq=False)
class Mission:
    """A checked request, with map, goals and keep-out areas loaded."""

    request: Request
    config: NavigateConfig
    robot: RobotSpec
    grid: OccupancyGrid | None
    costmap: Costmap | None
    waypoints: tuple[Waypoint, ...]
