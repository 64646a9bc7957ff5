"""The global planner: a grid search tells whether there is a path and how long it must be, OMPL plans it, an
elastic band smooths it.

The path is planned for the disc that contains the footprint, first with a wide margin, then
with less: a differential robot can turn on the spot anywhere along such a path. If there is none for the
disc, the footprint itself is checked in every heading (turtlebag.planners.lattice).
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from turtlebag.datasets.parts import chosen
from turtlebag.datasets.se2 import SE2, Array
from turtlebag.datasets.types import RobotModel
from turtlebag.planners.control.collision_monitor import padded
from turtlebag.planners.costmap import COST_SCALING, SNAP_M, Costmap, nearest_free
from turtlebag.planners.footprint import footprint_free
from turtlebag.planners.footprint_motions import Ground, free_from
from turtlebag.planners.grid_distance import descend, grid_distance
from turtlebag.planners.lattice import Lattice
from turtlebag.planners.ompl_planner import GOOD_ENOUGH, DiscFloor, solve
from turtlebag.planners.planner import GlobalPlanner, NoPath, Plan, PlanConfig
from turtlebag.planners.smoothing import SPACING_M, Band, densify, path_length, relax, shortcut, with_headings

BAND_PULL, BAND_PUSHES, BAND_ITERATIONS = 0.5, (0.1, 0.05, 0.02, 0.0), 60
"""Weights and iterations of the elastic band; a gentler push leaves the path shorter and nearer to the walls.

Not measured."""
TIGHT_PULL, TIGHT_ITERATIONS = 0.9, 300
"""The same for pulling a path tight: with those of the band RRTConnect's are 0.5 % longer."""
INFORMED = 1.1
"""OMPL searches only floor on some way at most this much longer than the shortest over the cells: without
it RRTConnect's are 2.5 % longer on average, one 78 % (48 plans on eight maps)."""
ROOM = 0.05
"""Room round the footprint [m] where the disc round it does not pass; half a cell at least, in need."""
OVER_CELLS, ORIENTED = "grid", "footprint lattice"
"""Planners of last resort: tightened ways over cells, or cells and headings."""


def fits(costmap: Costmap, model: RobotModel, T_map_base: SE2) -> bool:
    """Whether the footprint at a pose contains no centre of a lethal cell."""
    x, y, yaw = (costmap.T_grid_map @ T_map_base).xyt.tolist()
    return bool(footprint_free(costmap.clearance, costmap.resolution, model.footprint, x, y, yaw))


def plan_path(
    costmap: Costmap, model: RobotModel, T_map_start: SE2, T_map_goal: SE2, config: PlanConfig, seed: int
) -> Plan:
    """A collision-free path for the footprint by the planner of the settings; raises NoPath with the reason.

    InputError where that is the user's own and not to be had.
    """
    if not fits(costmap, model, T_map_goal):
        raise NoPath("the goal is in an obstacle or off the map")
    planner: GlobalPlanner = chosen(config.planner, PLANNERS, GlobalPlanner)(config)
    return planner.plan(costmap, model, T_map_start, T_map_goal, seed)


class OmplPlanner:
    """OMPL on the floor of a disc, then the footprint in every heading."""

    def __init__(self, config: PlanConfig) -> None:
        self._config = config

    def plan(self, costmap: Costmap, model: RobotModel, T_map_start: SE2, T_map_goal: SE2, seed: int) -> Plan:
        """As in `GlobalPlanner`."""
        config = self._config
        start, goal = costmap.T_grid_map @ T_map_start, costmap.T_grid_map @ T_map_goal
        way, reason = _disc_way(costmap, model, start, goal, config, seed)
        if way is not None:
            poses = with_headings(way.points, float(start.yaw), float(goal.yaw))
            plan = Plan(costmap.T_map_grid @ poses, way.length, way.margin, way.planner)
            if blocked_until(costmap, model.footprint, poses) is None:
                return plan
        oriented = _oriented_plan(costmap, model, start, goal, config)
        if oriented is not None:
            return oriented
        if way is None:
            raise NoPath(reason)
        # Off an obstacle that it stands too near a robot must get somehow; cells are no finer than this.
        stuck = blocked_until(costmap, padded(model.footprint, -0.3 * costmap.resolution), poses)
        if stuck is not None and stuck > 2.0 * SNAP_M:
            raise NoPath("no path to the goal")
        return plan


