import math

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from tests.helpers.planning_room import BURGER, room
from turtlebag.datasets.grid import FREE, OCCUPIED, UNKNOWN, OccupancyGrid
from turtlebag.datasets.se2 import SE2
from turtlebag.planners.costmap import (
    Costmap,
    CostmapConfig,
    costmap_from_grid,
    polygon_mask,
    ways_from,
)
from turtlebag.planners.footprint import disc_segment_free, field_at, footprint_clearance, sample_footprint


def test_clearance_equals_the_brute_force_distance():
    rng = np.random.default_rng(5)
    grid = room()
    grid.cells[rng.integers(0, 40, 12), rng.integers(0, 60, 12)] = OCCUPIED
    costmap = costmap_from_grid(grid, CostmapConfig())
    lethal = np.argwhere(costmap.lethal)
    rows, cols = np.mgrid[0:40, 0:60]
    brute = np.hypot(rows[..., None] - lethal[:, 0], cols[..., None] - lethal[:, 1]).min(axis=-1)
    # Everything outside is lethal too; the walls make that the same here.
    np.testing.assert_allclose(costmap.clearance, brute * 0.05, atol=1e-6)


def test_gaps_between_beams_are_free_and_the_inside_of_a_pillar_is_not():
    grid = room()
    grid.cells[10, 10] = UNKNOWN
    grid.cells[20:25, 30:35] = OCCUPIED
    grid.cells[21:24, 31:34] = UNKNOWN
    grid.cells[5:15, 40:50] = UNKNOWN
    lethal = costmap_from_grid(grid, CostmapConfig()).lethal
    assert not lethal[10, 10]
    assert lethal[22, 32]
    assert lethal[10, 45]
    assert not costmap_from_grid(grid, CostmapConfig(unknown="free")).lethal[10, 45]


@pytest.mark.parametrize("resolution", [0.02, 0.05, 0.1])
def test_specks_are_told_by_their_area_in_square_metres(resolution):
    cells = round(0.06 / resolution**2)
    for size, blocked in ((cells - 1, False), (cells + 1, True)):
        grid = room(rows=40, cols=200, resolution=resolution)
        grid.cells[10, 10 : 10 + size] = UNKNOWN
        assert costmap_from_grid(grid, CostmapConfig()).lethal[10, 10] == blocked


def test_keepout_polygons_are_lethal_in_a_turned_map_too():
    cells = np.full((100, 100), FREE, dtype=np.int8)
    T_map_grid = SE2.from_xyt(1.0, -2.0, 0.4)
    costmap = costmap_from_grid(OccupancyGrid(cells, 0.05, T_map_grid), CostmapConfig())
    square = T_map_grid @ np.array([[1.0, 1.0], [2.0, 1.0], [2.0, 3.0], [1.0, 3.0]])
    mask = polygon_mask(costmap, square)
    assert mask.sum() == 20 * 40
    assert mask[20:60, 20:40].all()
    assert costmap.with_lethal(mask).clearance_at(T_map_grid @ np.array([1.5, 2.0])) == 0.0


@pytest.mark.parametrize("resolution", [0.02, 0.05, 0.2])
def test_a_mask_of_any_resolution_is_lethal_where_it_is_occupied(resolution):
    cells = np.full((100, 100), FREE, dtype=np.int8)
    T_map_grid = SE2.from_xyt(1.0, -2.0, 0.4)
    grid = OccupancyGrid(cells, 0.05, T_map_grid)
    values = np.full((round(8.0 / resolution),) * 2, UNKNOWN, dtype=np.int8)
    mask = OccupancyGrid(values, resolution, SE2.from_xyt(-1.0, -3.0, -0.3))
    points = mask.center_of(np.stack(np.mgrid[0 : values.shape[0], 0 : values.shape[1]], axis=-1))
    values[(np.abs(points - [2.5, 1.0]) < [0.6, 0.8]).all(axis=-1)] = OCCUPIED
    values[0, 0] = 99  # graded, as in a mask of mode scale: no area
    costmap = costmap_from_grid(grid, CostmapConfig(), [mask])
    centres = grid.center_of(np.stack(np.mgrid[0:100, 0:100], axis=-1))
    inner = (np.abs(centres - [2.5, 1.0]) < np.array([0.6, 0.8]) - resolution).all(axis=-1)
    outer = (np.abs(centres - [2.5, 1.0]) < np.array([0.6, 0.8]) + resolution + 0.05).all(axis=-1)
    assert inner.sum() > 100
    assert costmap.lethal[inner].all()
    assert not costmap.lethal[~outer].any()
    np.testing.assert_array_equal(costmap.keepout, costmap.lethal)


