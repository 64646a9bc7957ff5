"""The obstacle layer, the rolling window and frontiers beside plain loops over beams and cells."""

import math

import numpy as np
import pytest
from scipy import ndimage

from turtlebag.datasets.grid import FREE, OCCUPIED, UNKNOWN, OccupancyGrid
from turtlebag.datasets.se2 import SE2
from turtlebag.planners.costmap import SNAP_M, Costmap, clearance_field, nearest_free
from turtlebag.planners.grid_distance import grid_distance
from turtlebag.planners.obstacle_layer import (
    NEVER,
    REACH_M,
    GridBeams,
    Marking,
    ObstacleLayer,
    mark_and_clear,
)
from turtlebag.planners.rolling_costmap import (
    RIM_M,
    RollingLayer,
    free_floor,
    rim_cells,
    shifted,
)
from turtlebag.planners.tasks.frontier import SPENT_M, VIEW_M, frontiers, next_view

RES = 0.1


def standing(costmap, pose, radius):
    """The cell from which exploring begins."""
    here = costmap.T_grid_map @ pose.xy / costmap.resolution
    return nearest_free(costmap.clearance > radius, here, SNAP_M / costmap.resolution)


def plain_sweep(seen, hits, clearance, x, y, ends, is_hit, now, obstacle_range, known):
    """Clearing along all beams, half a cell at a time, and then marking."""
    rows, cols = seen.shape
    for (ex, ey), hit in zip(ends, is_hit, strict=True):
        length = math.dist((x, y), (ex, ey))
        if length < 1e-6:
            continue
        stop = length - 1.5 * RES if hit else length
        for t in np.arange(0, max(0, math.ceil(stop / (0.5 * RES) - 1e-9))) * 0.5 * RES:
            col = math.floor((x + t * (ex - x) / length) / RES)
            row = math.floor((y + t * (ey - y) / length) / RES)
            if 0 <= row < rows and 0 <= col < cols and seen[row, col] < now:
                seen[row, col], hits[row, col] = NEVER, 0
    for (ex, ey), hit in zip(ends, is_hit, strict=True):
        row, col = math.floor(ey / RES), math.floor(ex / RES)
        inside = 0 <= row < rows and 0 <= col < cols
        if hit and math.dist((x, y), (ex, ey)) <= obstacle_range and inside and clearance[row, col] > known:
            if seen[row, col] < now:
                hits[row, col] = min(hits[row, col] + 1, 1000)
            seen[row, col] = now


@pytest.mark.parametrize("share", [0.5, 0.003])
@pytest.mark.parametrize("seed", range(4))
def test_sweeps_mark_and_clear_as_a_plain_loop_does(seed, share):
    """Where much is marked, and where beams pass whole stretches without a mark."""
    rng, shape = np.random.default_rng(seed), (52, 68)
    clearance = rng.uniform(0.0, 0.5, shape).astype(np.float32)
    hits = np.where(rng.random(shape) < share, rng.choice([1, 3, 1000], shape), 0).astype(np.int16)
    seen = np.where(hits > 0, rng.uniform(0.0, 2.0, shape), NEVER)
    expected = seen.copy(), hits.copy()
    for now in (1.0, 2.5, 3.1):
        x, y = rng.uniform(0.3, [6.2, 4.6])
        ends = np.vstack([rng.uniform(-2.0, [8.8, 7.2], (60, 2)), [[x, y]]])
        n_hits = int(rng.integers(40, 55))
        mark_and_clear(seen, hits, clearance, RES, GridBeams(x, y, ends, n_hits, 4.0, 0.14), now)
        plain_sweep(*expected, clearance, x, y, ends, np.arange(61) < n_hits, now, 4.0, 0.14)
        np.testing.assert_array_equal(seen, expected[0])
        np.testing.assert_array_equal(hits, expected[1])
    assert (seen == 3.1).any()


def empty(rows=40, cols=50, T=None):
    return Costmap(np.zeros((rows, cols), dtype=bool), RES, T or SE2.from_xyt(-1.0, 0.5, 0.3))


