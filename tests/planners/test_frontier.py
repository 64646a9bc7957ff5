"""Frontiers: where they are, and which one is visited next."""

import numpy as np

from turtlebag.datasets.grid import FREE, OCCUPIED, UNKNOWN, OccupancyGrid
from turtlebag.datasets.se2 import SE2
from turtlebag.planners.costmap import CostmapConfig, costmap_from_grid
from turtlebag.planners.tasks.frontier import frontiers, next_view


def corridor(open_left: bool, open_right: bool) -> OccupancyGrid:
    """A corridor 6 m x 1.5 m along x, seen in the middle; its ends are walls where they are not open."""
    cells = np.full((50, 140), UNKNOWN, dtype=np.int8)
    cells[10:40, 10:130] = FREE
    cells[9, 9:131] = cells[40, 9:131] = OCCUPIED
    if not open_left:
        cells[9:41, 9] = OCCUPIED
    if not open_right:
        cells[9:41, 130] = OCCUPIED
    return OccupancyGrid(cells, 0.05)


def view(grid, x=3.5, spent=()):
    costmap = costmap_from_grid(grid, CostmapConfig())
    return next_view(grid, costmap, SE2.from_xyt(x, 1.25, 0.0), 0.2, spent)


def test_a_closed_corridor_has_no_frontier():
    assert not frontiers(corridor(False, False), 0.4).any()
    assert view(corridor(False, False)) is None


def test_the_open_end_is_looked_at_from_near_it():
    goal = view(corridor(False, True))
    assert goal is not None
    assert 5.6 < float(goal.x) < 6.4
    assert abs(float(goal.yaw)) < 1.0


def test_of_two_open_ends_the_nearer_comes_first_and_a_spent_one_not_again():
    grid = corridor(True, True)
    near = view(grid, x=2.5)
    assert near is not None
    assert float(near.x) < 1.4
    places = [np.array([x, y]) for x in (0.6, 0.9, 1.3) for y in (0.7, 1.25, 1.8)]
    far = view(grid, x=2.5, spent=places)
    assert far is not None
    assert float(far.x) > 5.0


def test_a_gap_between_beams_is_no_frontier():
    grid = corridor(False, False)
    grid.cells[20:23, 130] = UNKNOWN
    assert view(grid) is None


def test_a_robot_shut_in_finds_nothing():
    grid = corridor(True, True)
    grid.cells[10:40, 60] = grid.cells[10:40, 80] = OCCUPIED
    assert view(grid) is None