def test_a_single_fine_cell_of_a_mask_is_not_lost():
    grid = OccupancyGrid(np.full((20, 20), FREE, dtype=np.int8), 0.1)
    values = np.full((200, 200), FREE, dtype=np.int8)
    values[101, 73] = OCCUPIED
    costmap = costmap_from_grid(grid, CostmapConfig(), [OccupancyGrid(values, 0.01)])
    assert np.argwhere(costmap.lethal).tolist() == [[10, 7]]


def free_map(size):
    cells = np.full((size, size), FREE, dtype=np.int8)
    return costmap_from_grid(OccupancyGrid(cells, 0.05, SE2.identity()), CostmapConfig())


AREA = np.array([[0.0, -0.5], [2.0, -0.5], [2.0, 1.5], [0.0, 1.5]])
"""A keep-out area: all of the room to the right of x = 0, with a wall in it."""


def kept_out_room():
    grid = room()
    grid.cells[14:, 24] = OCCUPIED  # at x = 0.2 m, from y = 0.2 m upwards
    return costmap_from_grid(grid, CostmapConfig(), [AREA])


def test_a_robot_in_a_keepout_may_leave_it_the_shortest_way_that_walls_allow():
    costmap, inside = kept_out_room(), SE2.from_xyt(0.6, 0.3, 0.0)
    opened = costmap.with_way_out(inside, 0.15)
    new = costmap.lethal & ~opened.lethal
    assert np.all(costmap.keepout[new])
    assert np.array_equal(opened.keepout, costmap.keepout & ~new)
    ways = ways_from(costmap, inside, 0.15)
    # Out of the area the nearest place is 0.75 m away; the way there leads round the wall's end.
    least = ways[costmap.clearance > 0.15].min()
    assert 0.75 < least < 1.1
    rows, cols = np.nonzero(new)
    x, y = (costmap.T_map_grid @ (np.column_stack([cols + 0.5, rows + 0.5]) * 0.05)).T
    assert x.min() < 0.05
    assert y.min() < 0.05
    assert y.max() < 0.3 + 2.0 * 0.15 + 0.05
    assert x.max() < 0.6 + 2.0 * 0.15 + 0.05
    # Whoever is outside gets no way in.
    outside = SE2.from_xyt(-0.6, 0.3, 0.0)
    assert costmap.with_way_out(outside, 0.15) is costmap
    assert not np.isfinite(ways_from(costmap, outside, 0.15)[costmap.keepout]).any()


def test_a_cell_that_is_seen_occupied_in_a_keepout_stays_closed():
    costmap = kept_out_room()
    seen = np.zeros_like(costmap.lethal)
    seen[12, 28:36] = True
    opened = costmap.with_lethal(seen).with_way_out(SE2.from_xyt(0.6, 0.3, 0.0), 0.15)
    assert opened.lethal[seen].all()


@settings(max_examples=60, deadline=None)
@given(
    st.floats(0.3, 1.7),
    st.floats(0.3, 1.7),
    st.floats(0.01, 0.98),
    st.floats(0.0, math.pi),
    st.floats(0.1, 1.5),
)
def test_a_keepout_narrower_than_a_cell_blocks_every_cell_it_reaches_into(x, y, cells_wide, turn, length):
    costmap = free_map(80)
    width = cells_wide * costmap.resolution
    T_map_strip = SE2.from_xyt(x, y, turn)
    strip = T_map_strip @ (np.array([[-0.5, -0.5], [0.5, -0.5], [0.5, 0.5], [-0.5, 0.5]]) * [length, width])
    mask = polygon_mask(costmap, strip)
    across, along = np.meshgrid(np.linspace(-0.499, 0.499, 7), np.linspace(-0.499, 0.499, 301))
    points = T_map_strip @ np.stack([along.ravel() * length, across.ravel() * width], axis=1)
    cells = np.floor(points / costmap.resolution).astype(int)
    cells = cells[np.all((cells >= 0) & (cells < 80), axis=1)]
    assert mask[cells[:, 1], cells[:, 0]].all()


