"""True maps keep the round solids that cells can only show as squares."""

import numpy as np
import pytest

from turtlebag.datasets.errors import InputError
from turtlebag.datasets.true_maps import load_true_map, save_true_map
from turtlebag.reports.figures.maps import round_cells
from turtlebag.sim.worlds import load_world


def test_the_pillars_of_the_arena_are_kept_and_their_cells_are_known(tmp_path):
    world = load_world("turtlebot3_world")
    save_true_map(world.rasterize(0.18), world.circles(0.18), tmp_path)
    true = load_true_map(tmp_path)
    assert len(true.circles) == 9
    np.testing.assert_allclose(true.circles[:, 2], 0.15)
    cells = round_cells(true)
    assert cells[tuple(true.cell_of([0.0, 0.14]))]
    assert not cells[tuple(true.cell_of([0.0, 0.26]))]
    # no wall is taken for a pillar: what is not round is still drawn as cells
    walls = true.center_of(np.argwhere((true.cells == 100) & ~cells))
    assert np.abs(walls).max(axis=1).min() > 1.4
    picture = round_cells(world.rasterize(0.18))
    assert not picture.any()


def test_a_true_map_of_an_earlier_version_has_no_circles(tmp_path):
    world = load_world("turtlebot3_world")
    save_true_map(world.rasterize(0.18), world.circles(0.18), tmp_path)
    (tmp_path / "circles.yaml").unlink()
    assert load_true_map(tmp_path).circles.shape == (0, 3)


@pytest.mark.parametrize(
    "text",
    [
        "circles: [[0, 0]]",
        "circles: [[0, 0, -1]]",
        "circles: [[0, .nan, 1]]",
        "circles: [[0, 1e300, 1]]",
        "[",
        "3",
    ],
)
def test_a_broken_file_of_circles_is_named(text, tmp_path):
    world = load_world("turtlebot3_world")
    save_true_map(world.rasterize(0.18), world.circles(0.18), tmp_path)
    (tmp_path / "circles.yaml").write_text(text)
    with pytest.raises(InputError, match=r"circles\.yaml"):
        load_true_map(tmp_path)


def test_circles_off_the_map_are_no_cells(tmp_path):
    grid = load_world("turtlebot3_world").rasterize(0.18)
    save_true_map(grid, np.array([[100.0, 0.0, 0.5], [-100.0, -100.0, 3.0]]), tmp_path)
    assert not round_cells(load_true_map(tmp_path)).any()
