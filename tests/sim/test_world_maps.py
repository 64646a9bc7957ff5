"""A map as a world: outlines, raster, start, contacts, and what cannot be one."""

from pathlib import Path

import numpy as np
import pytest
import scipy
from PIL import Image

from turtlebag.datasets.errors import InputError
from turtlebag.datasets.grid import FREE, OCCUPIED, UNKNOWN, OccupancyGrid
from turtlebag.datasets.maps import load_map, save_map
from turtlebag.datasets.se2 import SE2
from turtlebag.datasets.types import Twist
from turtlebag.sim.nearby import Nearby
from turtlebag.sim.outlines import filled, outlines
from turtlebag.sim.raycast import distance_to_outlines
from turtlebag.sim.robots import load_robot
from turtlebag.sim.shapes import Sections
from turtlebag.sim.simulator import SimConfig, Simulator
from turtlebag.sim.worlds import load_world, own_files

BARN = sorted((Path(__file__).parents[3] / "shared" / "data" / "barn").glob("*.world"))
TB3 = Path(__file__).parents[3] / "shared" / "facts" / "tb3_map" / "map.yaml"
EIGHT = np.ones((3, 3))
HEIGHT_M = 0.18


def room(side_m=4.0, resolution=0.05):
    """Cells of a room with walls of two cells, unknown outside, and a pillar."""
    n = round(side_m / resolution)
    cells = np.full((n + 10, n + 10), UNKNOWN, np.int8)
    cells[3:-3, 3:-3] = OCCUPIED
    cells[5:-5, 5:-5] = FREE
    cells[40:44, 60:64] = OCCUPIED
    return cells


def speckled(cells, rng, share=0.004):
    """The cells with wrong ones: single cells, cells that touch at corners, ragged walls, a slanted wall of
    one cell, and unknown cells on the floor."""
    cells = cells.copy()
    floor = cells == FREE
    for k in range(150):
        row, col = 8 + round(0.37 * k), 8 + k
        if row < len(cells) - 8 and col < len(cells) - 8:
            cells[row, col] = OCCUPIED
    cells[70:72, 70:72] = np.array([[OCCUPIED, FREE], [FREE, OCCUPIED]])
    ragged = scipy.ndimage.binary_dilation(cells == OCCUPIED, EIGHT) & floor & (rng.random(cells.shape) < 0.1)
    cells[ragged | (floor & (rng.random(cells.shape) < share))] = OCCUPIED
    cells[floor & (rng.random(cells.shape) < share)] = UNKNOWN
    return cells


def saved(folder, cells, resolution=0.05, origin=(-1.03, 2.01, 0.0)):
    folder.mkdir(exist_ok=True)
    return save_map(OccupancyGrid(cells, resolution, SE2.from_xyt(*origin)), folder)


def require_equal(path, options=""):
    """The true map of the world is the map: at least 99 % of each kind of cell, the others within a cell."""
    grid, true = load_map(path), load_world(f"{path}{options}").rasterize(HEIGHT_M)
    assert true.shape == grid.shape
    assert true.T_map_grid.xyt == pytest.approx(grid.T_map_grid.xyt, abs=1e-9)
    for kind in (OCCUPIED, FREE):
        wanted, found = grid.cells == kind, true.cells == kind
        assert (wanted & found).sum() >= 0.99 * wanted.sum()
        assert not (wanted & ~scipy.ndimage.binary_dilation(found, EIGHT)).any()


@pytest.mark.parametrize("options", ["", ":unknown=free"])
@pytest.mark.parametrize("share", [0.0, 0.004, 0.1])
def test_the_true_map_of_a_map_is_the_map(tmp_path, options, share):
    cells = speckled(room(), np.random.default_rng(7), share) if share else room()
    require_equal(saved(tmp_path / "m", cells), options)


def test_a_turned_map_is_its_own_true_map(tmp_path):
    path = saved(tmp_path / "m", speckled(room(), np.random.default_rng(1)), origin=(3.0, -2.0, 0.6))
    grid, true = load_map(path), load_world(str(path)).rasterize(HEIGHT_M)
    for kind in (OCCUPIED, FREE):
        centres = grid.center_of(np.argwhere(grid.cells == kind))
        assert np.mean(true.value_at(centres) == kind) >= 0.99


@pytest.mark.skipif(not TB3.is_file(), reason="needs ../shared/facts")
def test_the_tutorials_own_map_is_a_world():
    require_equal(TB3)


@pytest.mark.skipif(not BARN, reason="needs ../shared/data/barn")
def test_barn_worlds_that_were_rasterised_are_worlds(tmp_path):
    save_map(load_world(str(BARN[0])).rasterize(0.1), tmp_path)
    require_equal(tmp_path / "map.yaml")