def test_a_layer_keeps_marks_for_their_time_and_counts_their_hits():
    config = Marking(hits=2, decay=5.0, wall_margin=0.0, obstacle_range=9.0)
    layer = ObstacleLayer(empty(), config)
    T = layer.static.T_map_grid
    origin, post = T @ SE2.from_xyt(1.05, 1.05, 1.0), T @ np.array([[2.55, 3.05]])
    for now, marked in ((0.0, 0), (1.0, 1), (5.9, 1)):
        layer.update(now, origin, post if now < 2.0 else post[:0], np.zeros((0, 2)))
        assert layer.marked == marked
        assert layer.costmap.lethal.sum() == marked
    assert np.argwhere(layer.costmap.lethal).tolist() == [[30, 25]]
    near = np.hypot(*(np.indices((40, 50)) - np.array([30, 25])[:, None, None])) * RES
    expected = np.minimum(layer.static.clearance, near)
    window = np.abs(np.indices((40, 50)) - np.array([30, 25])[:, None, None]).max(axis=0) <= round(
        REACH_M / RES
    )
    np.testing.assert_allclose(layer.costmap.clearance[window], expected[window], atol=1e-6)
    np.testing.assert_array_equal(layer.costmap.clearance[~window], layer.static.clearance[~window])
    layer.update(6.0, origin, post[:0], np.zeros((0, 2)))
    assert (layer.marked, layer.costmap is layer.static) == (0, True)
    # forgotten hits do not come back with the next one
    layer.update(6.5, origin, post, np.zeros((0, 2)))
    assert layer.marked == 0
    layer.update(6.6, origin, post, np.zeros((0, 2)))
    assert layer.marked == 1
    # what was passed is cleared at once; what was hit is not passed
    layer.update(7.0, origin, post[:0], T @ np.array([[3.05, 4.05]]))
    assert layer.marked == 1
    layer.update(7.1, origin, post[:0], origin.xy + 2.0 * (post - origin.xy))
    assert layer.marked == 0
    layer.update(7.2, origin, post, np.zeros((0, 2)))
    layer.update(7.3, origin, post, np.zeros((0, 2)))
    layer.clear()
    assert (layer.marked, layer.costmap is layer.static) == (0, True)
    layer.update(7.4, origin, post, np.zeros((0, 2)))
    assert layer.marked == 0
    goal = SE2.identity()
    assert layer.aim(goal, goal, 0.3) is goal
    assert not layer.stands_in(goal)


@pytest.mark.parametrize("marked", [[(0, 0)], [(39, 49)], [(0, 7), (12, 49)], [(20, 20), (22, 25)]])
def test_near_marked_cells_the_clearance_is_that_of_both(marked):
    layer = ObstacleLayer(empty(), Marking(hits=1, wall_margin=0.0, obstacle_range=99.0))
    mask = np.zeros((40, 50), dtype=bool)
    mask[tuple(np.transpose(marked))] = True
    exact = clearance_field(layer.static.lethal | mask, RES)
    away = ndimage.distance_transform_edt(~mask) * RES
    T_map_grid = layer.static.T_map_grid
    ends = T_map_grid @ ((np.array(marked)[:, ::-1] + 0.5) * RES)
    layer.update(0.0, T_map_grid @ SE2.from_xyt(2.45, 3.05, 0.0), ends, np.zeros((0, 2)))
    np.testing.assert_array_equal(layer.costmap.lethal, mask)
    found = layer.costmap.clearance
    np.testing.assert_allclose(found[away < REACH_M], exact[away < REACH_M], atol=1e-6)
    assert np.all(found <= layer.static.clearance)


@pytest.mark.parametrize(("rows", "cols"), [(0, 0), (2, -3), (-4, 1), (6, 0), (0, 7), (-9, 9), (5, 6)])
def test_shifted_values_keep_their_place_in_the_world(rows, cols):
    values = np.arange(49.0).reshape(7, 7)
    found = shifted(values, rows, cols, -1.0)
    for r, c in np.ndindex(7, 7):
        inside = 0 <= r + rows < 7 and 0 <= c + cols < 7
        assert found[r, c] == (values[r + rows, c + cols] if inside else -1.0)


@pytest.mark.parametrize(("cells", "inset"), [(9, 2), (6, 0), (5, 2), (7, 1)])
def test_the_rim_is_the_ring_of_cells_so_far_inside(cells, inset):
    depth = np.minimum(np.arange(cells), np.arange(cells)[::-1])
    expected = np.argwhere(np.minimum.outer(depth, depth) == inset)
    np.testing.assert_array_equal(rim_cells(cells, inset), expected)


