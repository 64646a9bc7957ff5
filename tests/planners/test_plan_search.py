"""Path search step by step: cells, margins, the planner's runs."""

import math

import numpy as np
import pytest

from tests.helpers.planning_room import BURGER
from turtlebag.datasets.se2 import SE2
from turtlebag.planners.costmap import Costmap
from turtlebag.planners.footprint_motions import Ground, free_from
from turtlebag.planners.global_plan import DiscSearch, blocked_until, plan_path, without_repeats
from turtlebag.planners.grid_distance import descend, grid_distance
from turtlebag.planners.ompl_planner import OmplConfig, floor_bounds, iteration_limit
from turtlebag.planners.planner import PlanConfig
from turtlebag.planners.smoothing import densify, path_length, shortcut

RES = 0.05


def cluttered(seed, share=0.01, rows=50, cols=60):
    return Costmap(np.random.default_rng(seed).random((rows, cols)) < share, RES, SE2.identity())


def search(costmap, radius=0.12):
    return DiscSearch(costmap, radius, PlanConfig())


@pytest.mark.parametrize("seed", range(3))
def test_the_entry_is_the_nearest_free_cell_within_reach(seed):
    found = search(cluttered(seed))
    cells = np.argwhere(found.free)
    centres = (cells[:, ::-1] + 0.5) * RES
    snapped = 0
    for xy in np.random.default_rng(seed).uniform(-0.3, [3.3, 2.8], (150, 2)):
        row, col = math.floor(xy[1] / RES), math.floor(xy[0] / RES)
        inside = 0 <= row < 50 and 0 <= col < 60 and found.free[row, col]
        assert found.entry(xy, 0.0) == ((row, col) if inside else None)
        gaps = np.linalg.norm(centres - xy, axis=1)
        if inside:
            expected = row, col
        elif gaps.min() <= 0.2:
            expected, snapped = tuple(cells[gaps.argmin()]), snapped + 1
        else:
            expected = None
        assert found.entry(xy, 0.2) == expected
    assert snapped > 5
    np.testing.assert_allclose(found.center((3, 7)), [0.375, 0.175])


def test_cells_at_the_edge_are_cells_and_those_beyond_are_none():
    everywhere = search(Costmap(np.zeros((50, 60), dtype=bool), RES, SE2.identity()), radius=0.01)
    for xy, cell in (
        ((0.0, 0.0), (0, 0)), ((2.999, 2.499), (49, 59)), ((3.0, 1.0), None),
        ((1.0, 2.5), None), ((-0.001, 1.0), None),
    ):  # fmt: skip
        assert everywhere.entry(np.array(xy), 0.0) == cell


@pytest.mark.parametrize("seed", range(3))
def test_the_way_over_cells_is_the_grid_distances_drawn_tight(seed):
    found = search(cluttered(seed), radius=0.1)
    cells = np.argwhere(found.free)
    rng = np.random.default_rng(seed)
    for a, b in rng.integers(len(cells), size=(8, 2)):
        start, goal = tuple(cells[a].tolist()), tuple(cells[b].tolist())
        distance = grid_distance(found.free, *goal, np.inf)
        assert found.connected(start, goal) == bool(np.isfinite(distance[start]))
        np.testing.assert_array_equal(found.to_goal(goal), distance)
        if not found.connected(start, goal) or start == goal:
            continue
        points = (descend(distance, *start)[:, ::-1] + 0.5) * RES
        path = found.grid_path(start, goal)
        np.testing.assert_array_equal(path, shortcut(found.field, RES, 0.1, points))
        tight = found.tightened(path)
        assert path_length(tight) <= path_length(path) + 1e-12
        np.testing.assert_allclose(tight[[0, -1]], path[[0, -1]])


@pytest.mark.parametrize("radius", [0.1, 0.2, 0.3])
def test_a_way_around_a_wall_s_end_drawn_tight_is_two_tangents_and_the_arc_between_them(radius):
    lethal = np.zeros((60, 80), dtype=bool)
    lethal[:30, 40] = True
    found, end = search(Costmap(lethal, RES, SE2.identity()), radius), np.array([40.5, 29.5]) * RES
    for start, goal in (((20, 20), (20, 60)), ((22, 15), (12, 62)), ((8, 25), (25, 70))):
        way = np.array([found.center(start), found.center(goal)]) - end
        far = np.linalg.norm(way, axis=1)
        one, other = np.arctan2(way[:, 1], way[:, 0])
        arc = (one - other) % (2.0 * math.pi) - np.arccos(radius / far).sum()
        string = np.sqrt(far**2 - radius**2).sum() + radius * arc
        tight = found.tightened(found.grid_path(start, goal))
        assert path_length(tight) == pytest.approx(string, rel=2e-3)


