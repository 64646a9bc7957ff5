"""The robot is moved by its wheels only, and its odometry can be wrong."""

from contextlib import closing

import numpy as np
import pybullet
import pytest

from turtlebag.datasets.errors import InputError
from turtlebag.datasets.se2 import SE2
from turtlebag.datasets.types import Twist
from turtlebag.sim.physics import Physics
from turtlebag.sim.robots import load_robot
from turtlebag.sim.simulator import SimConfig, Simulator, stamp_of
from turtlebag.sim.worlds import load_world

WORLD, EMPTY, BURGER = load_world("turtlebot3_world"), load_world("empty"), load_robot("burger")
EXACT = {"radius_error": 0.0, "track_error": 0.0}


def drive(simulator, commands):
    """Final observation after (twist, steps) pairs."""
    observation = simulator.reset()
    for twist, steps in commands:
        for _ in range(steps):
            observation = simulator.step(twist)
    return observation


def test_straight_drive_covers_speed_times_time():
    with Simulator(EMPTY, BURGER, SimConfig(odometry=EXACT), 0) as simulator:
        observation = drive(simulator, [(Twist(0.2, 0.0), 150)])
        x, y, yaw = simulator.truth.T_world_base.xyt
        # 5 s at 0.2 m/s less the ramp of 0.2 s.
        assert x == pytest.approx(5.0 * 0.2 - 0.5 * 0.2 * 0.2, abs=0.01)
        assert abs(y) < 0.005
        assert abs(yaw) < 0.01
        assert observation.odometry.T_odom_base.x == pytest.approx(x, abs=0.01)
        assert simulator.truth.twist.v == pytest.approx(0.2, abs=0.005)
        assert observation.stamp_ns == 5_000_000_000 == stamp_of(150)


def test_turn_on_the_spot_turns_by_rate_times_time():
    with Simulator(EMPTY, BURGER, SimConfig(odometry=EXACT), 0) as simulator:
        drive(simulator, [(Twist(0.0, 0.5), 90)])
        x, y, yaw = simulator.truth.T_world_base.xyt
        assert yaw == pytest.approx(1.5, abs=0.03)
        assert np.hypot(x, y) < 0.01


@pytest.mark.parametrize("command", [Twist(5.0, 0.0), Twist(-5.0, 0.0), Twist(0.0, 90.0), Twist(0.22, 2.84)])
def test_speed_and_acceleration_limits_hold_whoever_commands(command):
    with Simulator(EMPTY, BURGER, SimConfig(odometry=EXACT), 0) as simulator:
        simulator.reset()
        rims = [0.0]
        for _ in range(60):
            observation = simulator.step(command)
            rims.append(observation.joints.velocity[1] * BURGER.wheels.radius)
            assert abs(simulator.truth.twist.v) <= 0.22 * 1.02
            assert abs(simulator.truth.twist.w) <= 2.84 * 1.02
        # 1 m/s^2 at the rim: 1/30 m/s a control step, and what the motors overshoot.
        assert np.abs(np.diff(rims)).max() <= 1.0 / 30.0 * 1.1


def test_against_a_wall_the_wheels_spin_and_odometry_advances_but_the_robot_does_not():
    facing_wall = SE2.from_xyt(0.0, 2.2, np.pi / 2.0)
    with Simulator(WORLD, BURGER, SimConfig(), 0) as simulator:
        simulator.reset(facing_wall)
        for _ in range(90):
            before = simulator.step(Twist(0.2, 0.0))
        truth_before, joints_before = simulator.truth, before.joints
        for _ in range(150):
            after = simulator.step(Twist(0.2, 0.0))
        moved = np.hypot(*(simulator.truth.T_world_base.xy - truth_before.T_world_base.xy))
        believed = np.hypot(*(after.odometry.T_odom_base.xy - before.odometry.T_odom_base.xy))
        assert moved < 0.02
        assert believed > 0.9
        assert after.joints.position[0] - joints_before.position[0] > 25.0
        assert simulator.truth.contact_visible
        assert not simulator.truth.contact_low
        assert simulator.clearance() < 0.01


