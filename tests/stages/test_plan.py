import itertools
import json
import math

import numpy as np
import pytest

from tests.helpers.planning_room import BURGER, room
from turtlebag.datasets.grid import FREE, OCCUPIED, OccupancyGrid
from turtlebag.datasets.maps import save_map
from turtlebag.datasets.outputs import Output
from turtlebag.datasets.se2 import SE2
from turtlebag.datasets.yaml_files import checked
from turtlebag.pipeline.stages.plan import plan
from turtlebag.pipeline.stages.requests.maps import PlanRequest
from turtlebag.planners.costmap import CostmapConfig, costmap_from_grid
from turtlebag.planners.global_plan import plan_path
from turtlebag.planners.grid_distance import descend, grid_distance
from turtlebag.planners.ompl_planner import DiscFloor, OmplConfig, solution_from, solve
from turtlebag.planners.planner import PlanConfig
from turtlebag.planners.smoothing import Band, densify, path_length, relax, shortcut


def walled_room() -> OccupancyGrid:
    """4 x 4 m at 5 cm, with a wall at x = 2 that leaves a gap at y > 3."""
    cells = np.full((80, 80), FREE, dtype=np.int8)
    cells[[0, -1], :] = OCCUPIED
    cells[:, [0, -1]] = OCCUPIED
    cells[:60, 40] = OCCUPIED
    return OccupancyGrid(cells, 0.05)


START, GOAL = SE2.from_xyt(1.0, 1.0, 0.0), SE2.from_xyt(3.0, 1.0, math.pi / 2)


def test_a_plan_leads_from_start_to_goal_and_keeps_its_clearance():
    costmap = costmap_from_grid(walled_room(), CostmapConfig())
    plan = plan_path(costmap, BURGER, START, GOAL, PlanConfig(), seed=3)
    np.testing.assert_allclose(plan.poses.xyt[0], START.xyt, atol=1e-9)
    np.testing.assert_allclose(plan.poses.xyt[-1], GOAL.xyt, atol=1e-9)
    dense = densify(plan.poses.xy.copy(), 0.01)
    assert costmap.clearance_at(dense).min() > BURGER.circumscribed_radius
    # Round the wall's end at (2.025, 3.0), keeping the disc off it.
    straight = 2.0 * math.hypot(1.0, 2.0)
    assert straight < plan.length < 1.2 * straight


def test_the_same_seed_gives_the_same_plan_whatever_was_planned_before():
    costmap = costmap_from_grid(walled_room(), CostmapConfig())
    first = plan_path(costmap, BURGER, START, GOAL, PlanConfig(), seed=3)
    plan_path(costmap, BURGER, GOAL, START, PlanConfig(), seed=99)
    again = plan_path(costmap, BURGER, START, GOAL, PlanConfig(), seed=3)
    assert np.array_equal(first.poses.xyt, again.poses.xyt)


@pytest.mark.slow
@pytest.mark.parametrize(
    "planner", ["RRTConnect", "RRTstar", "InformedRRTstar", "BITstar", "KPIECE1", "PRM", "PRMstar"]
)
def test_planners_can_be_chosen_by_name(planner):
    costmap = costmap_from_grid(walled_room(), CostmapConfig())
    config = PlanConfig(ompl=OmplConfig(planner=planner, iterations=3000))
    plan = plan_path(costmap, BURGER, START, GOAL, config, seed=1)
    assert costmap.clearance_at(densify(plan.poses.xy.copy(), 0.01)).min() > BURGER.circumscribed_radius


def test_a_robot_against_a_wall_plans_its_way_out():
    costmap = costmap_from_grid(walled_room(), CostmapConfig())
    plan = plan_path(costmap, BURGER, SE2.from_xyt(0.16, 1.0, 0.0), GOAL, PlanConfig(), seed=1)
    np.testing.assert_allclose(plan.poses.xy[0], [0.16, 1.0])


def test_a_plan_in_a_turned_map_is_the_turned_plan():
    T_map_grid = SE2.from_xyt(3.0, -1.0, 0.7)
    grid = walled_room()
    straight = costmap_from_grid(grid, CostmapConfig())
    turned = costmap_from_grid(OccupancyGrid(grid.cells, 0.05, T_map_grid), CostmapConfig())
    a = plan_path(straight, BURGER, START, GOAL, PlanConfig(), seed=3)
    b = plan_path(turned, BURGER, T_map_grid @ START, T_map_grid @ GOAL, PlanConfig(), seed=3)
    assert b.length == pytest.approx(a.length, rel=0.02)
    assert turned.clearance_at(densify(b.poses.xy.copy(), 0.01)).min() > BURGER.circumscribed_radius


