"""Checks the user's poses on a map: refused in one line if the robot cannot stand there."""

from __future__ import annotations

from pathlib import Path

from turtlebag.datasets.errors import InputError
from turtlebag.datasets.se2 import SE2
from turtlebag.datasets.types import RobotModel
from turtlebag.planners.costmap import Costmap
from turtlebag.planners.global_plan import fits


def on_map(costmap: Costmap, T_map_base: SE2) -> bool:
    """Whether a pose lies on the map."""
    gx, gy = (costmap.T_grid_map @ T_map_base.xy).tolist()
    width, height = costmap.size
    return 0.0 <= gx < width and 0.0 <= gy < height


def require_on_map(option: str, T_map_base: SE2, costmap: Costmap, map_path: Path) -> None:
    """InputError when the pose is off the map."""
    if not on_map(costmap, T_map_base):
        raise InputError(f"{_text(option, T_map_base)}: is off the map {map_path}")


def require_free(option: str, T_map_base: SE2, costmap: Costmap, model: RobotModel, map_path: Path) -> None:
    """InputError when the pose is off the map, or the footprint there touches an obstacle or the unknown."""
    require_on_map(option, T_map_base, costmap, map_path)
    if not fits(costmap, model, T_map_base):
        text = _text(option, T_map_base)
        raise InputError(f"{text}: the robot would stand in an obstacle or unknown space of {map_path}")


def _text(option: str, T_map_base: SE2) -> str:
    x, y, yaw = T_map_base.xyt.tolist()
    return f"{option} {x:g},{y:g},{yaw:g}"