@pytest.mark.slow
def test_lower_friction_raises_drift():
    def drift(friction):
        config = SimConfig(physics={"friction": friction}, odometry=EXACT)
        with Simulator(EMPTY, BURGER, config, 0) as simulator:
            observation = drive(simulator, [(Twist(0.2, 0.0), 30), (Twist(-0.2, 2.0), 30)] * 6)
            error = observation.odometry.T_odom_base.xy - simulator.truth.T_world_base.xy
            return float(np.hypot(*error))

    slippery, normal, grippy = drift(0.05), drift(0.1), drift(0.9)
    assert slippery > 2.0 * normal
    assert normal > 1.2 * grippy
    assert grippy > 1e-4  # even so it slips a little


def test_the_pose_is_never_set_after_the_reset(monkeypatch):
    with Simulator(WORLD, BURGER, SimConfig(), 0) as simulator:
        simulator.reset()

        def forbidden(*args, **kwargs):
            raise AssertionError("the simulation moved a body by hand")

        for name in dir(pybullet):
            if name.startswith(("resetBase", "resetJoint", "applyExternal", "createConstraint")):
                monkeypatch.setattr(pybullet, name, forbidden)
        for _ in range(30):
            simulator.step(Twist(0.2, 0.3))
        assert np.hypot(*(simulator.truth.T_world_base.xy - WORLD.spawn.xy)) > 0.1


def test_masses_and_inertia_in_bullet_are_the_specified_ones():
    with closing(Physics(EMPTY.shapes, [], BURGER, SimConfig().physics)) as physics:
        physics.reset(EMPTY.spawn)
        body, client = physics.body, physics.client
        infos = [pybullet.getDynamicsInfo(body, link, physicsClientId=client) for link in (-1, 0, 1)]
        assert sum(info[0] for info in infos) == pytest.approx(1.0017, abs=1e-4)
        assert infos[1][2] == pytest.approx(BURGER.wheels.inertia)
        com = np.average(
            [infos[0][3], (0.0, 0.08, 0.033), (0.0, -0.08, 0.033)], axis=0, weights=[i[0] for i in infos]
        )
        assert com[0] == pytest.approx(-0.0041, abs=2e-4)
        assert com[2] == pytest.approx(0.031, abs=1e-3)


def test_calibration_error_makes_odometry_wrong_in_proportion_and_by_seed():
    def scale(seed, error):
        config = SimConfig(odometry={"radius_error": error, "track_error": 0.0})
        with Simulator(EMPTY, BURGER, config, seed) as simulator:
            observation = drive(simulator, [(Twist(0.2, 0.0), 90)])
            return float(observation.odometry.T_odom_base.x / simulator.truth.T_world_base.x) - 1.0

    scales = [scale(seed, 0.05) for seed in range(3)]
    assert len({round(value, 5) for value in scales}) == 3
    assert all(abs(value) < 0.052 for value in scales)
    assert max(abs(value) for value in scales) > 0.005
    assert abs(scale(0, 0.0)) < 0.002


def test_odometry_starts_at_the_start_pose():
    start = SE2.from_xyt(-1.9, 0.3, 1.0)
    with Simulator(WORLD, BURGER, SimConfig(), 3) as simulator:
        observation = simulator.reset(start)
        np.testing.assert_allclose(observation.odometry.T_odom_base.xyt, start.xyt)
        np.testing.assert_allclose(simulator.truth.T_world_base.xyt, start.xyt, atol=2e-3)


def test_a_start_in_an_obstacle_is_refused():
    with Simulator(WORLD, BURGER, SimConfig(), 0) as simulator:
        for x, y in ((0.0, 0.0), (0.0, 2.5), (np.nan, 0.0), (1e300, 0.0), (0.0, -1e9)):
            with pytest.raises(InputError, match="start pose"):
                simulator.reset(SE2.from_xyt(x, y, 0.0))


