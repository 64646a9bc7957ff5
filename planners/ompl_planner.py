"""OMPL's planners by name: seeded, limited by iterations, exact solutions only.

OMPL's seed is process-wide; it is set before every call, and every OMPL object is created anew, so
a call's result depends on its arguments alone.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any, ClassVar

import numpy as np
from numpy.typing import NDArray
from pydantic import Field

from turtlebag.datasets.se2 import Array
from turtlebag.datasets.settings import Settings
from turtlebag.planners.footprint import Field32, disc_segment_free
from turtlebag.planners.planner_names import PlannerName

ROADMAPS = ("PRM", "PRMstar")
GOOD_ENOUGH = 1.02
"""Ratio to the length of the tightened grid path at which OMPL may stop."""
RANGE_M = 1.5
"""Longest motion of the tree planners; with OMPL's own, RRTConnect's paths with headings were 1.19 times the
shortest instead of 1.05."""


class OmplConfig(Settings, allow_inf_nan=False):
    """The OMPL planner and its budget."""

    REMOVED: ClassVar[Mapping[str, str]] = {
        "space": "paths are for the disc around the footprint, or for the footprint where that does not fit",
        "turning_radius": "robots here turn on the spot",
    }
    planner: PlannerName | None = None
    """None: BITstar."""
    iterations: int = Field(default=4000, gt=0, le=1_000_000)
    """Budget in calls of the planner's termination condition: reproducible, unlike seconds."""

    @property
    def name(self) -> PlannerName:
        """The planner that is used."""
        return self.planner or "BITstar"


def ompl_loads() -> bool:
    """Whether OMPL is here, which has no wheel for every platform."""
    try:
        from ompl import geometric  # noqa: F401
    except ImportError:
        return False
    return True


@dataclass(frozen=True, eq=False)
class DiscFloor:
    """The space of a disc of `radius` [m]: a clearance field [m], and the cells (rows, cols) to search."""

    field: Field32
    resolution: float
    radius: float
    inside: NDArray[np.bool_]


def solve(
    floor: DiscFloor, start: Array, goal: Array, enough: float, config: OmplConfig, seed: int
) -> Array | None:
    """Corner points (n, 2) of an exact path for a disc in the grid frame, or None within the budget.

    A planner that improves its path continues until it is at most `enough` [m] long.
    """
    from ompl import base as ob
    from ompl import util as ou

    ou.noOutputHandler()
    ou.RNG.setSeed(seed % (2**32 - 1) + 1)
    space = ob.RealVectorStateSpace(2)
    space.setBounds(floor_bounds(ob, floor.inside, floor.resolution))
    info = ob.SpaceInformation(space)
    rows, cols = floor.inside.shape

    def valid(state: Any) -> bool:
        col, row = int(state[0] / floor.resolution), int(state[1] / floor.resolution)
        return 0 <= row < rows and 0 <= col < cols and bool(floor.inside[row, col])

    info.setStateValidityChecker(valid)
    motions = _motion_validator(ob, info, floor)
    info.setMotionValidator(motions)
    info.setup()
    path = _exact_path(info, (_state(space, start), _state(space, goal)), enough, config)
    return None if path is None else np.array([[state[0], state[1]] for state in path.getStates()])


def _exact_path(info: Any, ends: tuple[Any, Any], enough: float, config: OmplConfig) -> Any | None:
    """OMPL's path from one of the states to the other, or None within the budget.

    Its objective is its length, with `enough` as sufficient: more than the straight line, for with that in
    hand SORRTstar samples an empty set of better states forever.
    """
    from ompl import base as ob
    from ompl import geometric as og

    problem = ob.ProblemDefinition(info)
    problem.setStartAndGoalStates(*ends)
    objective = ob.PathLengthOptimizationObjective(info)
    objective.setCostThreshold(ob.Cost(enough))
    problem.setOptimizationObjective(objective)
    planner = getattr(og, config.name)(info)
    if hasattr(planner, "setRange"):
        planner.setRange(RANGE_M)
    planner.setProblemDefinition(problem)
    planner.setup()
    if config.name in ROADMAPS:
        return _path_on_roadmap(planner, problem, config.iterations)
    planner.solve(iteration_limit(config.iterations))
    # PlannerStatus is truthy for approximate solutions too.
    return solution_from(ends[0], info, problem) if problem.hasExactSolution() else None


def solution_from(start: Any, info: Any, problem: Any) -> Any | None:
    """OMPL's solution of the problem, with the start prepended where the planner left it out: AORRTC gives
    the goal alone when it is in sight. None where no motion leads from the start to its first state."""
    path = problem.getSolutionPath()
    first = path.getStates()[0]
    if info.distance(start, first) > 0.0:
        if not info.checkMotion(start, first):
            return None
        path.prepend(start)
    return path


def _path_on_roadmap(planner: Any, problem: Any, iterations: int) -> Any | None:
    """PRM without its second thread, which calls the termination condition and so waits for Python forever.

    `solve` with a condition that is true from the start only adds start and goal, and finally takes the
    roadmap's path that comes nearest to the goal: one that ends at it is exact.
    """
    from ompl import base as ob

    planner.solve(ob.plannerAlwaysTerminatingCondition())
    problem.clearSolutionPaths()
    planner.growRoadmapPtc(iteration_limit(iterations))
    planner.solve(ob.plannerAlwaysTerminatingCondition())
    joined = problem.hasSolution() and problem.getSolutionDifference() == 0.0
    return problem.getSolutionPath() if joined else None


def iteration_limit(iterations: int) -> Any:
    """A termination condition that turns true after so many calls."""
    from ompl import base as ob

    calls = 0

    def spent() -> bool:
        nonlocal calls
        calls += 1
        return calls > iterations

    return ob.PlannerTerminationCondition(spent)


def floor_bounds(ob: Any, inside: NDArray[np.bool_], resolution: float) -> Any:
    """Bounding box of the searched floor."""
    rows, cols = np.flatnonzero(inside.any(axis=1)), np.flatnonzero(inside.any(axis=0))
    bounds = ob.RealVectorBounds(2)
    for axis, cells in ((0, cols), (1, rows)):
        bounds.setLow(axis, float(cells[0] * resolution))
        bounds.setHigh(axis, float((cells[-1] + 1) * resolution))
    return bounds


def _state(space: Any, xy: Array) -> Any:
    state = space.allocState()
    state[0], state[1] = float(xy[0]), float(xy[1])
    return state


def _motion_validator(ob: Any, info: Any, floor: DiscFloor) -> Any:
    field, resolution, radius = floor.field, floor.resolution, floor.radius

    class DiscMotion(ob.MotionValidator):  # type: ignore[misc]
        """A whole motion is checked in one compiled call."""

        def checkMotion(self, a: Any, b: Any) -> bool:
            return bool(disc_segment_free(field, resolution, radius, a[0], a[1], b[0], b[1]))

    return DiscMotion(info)
