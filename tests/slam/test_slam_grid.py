"""Walls of the grid: one cell thin where the noise allows it, and without holes."""

import numpy as np
import pytest

from tests.helpers.exact_rays import rectangle
from tests.helpers.slam_rooms import LDS, around_the_room, recording
from turtlebag.datasets.errors import InputError
from turtlebag.datasets.grid import FREE, MAX_CELLS, OCCUPIED, UNKNOWN
from turtlebag.datasets.se2 import SE2
from turtlebag.pipeline.slam.grid import OccupancyConfig, make_grid, trimmed
from turtlebag.pipeline.slam.thin_walls import BEHIND_CELLS, thin

U, F, X = UNKNOWN, FREE, OCCUPIED


def thinned_by_numpy(cells, hits, behind, before):
    """`thin` in array operations."""

    def neighbours(a, fill):
        p = np.pad(a, 1, constant_values=fill)
        return [p[2:, 1:-1], p[:-2, 1:-1], p[1:-1, 2:], p[1:-1, :-2]]

    wall, free = cells == X, cells == F
    faces = np.any(neighbours(free, False), axis=0)
    best = np.zeros(cells.shape)
    for k in range(4):
        face, strength, open_ = wall & faces, hits, free
        between = np.ones(cells.shape, dtype=bool)
        for _ in range(BEHIND_CELLS):
            face, strength = neighbours(face, False)[k], neighbours(strength, 0)[k]
            open_ = neighbours(open_, True)[k]
            between &= ~open_
            best = np.maximum(best, np.where(face & between, strength, 0))
    out = np.where(wall & ~faces & (hits < behind * best), U, cells)
    closes = np.any(neighbours(out == U, False), axis=0)
    closes[[0, -1]], closes[:, [0, -1]] = True, True
    solid, strong, opposite = neighbours(out == X, False), neighbours(hits, 0), (1, 0, 3, 2)
    short = [
        f & solid[k] & (hits < before * strong[k])
        for f, k in zip(neighbours(free, False), opposite, strict=True)
    ]
    return np.where((out == X) & ~closes & np.any(short, axis=0), F, out)


def test_a_map_that_could_not_be_read_again_is_not_made():
    """What is unknown does not count, a margin does."""
    cells = np.full((8030, 8100), U, dtype=np.int8)
    config = OccupancyConfig(resolution_m=0.02, margin_m=0.1)
    cells[10, 50:8040] = F  # 7990 columns, and five on either side
    cells[10:8000, 50] = F
    assert trimmed(cells, np.zeros(2), config).shape == (8000, 8000)
    cells[8000, 50] = F
    with pytest.raises(InputError, match=r"8001 x 8000 cells; choose a larger grid\.resolution_m") as caught:
        trimmed(cells, np.zeros(2), config)
    fits = float(str(caught.value).split()[-7])
    assert 0.8 * MAX_CELLS < (8001 * 0.02 / fits) * (8000 * 0.02 / fits) < MAX_CELLS


@pytest.mark.filterwarnings("error")
def test_poses_beyond_all_maps_are_told_in_one_line():
    poses = around_the_room(3)
    log = recording(rectangle(0.0, 0.0, 7.0, 6.0), poses)
    poses[1, :2] = 1e30, 1e200
    with pytest.raises(InputError, match="cells; choose a larger grid"):
        make_grid(log, SE2.from_array(poses), OccupancyConfig(), 30.0)


def test_thinning_does_as_numpy_does():
    rng = np.random.default_rng(4)
    for _ in range(20):
        hits = rng.integers(0, 40, (30, 40)).astype(np.uint16)
        cells = rng.choice([U, F, X], (30, 40), p=[0.1, 0.5, 0.4]).astype(np.int8)
        found = cells.copy()
        thin(found, hits, 0.5, 0.25)
        wanted = thinned_by_numpy(cells, hits.astype(float), 0.5, 0.25)
        np.testing.assert_array_equal(found, wanted)
        assert np.any(found != cells)


def test_overshoot_and_shortfall_go_and_equals_stay():
    cells = np.array([[F, F, X, X, U], [F, F, X, X, U], [F, F, X, X, X], [F, F, X, X, X]], dtype=np.int8)
    hits = np.array([[0, 0, 50, 6, 0], [0, 0, 30, 28, 0], [0, 0, 5, 60, 40], [0, 0, 5, 60, 40]], np.uint16)
    thin(cells, hits, 0.5, 0.25)
    assert cells.tolist() == [[F, F, X, U, U], [F, F, X, X, U], [F, F, F, X, X], [F, F, X, X, X]]


@pytest.mark.parametrize("shift", np.linspace(0.0, 0.045, 10))
def test_walls_are_thin_and_closed_wherever_they_lie_in_their_cells(shift):
    walls = rectangle(0, 0, 8, 6) + shift
    poses = around_the_room(60) + np.array([shift, shift, 0.0])
    log, T = recording(walls, poses, LDS), SE2.from_array(poses)
    thinner = make_grid(log, T, OccupancyConfig(), 30.0)
    thick = make_grid(log, T, OccupancyConfig(behind_share=0.0, before_share=0.0), 30.0)
    rows = [(grid.cells == X)[:, 30:-30].sum(axis=0) for grid in (thinner, thick)]
    assert rows[0].sum() <= rows[1].sum()
    # a surface within half a standard deviation of a cell border is hit on both sides of it
    on_a_border = min(shift, 0.05 - shift) < 0.006
    assert np.median(rows[0]) <= (4 if on_a_border else 2)
    # every column meets both walls, and no free cell lies open to the unknown that did not before
    assert rows[0].min() >= min(2, rows[1].min())
    assert open_cells(thinner) <= open_cells(thick)


def open_cells(grid):
    """Free cells right beside unknown ones."""
    free, unknown = grid.cells == F, grid.cells == U
    return sum(np.sum(a & b) for a, b in ((free[1:], unknown[:-1]), (free[:-1], unknown[1:])))