def test_same_seed_same_observations_and_reset_starts_over():
    def run(simulator):
        simulator.reset()
        out = []
        for k in range(45):
            observation = simulator.step(Twist(0.15, 0.8 if k < 20 else -0.4))
            out.append(simulator.truth.T_world_base.xyt.tobytes())
            out.append(observation.odometry.T_odom_base.xyt.tobytes())
            if observation.scan is not None:
                out.append(observation.scan.ranges.tobytes())
        return b"".join(out)

    with Simulator(WORLD, BURGER, SimConfig(), 5) as a, Simulator(WORLD, BURGER, SimConfig(), 5) as b:
        first = run(a)
        assert run(b) == first
        assert run(a) == first
    with Simulator(WORLD, BURGER, SimConfig(), 6) as c:
        assert run(c) != first


def test_clearance_at_the_spawn_and_beside_a_pillar():
    with Simulator(WORLD, BURGER, SimConfig(), 0) as simulator:
        simulator.reset(SE2.from_xyt(-1.1 + 0.15 + 0.105 + 0.30, 0.0, 0.0))
        # The footprint reaches 0.105 m back from the base, the pillar's rim is 0.30 m farther.
        assert simulator.clearance() == pytest.approx(0.30, abs=0.002)


@pytest.mark.slow
@pytest.mark.parametrize("robot", ["burger", "waffle_pi"])
def test_a_slab_below_the_lidar_stops_the_robot_and_counts_as_low(robot):
    house, robot = load_world("turtlebot3_house"), load_robot(robot)
    with Simulator(house, robot, SimConfig(), 0) as simulator:
        simulator.reset(SE2.from_xyt(5.5, -3.0, 0.0))  # the cafe table's base begins at x = 6.08
        low = visible = 0
        for _ in range(240):
            simulator.step(Twist(0.2, 0.0))
            low += simulator.truth.contact_low
            visible += simulator.truth.contact_visible
        assert low > 30
        assert visible == 0
        assert float(simulator.truth.T_world_base.x) < 6.08


def test_the_robot_drives_under_a_table():
    house = load_world("turtlebot3_house")
    with Simulator(house, BURGER, SimConfig(), 0) as simulator:
        simulator.reset(SE2.from_xyt(-4.0, 2.42, 0.0))
        for _ in range(450):
            simulator.step(Twist(0.2, 0.0))
            assert not simulator.truth.contact_visible
        assert float(simulator.truth.T_world_base.x) > -1.3


def test_a_touch_of_one_physics_step_counts_wherever_in_the_control_step_it_is(monkeypatch):
    with Simulator(WORLD, BURGER, SimConfig(), 0) as simulator:
        simulator.reset(SE2.from_xyt(-2.5, -0.5, np.pi))
        # Bullet's contact points with every body: the gap is below nought, and pushes.
        touch = [(0, 0, body, -1, -1, (), (), (), -1e-3, 1.0) for body in range(50)]
        looks = iter([[], touch, *[[]] * 100])
        monkeypatch.setattr(pybullet, "getContactPoints", lambda **of: next(looks))
        simulator.step(Twist())
        assert simulator.truth.contact_visible
        simulator.step(Twist())
        assert not simulator.truth.contact_visible


def test_contacts_are_not_looked_for_far_from_everything(monkeypatch):
    with Simulator(WORLD, BURGER, SimConfig(), 0) as simulator:
        simulator.reset(SE2.from_xyt(-1.65, -0.5, 0.0))

        def refuse(**of: int) -> None:
            raise AssertionError("nothing is near")

        monkeypatch.setattr(pybullet, "getContactPoints", refuse)
        simulator.step(Twist(0.1, 0.0))