def test_the_nearest_free_cell_is_that_of_the_least_gap_within_reach():
    free = np.random.default_rng(3).random((12, 17)) < 0.06
    cells = np.argwhere(free)
    for xy in np.random.default_rng(4).uniform(-2.0, [19.0, 14.0], (60, 2)):
        gap = np.hypot(cells[:, 1] + 0.5 - xy[0], cells[:, 0] + 0.5 - xy[1])
        col, row = np.floor(xy).astype(int)
        if 0 <= row < 12 and 0 <= col < 17 and free[row, col]:
            expected = row, col
        else:
            expected = tuple(cells[gap.argmin()]) if gap.min() <= 2.5 else None
        assert nearest_free(free, xy, 2.5) == expected
    assert nearest_free(np.zeros((3, 3), dtype=bool), np.ones(2), 9.0) is None
    assert nearest_free(np.eye(3, dtype=bool)[:1], np.array([2.5, 0.5]), 2.0) == (0, 0)


def window(side=4.0, shift=0.5, centre=(0.23, -0.31)):
    config = Marking(wall_margin=0.0, hits=1, decay=60.0, obstacle_range=9.0)
    return RollingLayer(np.array(centre), side, RES, shift, config)


def test_the_window_lies_on_whole_cells_about_its_centre_and_moves_when_it_must():
    layer = window()
    assert layer.static.lethal.shape == (40, 40)
    np.testing.assert_allclose(layer.static.T_map_grid.xyt, [0.2 - 2.0, -0.4 - 2.0, 0.0], atol=1e-9)
    layer.update(0.0, SE2.from_xyt(0.25, -0.35, 0.0), np.array([[1.05, 0.55]]), np.zeros((0, 2)))
    for x, y, moved in ((0.79, -0.35, 0), (0.81, -0.35, 6), (0.81, -0.05, 6), (0.81, 0.85, 6)):
        layer.update(0.1, SE2.from_xyt(x, y, 2.0), np.zeros((0, 2)), np.zeros((0, 2)))
        assert layer.static.T_map_grid.x == pytest.approx(-1.8 + moved * RES)
        assert layer.costmap.clearance_at(np.array([1.05, 0.55])) == 0.0
    assert layer.static.T_map_grid.y == pytest.approx(0.8 - 2.0)
    floor = free_floor(np.array([3.0, -4.0]), 7, 0.2)
    np.testing.assert_allclose(floor.T_map_grid.xyt, [0.6, -0.8, 0.0])
    assert (floor.lethal.shape, floor.lethal.any(), floor.resolution) == ((7, 7), False, 0.2)
    assert window(side=0.1).static.lethal.shape == (2, 2)


def test_a_goal_beyond_the_rim_is_made_for_by_the_shortest_way():
    layer, rng = window(side=5.0, centre=(0.0, 0.0)), np.random.default_rng(5)
    layer.update(0.0, SE2.identity(), rng.uniform(-2.3, 2.3, (25, 2)), np.zeros((0, 2)))
    res, radius, n = RES, 0.15, 50
    for goal in (SE2.from_xyt(9.0, 2.0, 1.0), SE2.from_xyt(-3.0, -8.0, 0.0), SE2.from_xyt(0.4, 5.0, 0.0)):
        assert layer.stands_in(goal)
        pose = SE2.from_xyt(*rng.uniform(-0.5, 0.5, 2), 0.0)
        free = layer.costmap.clearance > radius
        start = nearest_free(free, (layer.costmap.T_grid_map @ pose.xy) / res, SNAP_M / res)
        ways = grid_distance(free, *start, math.inf) * res
        best = (math.inf, None)
        inset = round(RIM_M / res)
        for r, c in np.ndindex(n, n):
            if min(r, c, n - 1 - r, n - 1 - c) != inset:
                continue
            place = layer.costmap.T_map_grid @ ((np.array([c, r]) + 0.5) * res)
            best = min(best, (ways[r, c] + math.dist(place, goal.xy), tuple(place)))
        aim = layer.aim(pose, goal, radius)
        np.testing.assert_allclose(aim.xy, best[1])
        assert float(aim.yaw) == pytest.approx(math.atan2(*(goal.xy - aim.xy)[::-1]))
    for x, y, beyond in ((1.69, 0.0, False), (1.71, 0.0, True), (0.0, -1.69, False), (0.0, -1.71, True)):
        assert layer.stands_in(SE2.from_xyt(x, y, 0.0)) == beyond
    near = SE2.from_xyt(1.0, 1.0, 0.0)
    assert layer.aim(SE2.identity(), near, radius) is near


