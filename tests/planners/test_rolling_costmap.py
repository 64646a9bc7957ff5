"""The rolling costmap: what it keeps and forgets, its constant size, and goals beyond it."""

import math

import numpy as np
import pytest
from scipy import ndimage
from scipy.sparse import coo_matrix
from scipy.sparse.csgraph import dijkstra

from turtlebag.datasets.se2 import SE2
from turtlebag.planners.grid_distance import grid_distance
from turtlebag.planners.rolling_costmap import RollingLayer

NOTHING = np.zeros((0, 2))


def window(side: float = 8.0) -> RollingLayer:
    return RollingLayer(np.zeros(2), side, 0.05, 1.0)


def see(layer: RollingLayer, now_s: float, x: float, hits) -> None:
    layer.update(now_s, SE2.from_xyt(x, 0.0, 0.0), np.asarray(hits, dtype=float).reshape(-1, 2), NOTHING)


def test_an_obstacle_stays_where_it_is_while_the_window_moves():
    layer, post = window(), np.array([[2.02, 1.03]])
    for k in range(3):
        see(layer, 0.1 * k, 0.0, post)
    assert layer.costmap.clearance_at(post)[0] == 0.0
    for k in range(12):
        see(layer, 1.0 + 0.1 * k, 0.3 * k, [])
    assert layer.costmap.T_map_grid.x > -4.0 + 2.0
    assert layer.marked == 1
    assert layer.costmap.clearance_at(post)[0] == 0.0
    assert layer.costmap.clearance_at(np.array([2.32, 1.03])) == pytest.approx(0.3, abs=1e-6)


def test_the_window_stays_as_large_as_it_was_however_far_the_robot_drives():
    layer = window()
    rng = np.random.default_rng(3)
    for k in range(400):
        x = 0.5 * k
        points = np.array([x, 0.0]) + rng.uniform(-3.0, 3.0, (40, 2))
        see(layer, 0.1 * k, x, points)
        assert layer.costmap.lethal.shape == (160, 160)
        off = layer.costmap.T_grid_map @ np.array([x, 0.0]) - 4.0
        assert np.abs(off).max() < 1.1
    assert layer.costmap.clearance_at(np.array([0.0, 0.0])) == 0.0


def test_what_left_the_window_is_forgotten():
    layer, post = window(4.0), np.array([[-1.5, 0.0]])
    for k in range(3):
        see(layer, 0.1 * k, 0.0, post)
    assert layer.marked == 1
    see(layer, 1.0, 3.0, [])
    see(layer, 1.1, 0.0, [])
    assert layer.marked == 0


def test_a_goal_beyond_the_window_is_made_for_round_a_wall():
    layer = window()
    wall = np.stack([np.full(81, 2.02), np.arange(-3.0, 1.05, 0.05) + 0.02], axis=1)
    for k in range(3):
        see(layer, 0.1 * k, 0.0, wall)
    goal, pose = SE2.from_xyt(12.0, -1.0, 0.0), SE2.from_xyt(0.0, 0.0, 0.0)
    assert layer.stands_in(goal)
    aim = layer.aim(pose, goal, 0.3)
    assert float(aim.x) == pytest.approx(4.0 - 0.8, abs=0.1)
    assert float(aim.y) == pytest.approx(1.35, abs=0.1)  # the wall ends at 1.07 m
    assert float(aim.yaw) == pytest.approx(math.atan2(*(goal.xy - aim.xy)[::-1]))
    assert not layer.stands_in(aim)
    near = SE2.from_xyt(3.0, 0.0, 0.0)
    assert layer.aim(pose, near, 0.3) is near


def test_the_grid_distance_finds_dijkstras_lengths_up_to_its_limit():
    rng = np.random.default_rng(2)
    free = ndimage.gaussian_filter(rng.normal(size=(40, 50)), 1.0) > -0.15
    row, col = np.argwhere(free)[600]
    index = np.arange(free.size).reshape(free.shape)
    starts, ends, costs = [], [], []
    for dr, dc in ((0, 1), (1, 0), (1, 1), (1, -1)):
        a = index[: 40 - dr, max(-dc, 0) : 50 - max(dc, 0)]
        b = index[dr:, max(dc, 0) : 50 + min(dc, 0)]
        both = free.ravel()[a] & free.ravel()[b]
        starts.append(a[both])
        ends.append(b[both])
        costs.append(np.full(both.sum(), math.hypot(dr, dc)))
    graph = coo_matrix(
        (np.concatenate(costs), (np.concatenate(starts), np.concatenate(ends))), shape=(free.size, free.size)
    )
    expected = dijkstra(graph.tocsr(), directed=False, indices=index[row, col]).reshape(free.shape)
    np.testing.assert_allclose(grid_distance(free, row, col, np.inf), expected, rtol=1e-5)
    short = grid_distance(free, row, col, 12.5)
    reached = expected <= 12.5
    np.testing.assert_allclose(short[reached], expected[reached], rtol=1e-5)
    assert not np.isfinite(short[expected > 14.0]).any()