class LatticePlanner:
    """The footprint in every heading, over cells: needs no OMPL."""

    def __init__(self, config: PlanConfig) -> None:
        self._config = config

    def plan(self, costmap: Costmap, model: RobotModel, T_map_start: SE2, T_map_goal: SE2, seed: int) -> Plan:
        """As in `GlobalPlanner`."""
        start, goal = costmap.T_grid_map @ T_map_start, costmap.T_grid_map @ T_map_goal
        plan = _oriented_plan(costmap, model, start, goal, self._config)
        if plan is None:
            raise NoPath("no path to the goal")
        return plan


PLANNERS: dict[str, type[GlobalPlanner]] = {"ompl": OmplPlanner, "lattice": LatticePlanner}


def _disc_way(
    costmap: Costmap, model: RobotModel, start: SE2, goal: SE2, config: PlanConfig, seed: int
) -> tuple[_Way | None, str]:
    """The way of the disc round the footprint with most room that is not too long, or why there is none."""
    best: _Way | None = None
    reason, limit = "the goal is too close to an obstacle", None
    for margin in config.margins:
        last = margin == config.margins[-1]
        if last and best is not None:
            break
        search = DiscSearch(costmap, model.circumscribed_radius + margin, config)
        entry, exit_ = search.entry(start.xy), search.entry(goal.xy, SNAP_M if last else 0.0)
        if entry is None or exit_ is None:
            if entry is None:
                reason = "the robot is too close to an obstacle"
            continue
        if not search.connected(entry, exit_):
            reason = "no path to the goal"
            continue
        tight, by = search.run(entry, exit_, seed)
        if limit is None:
            limit = config.stretch * _shortest(costmap, model, start, goal, config)
        points = search.rounded(tight, start.xy, goal.xy, limit)
        way = _Way(points, path_length(points), margin, by)
        if best is None or way.length < best.length:
            best = way
        if best.length <= limit:
            break
    return best, reason


def _oriented_plan(
    costmap: Costmap, model: RobotModel, start: SE2, goal: SE2, config: PlanConfig
) -> Plan | None:
    """A path of the footprint itself, if there is one; in need with no more room than cells need."""
    # A lethal cell reaches half a cell beyond its centre.
    least = max(0.5 * costmap.resolution, min(config.margins))
    lattice = Lattice(costmap, model.footprint, least)
    if not lattice.joins(start, goal):
        return None
    roomy = Lattice(costmap, model.footprint, max(ROOM, least))
    way = roomy.way(start, goal) if roomy.joins(start, goal) else None
    way = lattice.way(start, goal) if way is None else way
    return None if way is None else Plan(costmap.T_map_grid @ way, path_length(way.xy), 0.0, ORIENTED)


def blocked_until(costmap: Costmap, footprint: Array, poses: SE2) -> float | None:
    """Length of the path up to the last place where the footprint touches something [m]; None: nowhere."""
    xyt = np.ascontiguousarray(poses.xyt)
    first = int(free_from(Ground(costmap.clearance, costmap.resolution, footprint), xyt))
    return None if first == 0 else path_length(poses.xy[: first + 1])


@dataclass(frozen=True, eq=False)
class _Way:
    """Points (n, 2) in the grid frame."""

    points: Array
    length: float
    margin: float
    planner: str


def _shortest(costmap: Costmap, model: RobotModel, start: SE2, goal: SE2, config: PlanConfig) -> float:
    """Length of the tightened grid path with the least room [m]; inf when there is none."""
    search = DiscSearch(costmap, model.circumscribed_radius + min(config.margins), config)
    entry, exit_ = search.entry(start.xy), search.entry(goal.xy)
    if entry is None or exit_ is None or not search.connected(entry, exit_):
        return np.inf
    return path_length(search.tightened(search.grid_path(entry, exit_)))


def without_repeats(points: Array) -> Array:
    """Drop points that repeat the one before; two are kept at least."""
    keep = np.ones(len(points), dtype=bool)
    keep[1:] = np.linalg.norm(np.diff(points, axis=0), axis=1) > 1e-6
    if keep.sum() < 2:
        return points[[0, -1]]
    return points[keep]


