import math

import numpy as np
import pytest
from planning_room import BURGER, room

from datasets.grid import FREE, OCCUPIED, UNKNOWN, OccupancyGrid
from datasets.se2 import SE2
from planners.costmap import Costmap, CostmapConfig, costmap_from_grid, polygon_mask
from planners.footprint import disc_segment_free, field_at, footprint_clearance, sample_footprint


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


def test_keepout_polygons_are_lethal_in_a_turned_map_too():
    cells = np.full((100, 100), FREE, dtype=np.int8)
    T_map_grid = SE2.from_xyt(1.0, -2.0, 0.4)
    costmap = costmap_from_grid(OccupancyGrid(cells, 0.05, T_map_grid), CostmapConfig())
    square = T_map_grid @ np.array([[1.0, 1.0], [2.0, 1.0], [2.0, 3.0], [1.0, 3.0]])
    mask = polygon_mask(costmap, square)
    assert mask.sum() == 20 * 40
    assert mask[20:60, 20:40].all()
    assert costmap.with_lethal(mask).clearance_at(T_map_grid @ np.array([1.5, 2.0])) == 0.0


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
    args = (costmap.clearance, 0.01, samples.points, samples.inscribed, samples.circumscribed)
    # The wall's first cell centre is at x = 1.505; the nose is 0.041 ahead, the tail 0.105 behind.
    assert footprint_clearance(*args, 1.4, 1.0, 0.0) == pytest.approx(1.505 - 1.441, abs=0.011)
    assert footprint_clearance(*args, 1.3, 1.0, math.pi) == pytest.approx(1.505 - 1.405, abs=0.011)
    assert footprint_clearance(*args, 1.48, 1.0, 0.0) <= 0.0


def test_a_thin_post_inside_the_footprint_is_seen():
    lethal = np.zeros((200, 200), dtype=bool)
    lethal[100, 95] = True
    costmap = Costmap(lethal, 0.01, SE2.identity())
    samples = sample_footprint(BURGER, 0.01)
    clearance = footprint_clearance(
        costmap.clearance, 0.01, samples.points, samples.inscribed, samples.circumscribed, 1.0, 1.0, 0.0
    )
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