def test_ompl_searches_the_floor_of_short_ways_and_the_way_over_the_cells_stands_in_for_it():
    lethal = np.zeros((50, 60), dtype=bool)
    lethal[:40, 25] = True
    costmap, start, goal = Costmap(lethal, RES, SE2.identity()), (10, 10), (20, 55)
    for iterations, by in ((1, "grid"), (4000, "BITstar")):
        config = PlanConfig(ompl=OmplConfig(iterations=iterations))
        found = DiscSearch(costmap, 0.1, config)
        path, planner = found.run(start, goal, 70)
        assert planner == by
        np.testing.assert_allclose(path[[0, -1]], [found.center(start), found.center(goal)])
        shortest = path_length(found.tightened(found.grid_path(start, goal)))
        assert path_length(path) == pytest.approx(shortest, rel=5e-3 if by == "BITstar" else 1e-9)
        path, planner = found.run(goal, goal, 1)
        np.testing.assert_array_equal(path, [found.center(goal)] * 2)
        assert planner == "BITstar"
    # only floor on some way at most a tenth longer than the shortest, and two cells, is searched
    limit = 1.1 * float(grid_distance(found.free, *goal, np.inf)[start]) + 2.0
    through = grid_distance(found.free, *start, np.inf) + grid_distance(found.free, *goal, np.inf)
    floor = found.informed_floor(start, goal)
    np.testing.assert_array_equal(floor.inside, through <= limit)
    assert 0 < floor.inside.sum() < found.free.sum()
    assert (floor.resolution, floor.radius) == (RES, 0.1)


def test_repeated_points_are_dropped_and_two_are_kept():
    points = np.array([[0.0, 0.0], [0.0, 0.0], [1.0, 0.0], [1.0, 1e-7], [1.0, 1.0]])
    np.testing.assert_array_equal(without_repeats(points), points[[0, 2, 4]])
    np.testing.assert_array_equal(without_repeats(points[:2]), points[:2])
    np.testing.assert_array_equal(without_repeats(points[2:4]), points[[2, 3]])


def test_a_path_is_blocked_until_its_last_touch():
    costmap = Costmap(np.zeros((50, 60), dtype=bool), RES, SE2.identity())
    costmap.lethal[20, 30] = True
    line = SE2.from_xyt(np.linspace(0.5, 2.5, 41), np.full(41, 1.025), np.zeros(41))
    length = blocked_until(costmap, BURGER.footprint, line)
    # the tail passes the post's centre at x = 1.525 when the robot is at 1.63
    assert length == pytest.approx(1.65 - 0.5, abs=0.051)
    assert blocked_until(costmap, BURGER.footprint, line[:10]) is None
    first = free_from(Ground(costmap.clearance, RES, BURGER.footprint), line.xyt)
    assert length == pytest.approx(path_length(line.xy[: first + 1]))


def test_more_room_is_kept_where_it_costs_little_and_given_up_where_it_does_not_fit():
    """Two gaps in a wall: a narrow one on the straight way, a wide one far off it."""
    lethal = np.zeros((100, 80), dtype=bool)
    lethal[[0, -1], :] = lethal[:, [0, -1]] = True
    lethal[:, 40] = True
    lethal[46:54, 40] = False
    lethal[80:98, 40] = False
    costmap = Costmap(lethal, RES, SE2.identity())
    start, goal = SE2.from_xyt(1.0, 2.5, 0.0), SE2.from_xyt(3.0, 2.5, 0.0)
    wide = BURGER.circumscribed_radius
    margins = (0.1, 0.05, 0.0)
    for stretch, kept, narrow in ((1.05, margins, True), (3.0, margins, False), (1.05, (0.1,), False)):
        plan = plan_path(costmap, BURGER, start, goal, PlanConfig(stretch=stretch, margins=kept), 1)
        assert (plan.length < 2.2) == narrow
        assert plan.margin == (0.05 if narrow else 0.1)
        clear = costmap.clearance_at(densify(plan.poses.xy.copy(), 0.01)).min()
        assert (clear > wide + 0.09) == (not narrow)
        assert plan.length == pytest.approx(path_length(plan.poses.xy))


def test_ompl_searches_the_box_of_the_floor_and_so_many_calls():
    class Box:
        def __init__(self, n):
            self.low, self.high = [0.0] * n, [0.0] * n

        def setLow(self, axis, value):
            self.low[axis] = value

        def setHigh(self, axis, value):
            self.high[axis] = value

    inside = np.zeros((50, 60), dtype=bool)
    inside[7:20, 11] = inside[9, 11:31] = True
    box = floor_bounds(type("ob", (), {"RealVectorBounds": Box}), inside, RES)
    assert box.low == pytest.approx([11 * RES, 7 * RES])
    assert box.high == pytest.approx([31 * RES, 20 * RES])
    condition = iteration_limit(3)
    assert [bool(condition()) for _ in range(5)] == [False, False, False, True, True]
