"""Planning with the whole footprint in position and heading: OMPL's SE2 space."""

from __future__ import annotations

from typing import Any

import numpy as np

from turtlebag.datasets.se2 import SE2, Array
from turtlebag.planners.costmap import Costmap
from turtlebag.planners.footprint import footprint_free
from turtlebag.planners.ompl_planner import (
    GOOD_ENOUGH,
    OmplConfig,
    exact_path,
    iteration_limit,
)
from turtlebag.planners.smoothing import SPACING_M

SIMPLIFY_CALLS = 400
"""How often OMPL's simplifier may ask whether to stop: a budget that repeats, unlike seconds.

Not measured."""


def solve_poses(
    costmap: Costmap,
    footprint: Array,
    T_grid_start: SE2,
    T_grid_goal: SE2,
    config: OmplConfig,
    seed: int,
) -> SE2 | None:
    """Poses (n,) of an exact, shortened path in the grid frame, or None within the budget.

    `footprint` (n, 2) is the robot's polygon in the base frame.
    """
    from ompl import base as ob
    from ompl import geometric as og
    from ompl import util as ou

    ou.noOutputHandler()
    ou.RNG.setSeed(seed % (2**32 - 1) + 1)
    space = ob.SE2StateSpace()
    bounds = ob.RealVectorBounds(2)
    for axis, extent in enumerate(costmap.size):
        bounds.setLow(axis, 0.0)
        bounds.setHigh(axis, float(extent))
    space.setBounds(bounds)
    info = ob.SpaceInformation(space)
    field, resolution = costmap.clearance, costmap.resolution

    def fits(state: Any) -> bool:
        x, y, yaw = state.getX(), state.getY(), state.getYaw()
        return bool(footprint_free(field, resolution, footprint, x, y, yaw))

    info.setStateValidityChecker(fits)
    info.setStateValidityCheckingResolution(0.5 * resolution / space.getMaximumExtent())
    info.setup()
    ends = _state(space, T_grid_start), _state(space, T_grid_goal)
    path = exact_path(info, ends, GOOD_ENOUGH * float(space.distance(*ends)), config)
    if path is None:
        return None
    og.PathSimplifier(info).simplify(path, iteration_limit(SIMPLIFY_CALLS))
    path.interpolate(max(2, round(path.length() / SPACING_M) + 1))
    # OMPL checks motions at steps of its own.
    if not all(fits(state) for state in path.getStates()):
        return None
    return SE2.from_array(np.array([[s.getX(), s.getY(), s.getYaw()] for s in path.getStates()]))


def _state(space: Any, pose: SE2) -> Any:
    state = space.allocState()
    x, y, yaw = pose.xyt.tolist()
    state.setX(x)
    state.setY(y)
    state.setYaw(yaw)
    return state
