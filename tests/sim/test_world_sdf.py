"""Gazebo worlds: shapes, nested poses, includes, meshes with their units."""

import struct
from pathlib import Path

import numpy as np
import pytest

from turtlebag.datasets.errors import InputError
from turtlebag.datasets.se2 import SE2
from turtlebag.datasets.types import Twist
from turtlebag.sim.raycast import distance_to_outlines
from turtlebag.sim.robots import load_robot
from turtlebag.sim.sdf import load_sdf, pose_matrix
from turtlebag.sim.shapes import Ball, Mesh, as_rectangle, contains
from turtlebag.sim.simulator import SimConfig, Simulator
from turtlebag.sim.worlds import load_world

BARN = sorted((Path(__file__).parents[3] / "shared" / "data" / "barn").glob("*.world"))


def write(tmp_path, body, name="w.world"):
    path = tmp_path / name
    path.write_text(f"<sdf version='1.6'><world name='w'>{body}</world></sdf>")
    return path


def model(geometry, pose="0 0 0 0 0 0", link="", collision="", name="m"):
    return (
        f"<model name='{name}'><pose>{pose}</pose><static>1</static><link name='l'>{link}"
        f"<collision name='c'>{collision}<geometry>{geometry}</geometry></collision></link></model>"
    )


def one(tmp_path, body):
    (solid,) = load_sdf(write(tmp_path, body))[1]
    return solid


def test_box_with_nested_poses_stands_where_they_lead(tmp_path):
    box = "<box><size>2 1 0.5</size></box>"
    pose = "<pose>1 0 0.25 0 0 0.2</pose>"
    solid = one(tmp_path, model(box, "1 2 0 0 0 1.5707963267948966", pose, "<pose>0 0 0 0 0 0.1</pose>"))
    # The model is turned by 90 degrees, so the link's 1 m along x leads to y.
    assert solid.center == pytest.approx((1.0, 3.0))
    assert as_rectangle(solid.polygon)[4] % np.pi == pytest.approx((np.pi / 2 + 0.3) % np.pi)
    assert (solid.z_min, solid.z_max) == pytest.approx((0.0, 0.5))


def test_nested_models_add_up(tmp_path):
    inner = model("<cylinder><radius>0.2</radius><length>1</length></cylinder>", "1 0 0.5 0 0 0")
    solid = one(tmp_path, f"<model name='outer'><pose>0 5 0 0 0 3.141592653589793</pose>{inner}</model>")
    assert solid.is_cylinder
    assert (solid.z_min, solid.z_max) == pytest.approx((0.0, 1.0))
    assert solid.center == pytest.approx((-1.0, 5.0))


def test_the_saved_state_overrides_the_models_pose(tmp_path):
    body = model("<box><size>1 1 1</size></box>", "0 0 0 0 0 0")
    body += "<state world_name='w'><model name='m'><pose>3 4 0 0 0 0</pose></model></state>"
    assert one(tmp_path, body).center == pytest.approx((3.0, 4.0))


def test_spheres_and_tilted_boxes_are_cut_at_the_height_asked_for(tmp_path):
    sphere = one(tmp_path, model("<sphere><radius>0.5</radius></sphere>", "0 0 0.4 0 0 0"))
    assert isinstance(sphere, Ball)
    assert sphere.outline(0.4, 0.4)[1][0, 2] == pytest.approx(0.5)
    assert sphere.outline(0.7, 0.7)[1][0, 2] == pytest.approx(0.4)
    ramp = one(tmp_path, model("<box><size>2 1 0.2</size></box>", "0 0 0.5 0 0.5 0"))
    assert isinstance(ramp, Mesh)
    low, high = ramp.outline(0.2, 0.2)[0], ramp.outline(0.8, 0.8)[0]
    assert low[:, [0, 2]].mean() > 0.3 > -0.3 > high[:, [0, 2]].mean()  # nose down: low ahead


def test_planes_and_visuals_are_no_obstacles(tmp_path):
    body = model("<plane><normal>0 0 1</normal></plane>")
    body += "<model name='v'><link name='l'><visual name='v'><geometry><box><size>1 1 1</size></box>"
    body += "</geometry></visual></link></model>"
    assert load_sdf(write(tmp_path, body))[1] == []
    with pytest.raises(InputError, match="no static"):
        load_world(str(write(tmp_path, body)))