class DiscSearch:
    """The search for a way of a disc of one radius [m], in the grid frame."""

    def __init__(self, costmap: Costmap, radius: float, config: PlanConfig) -> None:
        self.field = costmap.clearance
        self.resolution = costmap.resolution
        self.radius = radius
        self.config = config
        self.free: NDArray[np.bool_] = costmap.clearance > radius
        self._from_goal: tuple[tuple[int, int], NDArray[np.float32]] | None = None

    def entry(self, xy: Array, reach: float = SNAP_M) -> tuple[int, int] | None:
        """The free cell under a point, or the nearest one within reach [m]."""
        return nearest_free(self.free, xy / self.resolution, reach / self.resolution)

    def to_goal(self, goal: tuple[int, int]) -> NDArray[np.float32]:
        """Distance from every cell to the goal's, in cells."""
        if self._from_goal is None or self._from_goal[0] != goal:
            self._from_goal = goal, grid_distance(self.free, goal[0], goal[1], np.inf)
        return self._from_goal[1]

    def connected(self, a: tuple[int, int], b: tuple[int, int]) -> bool:
        """Whether the floor of this radius joins two cells."""
        return bool(np.isfinite(self.to_goal(b)[a]))

    def center(self, cell: tuple[int, int]) -> Array:
        """The middle of a cell, (2,)."""
        return (np.array([cell[1], cell[0]], dtype=np.float64) + 0.5) * self.resolution

    def grid_path(self, start: tuple[int, int], goal: tuple[int, int]) -> Array:
        """The way over the cells, points (n, 2) without its needless corners."""
        cells = descend(self.to_goal(goal), *start)
        points = np.asarray((cells[:, ::-1] + 0.5) * self.resolution, dtype=np.float64)
        return shortcut(self.field, self.resolution, self.radius, points)

    def informed_floor(self, start: tuple[int, int], goal: tuple[int, int]) -> DiscFloor:
        """The floor on ways between joined cells that are hardly longer than the shortest: the informed set
        (Gammell et al. 2014) by distances along the floor instead of straight ones."""
        from_goal = self.to_goal(goal)
        limit = float(from_goal[start]) * INFORMED + 2.0
        inside = grid_distance(self.free, start[0], start[1], limit) + from_goal <= limit
        return DiscFloor(self.field, self.resolution, self.radius, inside)

    def run(self, start: tuple[int, int], goal: tuple[int, int], seed: int) -> tuple[Array, str]:
        """Corners (n, 2) of a tight path between joined cells, and its planner.

        A way that OMPL does not find is the way over the cells, which joined cells always have.
        """
        ompl, a, b = self.config.ompl, self.center(start), self.center(goal)
        if start == goal:  # OMPL's informed planners have no ellipse about a single point
            return np.array([a, b]), ompl.name
        over_cells = self.grid_path(start, goal)
        enough = GOOD_ENOUGH * path_length(over_cells)
        raw = solve(self.informed_floor(start, goal), a, b, enough, ompl, seed)
        if raw is None:
            return self.tightened(over_cells), OVER_CELLS
        tight = shortcut(self.field, self.resolution, self.radius, densify(raw, 2.0 * SPACING_M))
        return self.tightened(tight), ompl.name

    def tightened(self, path: Array) -> Array:
        """Corners (n, 2) of the path drawn tight like a string."""
        dense = densify(path, SPACING_M)
        pulled = self._band(dense, 0.0, TIGHT_PULL, TIGHT_ITERATIONS)
        tight = shortcut(self.field, self.resolution, self.radius, pulled)
        return tight if path_length(tight) < path_length(path) else path

    def rounded(self, tight: Array, start: Array, goal: Array, limit: float) -> Array:
        """Points (n, 2) from start to goal, pushed off obstacles as far as the length limit lets them."""
        points = tight
        for push in BAND_PUSHES:
            band = self._band(densify(tight, SPACING_M), push, BAND_PULL, BAND_ITERATIONS)
            whole = np.concatenate([start[None], densify(band, 2.0 * SPACING_M), goal[None]])
            points = without_repeats(whole)
            if path_length(points) <= limit:
                break
        return points

    def _band(self, dense: Array, push: float, pull: float, iterations: int) -> Array:
        reach = max(self.config.inflation_radius, self.radius)
        band = Band(reach, COST_SCALING, pull, push, iterations)
        return relax(self.field, self.resolution, self.radius, dense, band)
