"""A robot's own errors: what its file says of its wheels, lidar, IMU and commands is what it does."""

import numpy as np
import pytest

from turtlebag.datasets.types import Twist
from turtlebag.sim.lidar_errors import LidarUnit
from turtlebag.sim.robots import LidarErrors, load_robot
from turtlebag.sim.simulator import SimConfig, Simulator
from turtlebag.sim.worlds import load_world


def robot_with(**parts):
    """The burger with other numbers in some of its parts; its calibration is exact."""
    burger = load_robot("burger")
    parts = {"wheels": {}, **parts}
    parts["wheels"] = {"calibration_error": 0.0, "slip": 0.0, "turn_slip": 0.0, **parts["wheels"]}
    changed = {name: getattr(burger, name).model_copy(update=to) for name, to in parts.items()}
    return burger.model_copy(update=changed)


def driven(robot, command, steps=150):
    """True pose and odometry after some control steps with one command, from the origin."""
    with Simulator(load_world("empty"), robot, SimConfig(), 1) as sim:
        start = sim.reset().odometry.T_odom_base
        for _ in range(steps):
            last = sim.step(command)
        return (start.inverse() @ sim.truth.T_world_base).xyt, (
            start.inverse() @ last.odometry.T_odom_base
        ).xyt


def test_a_controller_with_a_larger_radius_overstates_the_way():
    true, said = driven(robot_with(wheels={"controller_radius": 0.033 * 1.05}), Twist(0.2, 0.0))
    assert said[0] / true[0] == pytest.approx(1.05, abs=0.002)


def test_a_robot_with_a_larger_wheel_turns_where_its_odometry_goes_straight():
    true, said = driven(robot_with(wheels={"turn_per_m": 0.1}), Twist(0.2, 0.0))
    assert said[2] == pytest.approx(0.0, abs=0.003)
    assert true[2] / true[0] == pytest.approx(0.1, abs=0.01)


def test_commands_come_late():
    delayed, _ = driven(robot_with(limits={"command_delay": 0.5}), Twist(0.2, 0.0))
    usual, _ = driven(robot_with(), Twist(0.2, 0.0))
    assert usual[0] - delayed[0] == pytest.approx(0.1, abs=0.002)


def test_what_is_known_of_a_lidar_adds_to_its_ranges():
    none = {"sigma": 0.0, "known_offset": 0.02, "known_square": -0.01}
    unit = LidarUnit(LidarErrors(**none), np.random.default_rng(1))
    assert unit.ranges(np.array([1.0, 2.0, np.inf])).tolist() == pytest.approx([1.01, 1.98, np.inf])


def test_the_numbers_of_the_robots_file_are_in_the_resolved_settings():
    robot = robot_with(wheels={"slip": 0.004}, imu={"gyro_noise": 0.003})
    found = SimConfig().resolved(robot)
    assert (found.odometry.slip, found.odometry.turn_slip, found.imu.gyro_noise) == (0.004, 0.0, 0.003)
    assert SimConfig(sensors="clean").resolved(robot).odometry.slip == 0.0
