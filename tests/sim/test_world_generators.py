"""Generated worlds: the same for the same seed, never the same otherwise, and without dead corners."""

import numpy as np
import pytest
from scipy import ndimage

from turtlebag.datasets.grid import FREE
from turtlebag.sim.robots import load_robot
from turtlebag.sim.shapes import contains
from turtlebag.sim.worlds import load_world

BURGER = load_robot("burger")


def outlines(world):
    return [(s.name, s.center, s.radius, s.polygon.tolist()) for s in world.shapes]


@pytest.mark.parametrize("name", ["maze", "office", "forest"])
def test_the_seed_alone_decides(name):
    assert outlines(load_world(f"{name}:4")) == outlines(load_world(f"{name}:4"))
    assert outlines(load_world(f"{name}:4")) != outlines(load_world(f"{name}:5"))


@pytest.mark.slow
@pytest.mark.parametrize("seed", range(4))
@pytest.mark.parametrize("name", ["maze", "office", "forest"])
def test_a_burger_reaches_every_place_from_the_spawn(name, seed):
    world = load_world(f"{name}:{seed}")
    grid = world.rasterize(BURGER.lidar_height)
    occupied = grid.cells != FREE
    room = ndimage.distance_transform_edt(~occupied) * grid.resolution
    regions, n = ndimage.label(room > BURGER.model.circumscribed_radius + 0.05)
    start = tuple(grid.cell_of(world.spawn.xy))
    assert regions[start] > 0
    sizes = ndimage.sum_labels(np.ones_like(regions), regions, range(1, n + 1))
    assert sizes[regions[start] - 1] > 0.97 * sizes.sum()
    assert not contains(world.shapes, 0.18, world.spawn.xy[None])[0]


def test_a_maze_has_no_closed_cell():
    world = load_world("maze:3,cells=6,openings=0")
    free = world.rasterize(0.18).cells == FREE
    # Middles of all 36 cells belong to the space reachable from the spawn.
    grid = world.rasterize(0.18)
    middles = np.stack(np.meshgrid(np.arange(6) + 0.5, np.arange(6) + 0.5), axis=-1).reshape(-1, 2)
    assert np.all(grid.value_at(middles) == FREE)
    assert free.sum() * 0.0025 < 36.0


def test_density_is_a_parameter_of_the_forest():
    count = [len(load_world(f"forest:1,density={density}").shapes) - 4 for density in (0.0, 0.2, 0.4)]
    assert count == [0, round(0.2 * 144), round(0.4 * 144)]


def test_a_world_file_may_ask_for_a_generated_world(tmp_path):
    path = tmp_path / "mine.yaml"
    path.write_text("generator: forest\nseed: 3\noptions: {density: 0.1}\n")
    assert outlines(load_world(str(path))) == outlines(load_world("forest:3,density=0.1"))
