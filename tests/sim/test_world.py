"""World files and the true map."""

import json
import time
from pathlib import Path

import numpy as np
import pytest
import scipy

from turtlebag.datasets.errors import InputError
from turtlebag.datasets.grid import FREE, OCCUPIED, UNKNOWN
from turtlebag.sim.rasterize import true_map
from turtlebag.sim.shapes import as_rectangle, ball, box, contains, cylinder, mesh, prism
from turtlebag.sim.worlds import load_world

FACTS = Path(__file__).parents[3] / "shared" / "facts"


@pytest.fixture(scope="module")
def arena():
    return load_world("turtlebot3_world")


def test_points_lie_inside_where_one_of_the_solids_has_them_inside():
    corners = np.array([[3, -1, 1], [1, -3, 1], [1, -1, -1], [3, -3, -1]], dtype=float)
    solids = [
        box("box", (-2.0, 2.0), (1.5, 0.4), 0.7, (0.0, 1.0)),
        prism("prism", [(0.0, 0.0), (1.0, 0.2), (0.3, 1.1)], (0.0, 1.0)),
        cylinder("cylinder", (2.0, 2.0), 0.8, (0.0, 1.0)),
        ball("ball", (-2.0, -2.0, 0.3), 0.9),
        mesh("mesh", corners[[[0, 1, 2], [0, 3, 1], [0, 2, 3], [1, 3, 2]]]),
    ]
    points = np.vstack([np.random.default_rng(1).uniform(-3.5, 3.5, (5000, 2)), solids[1].polygon])
    of_each = [solid.inside(0.2, points) for solid in solids]
    assert all(30 < inside.sum() < 500 for inside in of_each)
    np.testing.assert_array_equal(contains(solids, 0.2, points), np.any(of_each, axis=0))


def test_arena_has_the_published_geometry(arena):
    path = FACTS / "world.json"
    if not path.is_file():
        pytest.skip("the shared facts are not beside this checkout")
    facts = json.loads(path.read_text())
    published = facts["arena"]["walls_as_prisms"] + facts["pillars"] + facts["decorations"]
    assert len(published) == len(arena.shapes) == 20
    for fact, solid in zip(published, arena.shapes, strict=True):
        assert (fact["name"], fact["z_min"], fact["z_max"]) == (solid.name, solid.z_min, solid.z_max)
        if solid.is_cylinder:
            assert (*fact["center"], fact["radius"]) == (*solid.center, solid.radius)
        else:
            assert {tuple(p) for p in fact["polygon"]} == {tuple(p) for p in solid.polygon.tolist()}


def test_true_map_of_the_arena_has_its_area_and_surfaces(arena):
    grid = arena.rasterize(0.182)
    cell = grid.resolution**2
    # 20.57 m^2 of free floor, less the cells that the outline and the pillars' rims pass through.
    free, occupied = np.sum(grid.cells == FREE) * cell, np.sum(grid.cells == OCCUPIED) * cell
    assert free < 20.57 < free + occupied
    assert grid.value_at(np.array([-1.1 + 0.149, 0.0])) == OCCUPIED
    assert grid.value_at(np.array([-1.1, 0.0])) == UNKNOWN  # inside a pillar
    assert grid.value_at(np.array([0.0, 2.541])) == OCCUPIED  # inner face of the wall
    assert grid.value_at(np.array([0.0, 2.7])) == UNKNOWN  # inside the wall
    assert grid.value_at(np.array([0.0, 3.2])) == UNKNOWN  # outside
    assert grid.value_at(np.array([-2.0, -0.5])) == FREE


def test_every_surface_cell_of_the_true_map_touches_free_floor(arena):
    cells = np.pad(arena.rasterize(0.182).cells, 1, constant_values=UNKNOWN)
    rows, cols = np.nonzero(cells == OCCUPIED)
    around = [cells[rows + i, cols + j] == FREE for i in (-1, 0, 1) for j in (-1, 0, 1)]
    assert np.all(np.any(around, axis=0))
    rows, cols = np.nonzero(cells == FREE)
    for i, j in ((0, 1), (1, 0), (0, -1), (-1, 0)):
        assert not np.any(cells[rows + i, cols + j] == UNKNOWN)


def test_a_world_without_solids_is_free_floor():
    assert np.all(load_world("empty").rasterize(0.18).cells == FREE)


def write_world(tmp_path, shapes):
    path = tmp_path / "mine.yaml"
    path.write_text(f"name: mine\nspawn: [0, 0, 0]\nshapes: {shapes}\n")
    return str(path)


def test_own_world_file_is_read(tmp_path):
    shapes = "[{kind: box, name: b, center: [2, 0], size: [1, 2], yaw: 0.5, z: [0, 1]}]"
    world = load_world(write_world(tmp_path, shapes))
    assert as_rectangle(world.shapes[0].polygon) == pytest.approx((2.0, 0.0, 1.0, 2.0, 0.5))


