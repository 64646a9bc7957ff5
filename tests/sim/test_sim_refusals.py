"""What cannot be a world, a robot or a script is refused: one line that names it and says what is wrong."""

import re

import pytest
import yaml

from turtlebag.datasets.errors import InputError
from turtlebag.sim.robots import FOLDER, load_robot
from turtlebag.sim.teleop_scripts import Script, commands, load_script
from turtlebag.sim.worlds import load_world

SEED, CELLS, BOXES = "needs a seed, as in ", "must be a whole number from 2 to 60", "from 0 to 20"
CLUTTER = "turtlebot3_world+clutter:"
NAMES = [
    ("maze", f"maze: {SEED}maze:7"),
    ("maze:x", f"maze:x: {SEED}maze:7"),
    ("maze:-1", f"maze:-1: {SEED}maze:7"),
    ("maze:" + "9" * 5000, f"{SEED}maze:7"),
    ("forest:1,trees=3", "has no option 'trees' (it has: density, size)"),
    ("forest:1,density=many", "density=many: must be a number from 0 to 5"),
    ("maze:1,cells=1e9", f"cells=1e9: {CELLS}"),
    ("maze:1,cells=8.9", f"cells=8.9: {CELLS}"),
    ("maze:1,cells=inf", f"cells=inf: {CELLS}"),
    (CLUTTER, f"{SEED}{CLUTTER}7"),
    (f"{CLUTTER}-1", SEED),
    (f"{CLUTTER}" + "9" * 5000, SEED),
    (f"{CLUTTER}3,cars=2", "has no option 'cars' (it has: boxes, movers)"),
    (f"{CLUTTER}3,boxes=two", f"boxes=two: must be a whole number {BOXES}"),
    (f"{CLUTTER}3,boxes=999", BOXES),
    (f"{CLUTTER}3,boxes=" + "9" * 5000, BOXES),
    (
        "maze:1,cells=2,cell=1.2+clutter:1,boxes=20",
        "no room for box 10 of the clutter",
    ),
    ("turtlebot3_house:gate=ajar", "world turtlebot3_house: gate=ajar: choose one of shut, open"),
    ("turtlebot3_house:roof=off", "world turtlebot3_house has no option 'roof' (it has: gate)"),
    ("empty:gate=open", "world empty has no option 'gate' (it has: none)"),
    ("moon", "unknown world 'moon'; known: empty, turtlebot3_house, turtlebot3_world, maze:SEED"),
]
"""A world's name, and what is said of it."""


def shapes(text):
    return f"name: mine\nspawn: [0, 0, 0]\nshapes: {text}\n"


def sdf(geometry, pose="0 0 0 0.1 0 0"):
    link = f"<link name='l'><collision name='c'><geometry>{geometry}</geometry></collision></link>"
    model = f"<model name='m'><pose>{pose}</pose><static>1</static>{link}</model>"
    return f"<sdf version='1.6'><world name='w'>{model}</world></sdf>"


def prism(outline):
    return shapes(f"[{{kind: prism, name: p, polygon: {outline}, z: [0, 1]}}]")


def robot(section, **change):
    """The burger with some values of a section exchanged, or without it."""
    data = yaml.safe_load((FOLDER / "burger.yaml").read_text())
    if change:
        data[section].update(change)
    elif section == "parts":
        data[section].clear()
    else:
        del data[section]
    return yaml.safe_dump(data)