def half_seen(seed):
    rng = np.random.default_rng(seed)
    cells = np.full((40, 50), UNKNOWN, dtype=np.int8)
    cells[5:35, 5:45] = FREE
    cells[5:35, [5, 44]] = cells[[5, 34], 5:45] = OCCUPIED
    for _ in range(3):
        r, c = rng.integers(8, 30, 2)
        cells[r, c] = OCCUPIED
    cells[34, rng.integers(8, 14) : rng.integers(18, 24)] = FREE
    cells[10:14, 44] = FREE
    cells[20:22, 5] = FREE
    return OccupancyGrid(cells, RES, SE2.from_xyt(1.0, -1.0, 0.5))


@pytest.mark.parametrize("seed", range(4))
def test_the_next_view_is_the_cheapest_less_what_its_frontier_is_worth(seed):
    grid = half_seen(seed)
    labels = frontiers(grid, 0.4)
    unknown = np.pad(grid.cells == UNKNOWN, 1)
    beside = np.any([unknown[a : a + 40, b : b + 50] for a in range(3) for b in range(3)], axis=0)
    regions, count = ndimage.label((grid.cells == FREE) & beside, np.ones((3, 3)))
    for k in range(1, count + 1):
        long_enough = np.sum(regions == k) * RES >= 0.4
        assert np.all((labels[regions == k] > 0) == long_enough)
    assert len(np.unique(labels)) > 2
    costmap = Costmap(grid.cells != FREE, RES, grid.T_map_grid)
    robot = grid.T_map_grid @ SE2.from_xyt(2.5, 2.0, 0.0)
    start = standing(costmap, robot, 0.15)
    ways = grid_distance(costmap.clearance > 0.15, *start, np.inf) * RES
    spots = np.argwhere(labels > 0)
    spent = [grid.center_of(np.array([30, 16]))]
    best = (math.inf, None)
    for r, c in np.argwhere(np.isfinite(ways)):
        place = grid.center_of(np.array([r, c]))
        gaps = np.hypot(*(spots - [r, c]).T) * RES
        if gaps.min() > VIEW_M or math.dist(place, spent[0]) <= SPENT_M:
            continue
        label = {labels[tuple(s)] for s in spots[gaps <= gaps.min() + 1e-9]}
        worth = {np.sum(labels == k) * RES for k in label}
        best = min(best, (ways[r, c] - max(worth), tuple(place)))
    view = next_view(grid, costmap, robot, 0.15, spent)
    found = tuple(grid.cell_of(view.xy).tolist())
    np.testing.assert_allclose(view.xy, best[1], atol=1e-9)
    gaps = np.hypot(*(spots - found).T)
    looked = [grid.center_of(s) - view.xy for s in spots[gaps <= gaps.min() + 1e-9]]
    assert any(
        abs(math.remainder(math.atan2(v[1], v[0]) - float(view.yaw), 2 * math.pi)) < 1e-6 for v in looked
    )


def test_the_robot_stands_in_the_nearest_cell_with_room_within_reach():
    lethal = np.zeros((20, 30), dtype=bool)
    lethal[:, 15:] = True
    costmap = Costmap(lethal, RES, SE2.from_xyt(1.0, 0.0, 0.0))
    assert standing(costmap, SE2.from_xyt(1.0 + 0.83, 0.98, 0.0), 0.3) == (9, 8)
    # the last column with 0.35 m to the wall's centres is the eleventh, its centre at 1.15
    assert standing(costmap, SE2.from_xyt(1.0 + 1.49, 0.95, 0.0), 0.35) == (9, 11)
    assert standing(costmap, SE2.from_xyt(1.0 + 1.51, 0.95, 0.0), 0.35) is None
    assert standing(costmap, SE2.from_xyt(2.0, 1.0, 0.0), 99.0) is None