def test_outlines_are_counter_clockwise_whatever_was_given():
    square = np.array([[0.0, 0.0], [0.0, 1.0], [1.0, 1.0], [1.0, 0.0]])
    for outline in (square, square[::-1]):
        p = prism("p", outline, (0.0, 1.0)).polygon
        assert np.sum(p[:, 0] * np.roll(p[:, 1], -1) - p[:, 1] * np.roll(p[:, 0], -1)) == pytest.approx(2.0)
    assert as_rectangle(box("b", (0.0, 0.0), (2.0, 1.0), 0.3, (0.0, 1.0)).polygon) is not None


def test_house_has_the_published_walls_and_furniture():
    path = FACTS / "house.json"
    if not path.is_file():
        pytest.skip("the shared facts are not beside this checkout")
    facts = json.loads(path.read_text())
    published = facts["walls"] + [part for item in facts["furniture"] for part in item["parts"]]
    solids = {solid.name: solid for solid in load_world("turtlebot3_house").shapes}
    assert set(solids) == {fact["name"] for fact in published} | {"gate"}
    for fact in published:
        solid = solids[fact["name"]]
        assert (solid.z_min, solid.z_max) == (fact["z_min"], fact["z_max"])
        np.testing.assert_allclose(solid.center, fact["center"][:2])
        if fact["kind"] == "box":
            rectangle = as_rectangle(solid.polygon)
            assert rectangle[2:4] == pytest.approx(fact["size"][:2])
            assert np.sin(rectangle[4] - fact["yaw"]) == pytest.approx(0.0, abs=1e-9)


@pytest.mark.slow
def test_house_has_six_connected_rooms_and_no_way_out_with_the_gate_shut():
    rooms = [(-6.3, 3.2), (-6.3, -2.5), (-3, 1), (1, 3.5), (4, 1), (5.5, -4.5)]
    outside = np.array([0.0, -2.5])
    shut, open_ = load_world("turtlebot3_house"), load_world("turtlebot3_house:gate=open")
    grid = shut.rasterize(0.132)
    assert all(grid.value_at(np.array(room)) == FREE for room in rooms)
    assert grid.value_at(outside) == UNKNOWN
    assert open_.rasterize(0.132).value_at(outside) == FREE
    # A floor board is under the plane of either lidar; the keep-out list names it.
    assert grid.value_at(np.array([6.2, -3.0])) == FREE
    assert any(
        np.all(outline.min(0) < (6.2, -3.0)) and np.all(outline.max(0) > (6.2, -3.0))
        for outline in shut.keepout
    )


def test_a_world_of_thousands_of_solids_is_mapped_in_seconds():
    """Each solid once had every other one asked for its bounds, and every cell of the map: minutes."""
    side = np.arange(-35.0, 35.5, 1.0)
    boxes = [box("", (x, y), (0.2, 0.3), x, (0.0, 1.0)) for x in side for y in side if x or y]
    begun = time.process_time()
    grid = true_map(boxes, 0.2, (-36.0, 36.0, -36.0, 36.0), np.zeros(2), 0.05)
    assert time.process_time() - begun < 20.0
    assert scipy.ndimage.label(grid.cells == OCCUPIED, structure=np.ones((3, 3)))[1] == len(boxes) == 5040


def test_worlds_of_too_many_things_are_refused(tmp_path):
    path = tmp_path / "a.yaml"
    ball = "kind: cylinder, center: [3, 0], radius: 0.1, z: [0, 1]"
    many = {
        "shapes": (f"- {{{ball}}}\n", 20_001, "20000"),
        "movers": ("- {radius: 0.1, path: [[1, 1]], speed: 1}\n", 101, "100"),
        "keepout": ("- [[0, 0], [1, 0], [0, 1]]\n", 1001, "1000"),
    }
    for key, (entry, count, most) in many.items():
        rest = "" if key == "shapes" else f"shapes: [{{{ball}}}]\n"
        path.write_text(f"name: a\nspawn: [0, 0, 0]\n{rest}{key}:\n{entry * count}")
        with pytest.raises(InputError, match=rf"a.yaml: {key}: must have at most {most} items, not {count}$"):
            load_world(str(path))
    corners = ", ".join(f"[{np.cos(a):.6f}, {np.sin(a):.6f}]" for a in np.linspace(0, 6.28, 1001))
    disc = f"kind: prism, z: [0, 1], polygon: [{corners}]"
    path.write_text(f"name: a\nspawn: [3, 0, 0]\nshapes: [{{{disc}}}]\n")
    with pytest.raises(InputError, match="polygon: must have at most 1000 items"):
        load_world(str(path))