def test_grid_distances_match_a_plain_relaxation():
    rng = np.random.default_rng(8)
    free = rng.random((15, 20)) > 0.3
    free[3, 3] = True
    expected = np.full(free.shape, np.inf)
    expected[3, 3] = 0.0
    for _ in range(free.size):
        before = expected.copy()
        for dr, dc in itertools.product((-1, 0, 1), repeat=2):
            if (dr, dc) == (0, 0):
                continue
            shifted = np.full(free.shape, np.inf)
            rows, cols = np.indices(free.shape)
            r, c = rows + dr, cols + dc
            ok = (r >= 0) & (r < 15) & (c >= 0) & (c < 20)
            shifted[ok] = expected[r[ok], c[ok]] + math.hypot(dr, dc)
            expected = np.where(free, np.minimum(expected, shifted), expected)
        expected[3, 3] = 0.0
        if np.array_equal(before, expected):
            break
    np.testing.assert_allclose(grid_distance(free, 3, 3, np.inf), expected, rtol=1e-5)


def test_descending_the_grid_distance_walks_to_its_source_over_free_cells():
    free = costmap_from_grid(walled_room(), CostmapConfig()).clearance > 0.15
    distance = grid_distance(free, 20, 20, np.inf)
    path = descend(distance, 20, 60)
    assert path[0].tolist() == [20, 60]
    assert path[-1].tolist() == [20, 20]
    assert np.abs(np.diff(path, axis=0)).max() == 1
    assert free[path[:, 0], path[:, 1]].all()


def test_shortcuts_never_lengthen_and_stay_free():
    costmap = costmap_from_grid(walled_room(), CostmapConfig())
    zigzag = np.array([[1.0, 1.0], [0.5, 2.0], [1.5, 3.0], [1.0, 3.5], [2.2, 3.5], [3.5, 3.2], [3.0, 1.0]])
    tight = shortcut(costmap.clearance, 0.05, 0.15, densify(zigzag, 0.1))
    assert path_length(tight) < path_length(zigzag)
    assert costmap.clearance_at(densify(tight, 0.01)).min() > 0.15 - 0.05