def ring_stl(path):
    """A square wall ring, 4 m outside and 3 m inside, 1 m high, in millimetres."""
    faces = []
    for half, sense in ((2000.0, 1), (1500.0, -1)):
        corners = [(-half, -half), (half, -half), (half, half), (-half, half)][::sense]
        for (ax, ay), (bx, by) in zip(corners, corners[1:] + corners[:1], strict=True):
            faces += [
                ((ax, ay, 0), (bx, by, 0), (bx, by, 1000)),
                ((ax, ay, 0), (bx, by, 1000), (ax, ay, 1000)),
            ]
    data = bytes(80) + struct.pack("<I", len(faces))
    for face in faces:
        data += struct.pack("<12fH", 0, 0, 0, *(v for corner in face for v in corner), 0)
    path.write_bytes(data)


def test_a_mesh_may_be_hollow_and_is_felt_by_lidar_and_wheels(tmp_path):
    ring_stl(tmp_path / "ring.stl")
    geometry = "<mesh><uri>ring.stl</uri><scale>0.001 0.001 0.001</scale></mesh>"
    world = load_world(str(write(tmp_path, model(geometry))))
    np.testing.assert_array_equal(
        contains(world.shapes, 0.2, np.array([[0.0, 0.0], [1.75, 0.0], [2.5, 0.0]])), [False, True, False]
    )
    with Simulator(
        world, load_robot("burger"), SimConfig(lidar={"noise": "none", "turning": False}), 0
    ) as sim:
        scan = sim.reset(SE2.from_xyt(0.032, 0.0, 0.0)).scan
        assert scan.ranges[[0, 90, 180, 270]] == pytest.approx([1.5] * 4, abs=1e-3)
        for _ in range(300):
            sim.step(Twist(0.22, 0.0))
        assert sim.truth.contact_visible
        assert float(sim.truth.T_world_base.x) == pytest.approx(1.5 - 0.038, abs=0.02)


def test_a_world_file_may_hold_meshes(tmp_path):
    ring_stl(tmp_path / "ring.stl")
    path = tmp_path / "w.yaml"
    path.write_text(
        "name: w\nspawn: [1, 0, 0]\nshapes:\n"
        "  - {kind: mesh, name: ring, file: ring.stl, position: [1, 0, 0], scale: [0.001, 0.001, 0.001]}\n"
    )
    world = load_world(str(path))
    assert world.shapes[0].bounds() == pytest.approx((-1.0, 3.0, -2.0, 2.0))
    grid = world.rasterize(0.18)
    # Free inside, the wall's inner face occupied, and what lies behind it unknown.
    values = grid.value_at(np.array([[1.0, 0.0], [2.501, 0.3], [2.75, 0.3], [3.2, 0.3]]))
    assert values.tolist() == [0, 100, -1, -1]
    path.write_text("name: w\nspawn: [1, 0, 0]\nshapes: [{kind: mesh, name: m, file: none.stl}]\n")
    with pytest.raises(InputError, match=r"none\.stl"):
        load_world(str(path))


COLLADA = """<COLLADA xmlns="http://www.collada.org/2005/11/COLLADASchema"><asset><unit meter="0.0254"/>
<up_axis>Y_UP</up_axis></asset><library_geometries><geometry id="g"><mesh><source id="p">
<float_array id="pa" count="9">0 0 0 100 0 0 0 100 50</float_array></source>
<vertices id="v"><input semantic="POSITION" source="#p"/></vertices>
<triangles count="1"><input semantic="VERTEX" source="#v" offset="0"/><p>0 1 2</p></triangles></mesh>
</geometry></library_geometries></COLLADA>"""


def test_colladas_unit_counts_and_its_up_axis_does_not(tmp_path):
    (tmp_path / "t.dae").write_text(COLLADA)
    solid = one(tmp_path, model("<mesh><uri>t.dae</uri></mesh>"))
    assert solid.bounds() == pytest.approx((0.0, 2.54, 0.0, 2.54))
    assert solid.z_max == pytest.approx(1.27)


def test_includes_are_found_on_the_model_path(tmp_path, monkeypatch):
    folder = tmp_path / "elsewhere" / "crate"
    folder.mkdir(parents=True)
    (folder / "model.sdf").write_text(f"<sdf version='1.6'>{model('<box><size>1 1 1</size></box>')}</sdf>")
    body = "<include><uri>model://crate</uri><pose>2 0 0.5 0 0 0</pose></include>"
    with pytest.raises(InputError, match="GAZEBO_MODEL_PATH"):
        load_sdf(write(tmp_path, body))
    monkeypatch.setenv("GAZEBO_MODEL_PATH", str(tmp_path / "elsewhere"))
    assert one(tmp_path, body).center == pytest.approx((2.0, 0.0))


FUEL = "https://fuel.gazebosim.org/1.0/OpenRobotics/models"