@pytest.mark.slow
@settings(max_examples=60, deadline=None)
@given(st.lists(st.tuples(st.floats(-0.5, 2.5), st.floats(-0.5, 2.5)), min_size=3, max_size=3))
def test_no_point_of_a_keepout_is_farther_than_a_cell_from_what_it_blocks(corners):
    costmap = free_map(40)
    mask = polygon_mask(costmap, np.array(corners))
    weights = np.random.default_rng(0).dirichlet([0.5, 0.5, 0.5], 2000)
    cells = np.floor(weights @ np.array(corners) / costmap.resolution).astype(int)
    cells = cells[np.all((cells >= 1) & (cells < 39), axis=1)]
    beside = [mask[cells[:, 1] + dy, cells[:, 0] + dx] for dy in (-1, 0, 1) for dx in (-1, 0, 1)]
    assert np.any(beside, axis=0).all()


@pytest.mark.parametrize("x", [1.0, 1.02])
def test_a_keepout_without_any_width_stops_the_robot_too(x):
    mask = polygon_mask(free_map(40), np.array([[x, 0.5], [x, 1.5], [x, 1.0]]))
    assert mask[10:30, 20].all()


def test_a_neck_between_two_keepout_fields_is_closed_and_the_fields_stay_as_they_are():
    costmap = free_map(60)
    left, right = (0.31, 1.02, 0.62, 1.33), (1.71, 1.02, 2.02, 1.33)
    neck = [(left[2], 1.171), (right[0], 1.171), (right[0], 1.174), (left[2], 1.174)]
    corners = [left[:2], (left[2], left[1]), *neck[:2], right[:2], (right[2], right[1]), right[2:]]
    corners += [(right[0], right[3]), *neck[2:], left[2:], (left[0], left[3])]
    mask = polygon_mask(costmap, np.array(corners))
    assert mask[23, 6:40].all()
    assert mask[:22].sum() == mask[25:].sum() == 2 * 6 * 2


def test_the_field_is_bilinear_between_cell_centres_and_zero_outside():
    field = np.arange(12, dtype=np.float32).reshape(3, 4)
    assert field_at(field, 0.1, 0.15, 0.05) == pytest.approx(1.0)
    assert field_at(field, 0.1, 0.20, 0.10) == pytest.approx((1 + 2 + 5 + 6) / 4)
    assert field_at(field, 0.1, -0.01, 0.1) == 0.0
    assert field_at(field, 0.1, 0.41, 0.1) == 0.0


def test_footprint_clearance_is_that_of_the_polygon():
    lethal = np.zeros((200, 200), dtype=bool)
    lethal[:, 150:] = True
    costmap = Costmap(lethal, 0.01, SE2.identity())
    samples = sample_footprint(BURGER, 0.01)
    args = (costmap.clearance, 0.01, samples)
    # The wall's first cell centre is at x = 1.505; the nose is 0.041 ahead, the tail 0.105 behind.
    assert footprint_clearance(*args, 1.4, 1.0, 0.0) == pytest.approx(1.505 - 1.441, abs=0.011)
    assert footprint_clearance(*args, 1.3, 1.0, math.pi) == pytest.approx(1.505 - 1.405, abs=0.011)
    assert footprint_clearance(*args, 1.48, 1.0, 0.0) <= 0.0


def test_a_thin_post_inside_the_footprint_is_seen():
    lethal = np.zeros((200, 200), dtype=bool)
    lethal[100, 95] = True
    costmap = Costmap(lethal, 0.01, SE2.identity())
    samples = sample_footprint(BURGER, 0.01)
    clearance = footprint_clearance(costmap.clearance, 0.01, samples, 1.0, 1.0, 0.0)
    assert clearance < 0.02


def test_a_disc_segment_is_free_exactly_when_every_point_of_it_is():
    rng = np.random.default_rng(2)
    lethal = rng.random((60, 60)) < 0.01
    costmap = Costmap(lethal, 0.05, SE2.identity())
    disagreements = 0
    for _ in range(300):
        x0, y0, x1, y1 = rng.uniform(0.2, 2.8, 4)
        fine = [
            field_at(costmap.clearance, 0.05, x0 + f * (x1 - x0), y0 + f * (y1 - y0))
            for f in np.linspace(0.0, 1.0, 400)
        ]
        free = disc_segment_free(costmap.clearance, 0.05, 0.12, x0, y0, x1, y1)
        if free:
            # A step may pass a place that is short of the radius by less than the step's own sag.
            assert min(fine) > 0.12 - 0.0135
        disagreements += free != (min(fine) > 0.12)
    assert disagreements <= 9