def test_the_elastic_band_moves_away_from_obstacles_and_holds_its_ends():
    costmap = costmap_from_grid(room(), CostmapConfig())
    grid_line = densify(np.array([[0.3, 0.2], [2.7, 0.2]]), 0.05)
    band = relax(costmap.clearance, 0.05, 0.15, grid_line, Band(0.5, 3.0, 0.5, 0.1, 200))
    np.testing.assert_allclose(band[[0, -1]], grid_line[[0, -1]])
    assert band[len(band) // 2, 1] > 0.4


def test_densify_keeps_corners_and_spacing():
    corners = np.array([[0.0, 0.0], [1.0, 0.0], [1.0, 0.33]])
    dense = densify(corners, 0.1)
    assert np.linalg.norm(np.diff(dense, axis=0), axis=1).max() <= 0.1 + 1e-12
    assert path_length(dense) == pytest.approx(path_length(corners))
    assert any(np.allclose(point, [1.0, 0.0]) for point in dense)


@pytest.mark.parametrize("planner", ["PRM", "PRMstar"])
def test_a_roadmap_that_does_not_join_start_and_goal_is_not_taken_for_a_path(planner):
    costmap = costmap_from_grid(walled_room(), CostmapConfig())
    config = OmplConfig(planner=planner, iterations=2)
    ends = START.xy, GOAL.xy
    everywhere = costmap.clearance > 0.15
    floor = DiscFloor(costmap.clearance, 0.05, 0.15, everywhere)
    assert solve(floor, *ends, 1.0, config, seed=1) is None
    plan = plan_path(costmap, BURGER, START, GOAL, PlanConfig(ompl=config), seed=1)
    assert plan.planner == "grid"


def test_a_roadmap_is_the_same_again():
    costmap = costmap_from_grid(walled_room(), CostmapConfig())
    config = PlanConfig(ompl=OmplConfig(planner="PRMstar", iterations=1000))
    first, again = (plan_path(costmap, BURGER, START, GOAL, config, seed=5) for _ in range(2))
    assert np.array_equal(first.poses.xyt, again.poses.xyt)


def test_clearance_costs_no_more_length_than_allowed():
    costmap = costmap_from_grid(walled_room(), CostmapConfig())
    shortest = plan_path(costmap, BURGER, START, GOAL, PlanConfig(stretch=1.0), seed=3)
    ways = [plan_path(costmap, BURGER, START, GOAL, PlanConfig(stretch=s), seed=3) for s in (1.05, 1.5)]
    assert shortest.length <= ways[0].length <= 1.06 * shortest.length < ways[1].length
    room = [costmap.clearance_at(densify(w.poses.xy.copy(), 0.01)).min() for w in (shortest, *ways)]
    assert BURGER.circumscribed_radius < room[0] < room[1] < room[2]


@pytest.mark.parametrize("space", ["disc", "se2", "dubins"])
def test_the_spaces_of_earlier_versions_are_left_out_with_a_note(caplog, space):
    old = {"ompl": {"space": space, "turning_radius": 0.3, "iterations": 7}}
    assert checked(PlanConfig, old, where="c.yaml") == PlanConfig(ompl=OmplConfig(iterations=7))
    assert sorted(caplog.messages) == [
        "note: c.yaml: ompl.space: left out: paths are for the disc around the footprint, or for the "
        "footprint where that does not fit",
        "note: c.yaml: ompl.turning_radius: left out: robots here turn on the spot",
    ]


@pytest.mark.parametrize("planner", ["SORRTstar", "InformedRRTstar", "AORRTC", "BITstar", "RRTstar"])
def test_planners_that_improve_are_content_with_the_straight_line(planner):
    """SORRTstar looked for ever for something shorter."""
    costmap = costmap_from_grid(walled_room(), CostmapConfig())
    config = PlanConfig(ompl=OmplConfig(planner=planner, iterations=300))
    start, goal = SE2.from_xyt(1.025, 1.025, 0.0), SE2.from_xyt(1.025, 2.225, 0.0)
    plan = plan_path(costmap, BURGER, start, goal, config, seed=1)
    assert plan.length == pytest.approx(1.2, rel=0.01)


@pytest.mark.parametrize("planner", ["RRTConnect", "InformedRRTstar", "SORRTstar", "PRM"])
def test_a_robot_that_stands_at_its_goal_has_a_plan(planner):
    costmap = costmap_from_grid(room(), CostmapConfig())
    here = SE2.from_xyt(1.0, 1.0, 0.3)
    config = PlanConfig(ompl=OmplConfig(planner=planner))
    plan = plan_path(costmap, BURGER, here, here, config, seed=1)
    assert plan.length < 0.1  # to the middle of its cell and back, at most
    np.testing.assert_allclose(plan.poses.xyt[[0, -1]], [here.xyt, here.xyt], atol=1e-9)


def test_a_path_begins_where_the_robot_stands_though_the_goal_is_in_sight():
    """AORRTC's path was the goal alone then."""
    costmap = costmap_from_grid(walled_room(), CostmapConfig())
    start, goal = SE2.from_xyt(1.025, 1.025, 0.0), SE2.from_xyt(1.625, 1.025, 0.0)
    config = PlanConfig(ompl=OmplConfig(planner="AORRTC", iterations=300))
    plan = plan_path(costmap, BURGER, start, goal, config, seed=1)
    np.testing.assert_allclose(plan.poses.xyt[[0, -1]], [start.xyt, goal.xyt], atol=1e-6)
    assert plan.length == pytest.approx(0.6, rel=0.02)
    assert plan.planner.startswith("AORRTC")


class Line:
    """Stands for OMPL on a line: states are numbers, and nothing may cross 5."""

    def __init__(self, *states: float) -> None:
        self.states = list(states)

    def getSolutionPath(self):
        return self

    def getStates(self):
        return self.states

    def prepend(self, state):
        self.states.insert(0, state)

    @staticmethod
    def distance(a, b):
        return abs(a - b)

    @staticmethod
    def checkMotion(a, b):
        return a <= b < 5.0 or 5.0 < a <= b  # it cannot drive backwards


@pytest.mark.parametrize(
    ("states", "whole"),
    [((1.0, 2.0, 3.0), [1.0, 2.0, 3.0]), ((2.0, 3.0), [1.0, 2.0, 3.0]), ((6.0, 7.0), None)],
)
def test_a_solution_without_its_start_gets_it_where_it_can_be_joined(states, whole):
    path = solution_from(1.0, Line, Line(*states))
    assert (None if path is None else path.states) == whole


def test_a_comparison_asks_each_planner_once(tmp_path):
    """The one that is chosen, too: its time is that of the path which is written."""
    save_map(room(), tmp_path)
    out, settings = Output(tmp_path / "out"), {"plan.ompl.iterations": 50}
    asked_for = {"map": tmp_path / "map.yaml", "start": (1.0, 1.0, 0.0), "goal": (1.2, 1.0, 0.0), "seed": 0}
    assert plan(PlanRequest(**asked_for, compare=True, settings=settings), out) == 0
    asked = [found["planner"] for found in json.loads((out.folder / "metrics.json").read_text())["planners"]]
    assert len(asked) == len(set(asked)) > 10
    told = json.loads((out.folder / "manifest.json").read_text())
    assert set(told["planners_s"]) == set(asked)
    assert told["planners_s"]["BITstar"] == told["planning_s"]