def test_every_modes_map_becomes_the_cells_that_the_reader_sees(tmp_path):
    pixels = np.full((60, 60), 255, np.uint8)
    pixels[:3], pixels[-3:], pixels[:, :3], pixels[:, -3:] = 0, 0, 0, 0
    pixels[20:24, 30:40] = 20
    Image.fromarray(255 - pixels).save(tmp_path / "m.png")
    yaml = "image: m.png\nresolution: 0.05\norigin: [0, 0, 0]\nnegate: 1\n"
    yaml += "occupied_thresh: 0.65\nfree_thresh: 0.196\n"
    for mode in ("trinary", "scale"):
        (tmp_path / "m.yaml").write_text(f"{yaml}mode: {mode}\n")
        require_equal(tmp_path / "m.yaml")


def test_walls_are_straight_and_few():
    cells = room() == OCCUPIED
    lines = outlines(cells)
    assert sorted(len(line) for line in lines) == [4, 4, 4]  # the wall's two sides and the pillar
    slope = np.zeros((200, 200), bool)
    for x in np.linspace(10, 190, 2000):
        slope[int(20 + 0.3 * x) : int(24 + 0.3 * x), int(x)] = True
    (line,) = outlines(slope)
    assert len(line) < 30
    assert np.mean(filled([line], slope.shape) == slope) > 0.999


def test_cells_that_touch_at_a_corner_stop_beams():
    """Beams along a diagonal of cells that only touch: none comes through."""
    diagonal = np.eye(40, dtype=bool)
    segments = np.vstack([np.hstack([line, np.roll(line, -1, axis=0)]) for line in outlines(diagonal)])
    for start in np.linspace(2.0, 38.0, 400):
        beam = np.array([[start - 1.5, start + 1.5], [start + 1.5, start - 1.5], [start, start - 1.51]])
        assert distance_to_outlines(beam, segments, np.zeros((0, 3))) == 0.0


def test_a_map_of_ours_starts_where_its_drive_did(tmp_path):
    path = saved(tmp_path / "m", room())
    roomy = load_world(str(path)).spawn
    grid = load_map(path)
    free = load_world(str(path)).rasterize(HEIGHT_M)
    assert free.value_at(roomy.xy) == FREE
    distance = scipy.ndimage.distance_transform_edt(grid.cells == FREE)
    assert distance[tuple(grid.cell_of(roomy.xy))] == distance.max()
    beside = path.parent / "trajectory.tum"
    beside.write_text("1.0 0.5 3.5 0 0 0 0.3826834 0.9238795\n2.0 1.5 3.5 0 0 0 0 1\n")
    assert load_world(str(path)).spawn.xyt == pytest.approx([0.5, 3.5, np.pi / 4], abs=1e-6)
    assert sorted(own_files(str(path), None)) == ["world", "world_image", "world_trajectory"]
    beside.write_text("1.0 99.0 3.5 0 0 0 0 1\n")  # of another map
    assert load_world(str(path)).spawn.xyt == pytest.approx(roomy.xyt)
    assert load_world(f"{path}:spawn=0.5/4/1").spawn.xyt == pytest.approx([0.5, 4.0, 1.0])


def test_a_robot_that_drives_into_a_wall_touches_it_and_stays(tmp_path):
    """The wall is where the map has it: the robot's hull stops there, and its lidar sees it there."""
    path = saved(tmp_path / "m", room(), origin=(0.0, 0.0, 0.0))
    world, robot = load_world(f"{path}:spawn=3/1/0"), load_robot("burger")
    config = SimConfig.model_validate({"sensors": "clean", "lidar": {"noise": "none"}})
    with Simulator(world, robot, config, 1) as simulator:
        observation, touched, scan = simulator.reset(), False, None
        for _ in range(360):
            observation = simulator.step(Twist(0.2, 0.0))
            scan = scan if observation.scan is None else observation.scan
            touched = touched or simulator.truth.contact_visible
        x = float(simulator.truth.T_world_base.x)
        wall = (room().shape[1] - 5) * 0.05
        assert touched
        assert x + robot.model.footprint[:, 0].max() == pytest.approx(wall, abs=0.005)
        assert simulator.clearance() < 0.02
        assert scan.ranges[270] == pytest.approx(float(simulator.truth.T_world_base.y) - 0.25, abs=0.01)