POSITIVE = "m_0: box: its size is not three positive numbers"
FILES = [
    ("map.yaml", "image: map.pgm\nresolution: 0.05\n", "origin: is missing"),
    ("mine.yaml", "name: mine\nspawn: [0, 0, 0]\n", "not a world file: it has no 'shapes'"),
    ("mine.yaml", shapes("{"), "line 3: not valid YAML"),
    (
        "mine.yaml",
        shapes("[{kind: box, name: b, center: [2, 0], size: [1, -2], z: [0, 1]}]"),
        "shapes.0.box.size.1: must be greater than 0",
    ),
    ("mine.yaml", shapes("[{kind: ball, center: [2, 0]}]"), "'ball' found using 'kind' does not match any"),
    ("mine.yaml", prism("[[0, 0], [2, 0], [0.5, 0.5], [0, 2]]"), "p: its outline is not convex"),
    ("mine.yaml", prism("[[0, 0], [1, 1], [2, 2]]"), "p: its outline has no area"),
    (
        "mine.yaml",
        shapes("[{kind: cylinder, center: [.nan, 0], radius: 1, z: [0, 1]}]"),
        "shapes.0.cylinder.center.0: must be a finite number",
    ),
    (
        "mine.yaml",
        shapes("[{kind: cylinder, center: [2, 0], radius: 1, z: [1, 0]}]"),
        "shapes.0.cylinder.z: the bottom 1 is not below the top 0",
    ),
    ("w.world", sdf("<box><size>1 1</size></box>"), POSITIVE),
    ("w.world", sdf("<box><size>1 1 inf</size></box>"), POSITIVE),
    (
        "w.world",
        sdf("<box><size>1 1 1e-20</size></box>"),
        "its size is next to nothing in one direction",
    ),
    (
        "w.world",
        sdf("<cylinder><radius>-1</radius><length>1</length></cylinder>"),
        "m_0: cylinder: its radius is not a positive number",
    ),
    (
        "w.world",
        sdf("<mesh><uri>none.stl</uri></mesh>"),
        "not found: none.stl; put the models beside the file, or set GAZEBO_MODEL_PATH",
    ),
    ("w.world", sdf("<torus/>"), "m_0: torus: unknown shape"),
    ("w.world", sdf("<torus/>", pose="0 0 0"), "model m: pose '0 0 0' is not six finite numbers"),
    ("w.world", "<sdf version='1.6'><world name='w'><model</world></sdf>", "not readable as SDF"),
    ("robot.yaml", robot("wheels"), "wheels: is missing"),
    ("robot.yaml", robot("limits", max_v=-1.0), "limits.max_v: must be greater than 0"),
    ("robot.yaml", robot("limits", max_speed=1.0), "limits.max_speed: unknown key (known: max_v, max_w"),
    ("robot.yaml", robot("lidar", rate_hz=7.0), "lidar.rate_hz: 30 must be a whole multiple of it, got 7"),
    ("robot.yaml", robot("lidar", angle_min=1e21), "lidar.angle_min: must be less than or equal to 1000000"),
    ("robot.yaml", robot("imu", gyro_noise=1e308), "imu.gyro_noise: must be less than or equal to 1000000"),
    ("robot.yaml", robot("parts"), "parts: must have at least 1 item"),
    (
        "script.yaml",
        "name: idle\nsteps:\n  - {wait: 1, spin: 1}\n",
        "one action (drive, turn_deg, ",
    ),
]
"""A file's name, what is in it, and what is said of it."""
READERS = {"robot.yaml": load_robot, "script.yaml": load_script}


@pytest.mark.parametrize(("name", "said"), NAMES, ids=range(len(NAMES)))
def test_a_world_that_there_is_not_is_refused(name, said):
    with pytest.raises(InputError, match=re.escape(said)) as caught:
        load_world(name)
    assert "\n" not in str(caught.value)


@pytest.mark.parametrize(("name", "text", "said"), FILES, ids=range(len(FILES)))
def test_a_bad_file_is_refused_by_its_name(tmp_path, name, text, said):
    path = tmp_path / name
    path.write_text(text)
    with pytest.raises(InputError, match=re.escape(said)) as caught:
        READERS.get(name, load_world)(str(path))
    assert str(caught.value).startswith(str(path))
    assert "\n" not in str(caught.value)


def test_an_unknown_route_names_the_known():
    script = Script(name="test", steps=[{"route": "scenic"}])
    with pytest.raises(InputError, match="perimeter_then_rooms"):
        commands(script, load_world("turtlebot3_world"), load_robot("burger"), 1)
