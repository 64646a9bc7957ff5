"""Paths over one map, one after another."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Any

from turtlebag.api import given
from turtlebag.api.given import PathLike, Pose
from turtlebag.api.outputs import as_map, robot_for
from turtlebag.datasets.se2 import Array
from turtlebag.pipeline.stages.plan import PlanStageConfig, Query, planner_settings, search
from turtlebag.pipeline.stages.requests.options import class_name
from turtlebag.pipeline.stages.settings import load_config
from turtlebag.planners.costmap import costmap_from_grid
from turtlebag.planners.planner import NoPath
from turtlebag.sim.robots import load_robot


class Planner:
    """Plans paths for a robot over a map, which is prepared only once.

    `planner` is one of OMPL's or a class, `robot` a name or a file (default: the one that made the map, else
    burger); settings are those of `plan`. The same seed gives the same path.
    """

    def __init__(
        self,
        map: PathLike,
        robot: PathLike | None = None,
        *,
        planner: str | type | None = None,
        seed: int = 1,
        config: PathLike | None = None,
        settings: Mapping[str, Any] | None = None,
    ) -> None:
        """InputError for an unknown robot or planner, or an unreadable map."""
        chosen = {**(settings or {}), **planner_settings(class_name(planner))}
        self._config = load_config(PlanStageConfig, None if config is None else Path(config), chosen)
        self._map, self._seed = as_map(map), seed
        self._robot = load_robot(robot_for(self._map, robot))
        self._costmap = costmap_from_grid(self._map.occupancy, self._config.costmap)

    def plan(self, start: Pose, goal: Pose) -> Array:
        """Poses (n, 3) of x, y [m], yaw [rad] from start to goal in the map's frame.

        NoPath gives the reason if there is none; InputError if start or goal is off the map or in an
        obstacle.
        """
        query = Query(self._robot, given.pose(start, "start"), given.pose(goal, "goal"), self._seed)
        query.require_free(self._costmap, self._map.yaml)
        found, reason, _ = search(self._costmap, query, self._config)
        if found is None:
            raise NoPath(reason)
        return found.poses.xyt