def test_people_and_boxes_of_a_world_file_share_the_floor_with_a_map(tmp_path):
    saved(tmp_path / "maps", room(), origin=(0.0, 0.0, 0.0))
    (tmp_path / "world.yaml").write_text(
        "name: mine\nspawn: [1, 1, 0]\nshapes:\n  - {kind: map, file: maps/map.yaml, unknown: free}\n"
        "  - {kind: box, name: b, center: [3, 3], size: [0.4, 0.4], z: [0, 1]}\n"
        "movers:\n  - {name: p, radius: 0.2, path: [[2, 2]], speed: 0.5, wander: [1, 4, 1, 4]}\n"
    )
    world = load_world(str(tmp_path / "world.yaml"))
    true = world.rasterize(HEIGHT_M)
    assert true.value_at(np.array([[2.82, 3.0], [2.0, 2.0], [0.22, 2.0]])).tolist() == [
        OCCUPIED,
        FREE,
        OCCUPIED,
    ]
    assert sorted(own_files(str(tmp_path / "world.yaml"), None)) == ["world", "world_map", "world_map_image"]
    with Simulator(world, load_robot("burger"), seed=1) as simulator:
        simulator.reset()
        before = simulator.surroundings.movers[0].position
        for _ in range(60):
            simulator.step(Twist())
        assert np.linalg.norm(simulator.surroundings.movers[0].position - before) > 0.1
    cluttered = load_world(f"{tmp_path / 'maps' / 'map.yaml'}+clutter:3,boxes=2,movers=1")
    assert (len(cluttered.shapes), len(cluttered.movers)) == (3, 1)


def test_a_3d_lidar_sees_the_walls_of_a_map(tmp_path):
    path = saved(tmp_path / "m", room(), origin=(0.0, 0.0, 0.0))
    world, robot = load_world(f"{path}:spawn=1/2.1/0"), load_robot("waffle_pi_3d")
    with Simulator(world, robot, SimConfig.model_validate({"lidar": {"noise": "none"}}), 1) as simulator:
        simulator.reset()
        clouds = [simulator.step(Twist()).cloud for _ in range(12)]
    cloud = next(cloud for cloud in clouds if cloud is not None)[1]
    points = cloud.points
    ahead = points[(np.abs(points[:, 1]) < 0.02) & (np.abs(points[:, 2]) < 0.05) & (points[:, 0] > 0)]
    pillar = 3.0 - 1.0 - robot.lidar3d.position[0]
    assert len(ahead) > 0
    assert ahead[:, 0] == pytest.approx(np.full(len(ahead), pillar), abs=0.01)


def test_what_is_near_is_as_far_as_among_everything():
    """Clearances by tiles are those among all outlines, to the last bit."""
    rng = np.random.default_rng(3)
    a = rng.uniform(-20, 20, (3000, 2))
    segments = np.hstack([a, a + rng.uniform(-0.5, 0.5, (3000, 2))])
    circles = np.column_stack([rng.uniform(-20, 20, (50, 2)), rng.uniform(0.1, 0.5, 50)])
    nearby = Nearby(Sections(segments, circles, np.ones(3000), np.ones(50)), 1.0)
    for x, y in rng.uniform(-30, 30, (200, 2)):
        square = np.array([[x, y], [x + 0.2, y], [x + 0.2, y + 0.2], [x, y + 0.2]])
        assert nearby.clearance(square) == distance_to_outlines(square, segments, circles)


def test_what_is_no_world_is_refused_in_a_line(tmp_path):
    def refused(path, said):
        with pytest.raises(InputError) as caught:
            load_world(path if isinstance(path, str) else str(path))
        assert said in str(caught.value)
        assert "\n" not in str(caught.value)

    floor = np.zeros((20, 20), np.int8)
    refused(saved(tmp_path / "a", floor), "no occupied cell: a world needs walls")
    refused(saved(tmp_path / "b", floor + OCCUPIED), "no free cell: a robot has no place to stand")
    good = saved(tmp_path / "c", room())
    refused(f"{good}:unknown=lava", "unknown=lava: choose one of solid, free")
    refused(f"{good}:gate=open", "has no option 'gate' (it has: unknown, spawn)")
    refused(f"{good}:spawn=1/2", "spawn=1/2: expected x/y/yaw")
    refused(f"{good}:spawn=1/nan/0", "spawn=1/nan/0: must be three finite numbers")
    (good.parent / "map.pgm").write_bytes(b"\x7fELF")
    refused(good, "not a readable image")
    huge = saved(tmp_path / "d", room(), resolution=50.0)
    refused(huge, "is too large for a map")
    (tmp_path / "e.yaml").write_text("image: a/map.pgm\nresolution: 0.0\norigin: [0, 0, 0]\n")
    refused(tmp_path / "e.yaml", "resolution")
    speckles = np.full((460, 460), FREE, np.int8)
    speckles[::2, ::2] = OCCUPIED
    refused(saved(tmp_path / "f", speckles), "the outlines of its cells have more than 200000 corners")
