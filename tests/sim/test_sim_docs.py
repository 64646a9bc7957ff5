"""The examples in docs/simulator.md work as they stand."""

import re
from pathlib import Path

import pytest

from turtlebag.sim.lidar import LidarConfig
from turtlebag.sim.robots import load_robot, robot_names
from turtlebag.sim.simulator import REALISTIC_SLIP, SimConfig, Simulator
from turtlebag.sim.teleop_scripts import commands, load_script, script_names
from turtlebag.sim.worlds import load_world

TEXT = (Path(__file__).parents[2] / "docs" / "simulator.md").read_text()
BLOCKS = re.findall(r"```yaml\n# (.*?)\n(.*?)```", TEXT, flags=re.DOTALL)


@pytest.fixture
def files(tmp_path):
    paths = {}
    for title, block in BLOCKS:
        paths[title] = str(tmp_path / f"{title.replace(' ', '_')}.yaml")
        Path(paths[title]).write_text(block)
    return paths


def test_the_world_file_is_a_world_with_everything_in_it(files):
    world = load_world(files["world file"])
    assert {solid.name for solid in world.shapes} == {"wall", "pillar", "wedge", "pane", "door"}
    assert len(load_world(files["world file"] + ":door=open").shapes) == 4
    assert [mover.solid.name for mover in world.movers] == ["cart", "person"]
    assert list(world.routes) == ["tour"]
    assert len(world.keepout) == 1
    with Simulator(world, load_robot(world.robot), SimConfig(), 1) as simulator:
        simulator.reset()
        assert simulator.clearance() > 0.1


def test_the_script_can_be_driven_in_it(files):
    world = load_world(files["world file"])
    next(commands(load_script(files["teleop script"]), world, load_robot("burger"), 1))


def test_every_named_world_robot_and_script_exists():
    for name in ("maze:7", "office:3", "forest:5,density=0.5", "turtlebot3_house:gate=open", "empty"):
        assert f"`{name}`" in TEXT
        load_world(name)
    assert all(f"`{name}`" in TEXT for name in [*robot_names(), *script_names()])


def test_the_table_of_settings_names_real_keys_and_their_defaults():
    rows = re.findall(r"^\| `(lidar|odometry|physics|faults)\.(\w+)`", TEXT, flags=re.MULTILINE)
    config = SimConfig()
    assert len(rows) >= 7
    assert all(key in type(getattr(config, part)).model_fields for part, key in rows)
    defaults = LidarConfig()
    assert (defaults.turning, defaults.noise, defaults.sigma, defaults.dropout) == (True, None, None, 0.0)
    assert "| `odometry.slip`, `.turn_slip` | by the preset | " in TEXT
    assert f"standard deviations of {REALISTIC_SLIP['slip']} m" in TEXT


def test_the_table_of_errors_names_every_number_and_the_robots_have_them():
    table = TEXT[TEXT.index("### Where the realistic numbers come from") :]
    rows = dict(re.findall(r"^\| `(\w+)` \| ([\d.]+)", table, flags=re.MULTILINE))
    errors = load_robot("burger").lidar.errors
    unit = {"offset": 1e-3, "sigma": 1e-3, "sigma_square": 1e-3, "square": 1e-3, "resolution": 1e-3}
    share = dict.fromkeys(("scale", "turn_scale", "speed", "jitter", "lost"), 1e-2)
    assert set(rows) == set(type(errors).model_fields)
    for name, number in rows.items():
        value = errors.stamp_delay[0] * 1e3 if name == "stamp_delay" else getattr(errors, name)
        assert float(number) * (unit | share).get(name, 1.0) == pytest.approx(value), name