@pytest.mark.parametrize(
    ("floor", "sun"),
    [
        ("model://ground_plane", "model://sun"),
        (f"{FUEL}/Ground Plane", f"{FUEL}/Sun"),
        (f"{FUEL}/Ground%20Plane", f"{FUEL}/Sun/2"),
        (f"{FUEL}/Ground Plane/tip".replace("gazebosim", "ignitionrobotics"), f"{FUEL}/sun"),
        ("https://app.gazebosim.org/OpenRobotics/fuel/models/Ground%20Plane", f"{FUEL.lower()}/Sun"),
    ],
)
def test_the_floor_and_the_sun_need_no_model(tmp_path, floor, sun):
    # As turtlebot3_simulations has it: worlds beside models, the model included within one.
    folder = tmp_path / "models" / "my_house"
    folder.mkdir(parents=True)
    (folder / "model.sdf").write_text(f"<sdf version='1.6'>{model('<box><size>1 1 1</size></box>')}</sdf>")
    (tmp_path / "worlds").mkdir()
    light = f"<include><uri>{floor}</uri></include><include>\n<uri> {sun} </uri></include>"
    house = "<include><uri>model://my_house</uri></include>"
    body = f"{light}<model name='my_house'><static>1</static>{house}</model>"
    assert load_world(str(write(tmp_path / "worlds", body))).shapes[0].center == pytest.approx((0.0, 0.0))
    with pytest.raises(InputError, match=r"contains no static .* --world empty"):
        load_world(str(write(tmp_path / "worlds", light, "empty.world")))


def test_all_that_is_not_found_is_named_in_one_line(tmp_path):
    folder = tmp_path / "crate"
    folder.mkdir()
    missing = model("<mesh><uri>model://crate/meshes/crate.dae</uri></mesh>")
    (folder / "model.sdf").write_text(f"<sdf version='1.6'>{missing}</sdf>")
    uris = ["model://table", "model://table", f"{FUEL}/Chair", "model://crate", f"{FUEL}/Sun/files/sun.dae"]
    body = "".join(f"<include><uri>{uri}</uri></include>" for uri in uris) + "<include/>"
    with pytest.raises(InputError) as caught:
        load_sdf(write(tmp_path, body))
    told = str(caught.value)
    assert "\n" not in told
    assert told.split("not found: ")[1].split("; ")[0].split(", ") == [
        "model://table",
        f"{FUEL}/Chair",
        "model://crate/meshes/crate.dae",
        f"{FUEL}/Sun/files/sun.dae",
        "an include without a uri",
    ]


def test_a_model_of_fuel_is_found_by_its_name_on_gazebos_paths(tmp_path, monkeypatch):
    folder = tmp_path / "elsewhere" / "Big Chair"
    folder.mkdir(parents=True)
    (folder / "model.sdf").write_text(f"<sdf version='1.6'>{model('<box><size>1 1 1</size></box>')}</sdf>")
    monkeypatch.setenv("GZ_SIM_RESOURCE_PATH", str(tmp_path / "elsewhere"))
    body = f"<include><uri>{FUEL}/Big%20Chair/3</uri><pose>2 0 0.5 0 0 0</pose></include>"
    assert one(tmp_path, body).center == pytest.approx((2.0, 0.0))


def test_pose_matrix_is_a_rotation_and_a_translation():
    matrix = pose_matrix("1 2 3 0.1 -0.2 0.3")
    np.testing.assert_allclose(matrix[:3, :3] @ matrix[:3, :3].T, np.eye(3), atol=1e-12)
    np.testing.assert_allclose(matrix[:3, 3], [1, 2, 3])


@pytest.mark.slow
@pytest.mark.skipif(not BARN, reason="the shared BARN worlds are not beside this checkout")
def test_every_barn_world_loads_and_the_fast_robot_drives_in_it():
    robot = load_robot("jackal")
    for path in BARN:
        world = load_world(f"{path}:spawn=-2.25/3/1.5708")
        assert 150 < len(world.shapes) < 500
        assert {round(solid.radius, 3) for solid in world.shapes} == {0.075}
        outlines = world.touchable(robot.height)
        assert (
            distance_to_outlines(world.spawn @ robot.model.footprint, outlines.segments, outlines.circles)
            > 0.05
        )
    with Simulator(world, robot, SimConfig(), 0) as simulator:
        simulator.reset()
        for _ in range(30):
            observation = simulator.step(Twist(1.0, 0.0))
        assert float(simulator.truth.T_world_base.y) == pytest.approx(3.0 + 1.0 - 0.2, abs=0.05)
        assert observation.scan is not None
        assert np.isfinite(observation.scan.ranges).mean() > 0.3
