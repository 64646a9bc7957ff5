"""Robot files: the built-in ones by the published numbers, a user's own, and what is wrong with a bad one."""

import numpy as np
import pytest
import yaml

from turtlebag.datasets.types import Twist
from turtlebag.sim.robots import FOLDER, load_robot, robot_names
from turtlebag.sim.simulator import SimConfig, Simulator
from turtlebag.sim.urdf import composite
from turtlebag.sim.worlds import load_world


@pytest.mark.parametrize(
    ("name", "v", "w", "inscribed", "circumscribed", "lidar_height", "mass"),
    [
        ("burger", 0.22, 2.84, 0.041, 0.1485, 0.182, 1.0017),
        ("waffle_pi", 0.26, 1.82, 0.077, 0.257, 0.132, 1.5539),
        ("jackal", 2.0, 3.0, 0.215, 0.3335, 0.28, 16.8),
    ],
)
def test_built_in_robots_have_their_published_numbers(
    name, v, w, inscribed, circumscribed, lidar_height, mass
):
    robot = load_robot(name)
    model = robot.model
    assert (model.max_v, model.max_w) == (v, w)
    assert model.inscribed_radius == pytest.approx(inscribed, abs=1e-3)
    assert model.circumscribed_radius == pytest.approx(circumscribed, abs=1e-3)
    assert robot.lidar_height == lidar_height
    total = composite(robot.parts)[0] + 2 * robot.wheels.mass
    assert total == pytest.approx(mass, rel=0.01)


def test_each_world_has_its_robot():
    assert load_world("turtlebot3_world").robot == load_world("empty").robot == "burger"
    assert load_world("turtlebot3_house").robot == "waffle_pi"


def test_the_fast_robots_lidar_looks_ahead_over_270_degrees():
    spec = load_robot("jackal").lidar.spec(turning=True)
    assert spec.n_beams == 720
    assert np.rad2deg(spec.angles[[0, -1]]) == pytest.approx([-135.0, 134.6], abs=0.1)
    assert spec.range_max == 30.0
    assert spec.time_increment * 720 == pytest.approx(0.75 * spec.scan_time)


@pytest.mark.slow
@pytest.mark.parametrize("name", robot_names())
def test_every_robot_stands_level_and_drives_straight(name):
    robot = load_robot(name)
    with Simulator(load_world("empty"), robot, SimConfig(lidar={"noise": "none"}), 0) as simulator:
        simulator.reset()
        for _ in range(90):
            simulator.step(Twist(robot.limits.max_v, 0.0))
        x, y, yaw = simulator.truth.T_world_base.xyt
        ramp = robot.limits.max_v / robot.limits.max_dv
        assert x == pytest.approx(robot.limits.max_v * (3.0 - ramp / 2.0), rel=0.04)
        assert abs(y) < 0.02
        assert abs(yaw) < 0.02


def own(tmp_path, change):
    data = yaml.safe_load((FOLDER / "burger.yaml").read_text())
    change(data)
    path = tmp_path / "mine.yaml"
    path.write_text(yaml.safe_dump(data))
    return str(path)


def test_a_users_own_robot_is_one_file(tmp_path):
    def faster(data):
        data["name"] = "mine"
        data["limits"]["max_v"] = 0.5
        data["lidar"]["n_beams"] = 180
        data["lidar"]["angle_increment_deg"] = 2.0

    robot = load_robot(own(tmp_path, faster))
    with Simulator(load_world("turtlebot3_world"), robot, SimConfig(), 0) as simulator:
        simulator.reset()
        scans = [o.scan for o in (simulator.step(Twist(0.5, 0.0)) for _ in range(36)) if o.scan is not None]
        assert scans[0].ranges.shape == (180,)
        assert simulator.truth.twist.v == pytest.approx(0.5, rel=0.03)
