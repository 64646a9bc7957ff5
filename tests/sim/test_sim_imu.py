"""The IMU while the robot drives: its signal, noise and bias."""

import numpy as np
import pytest

from turtlebag.datasets.types import Twist
from turtlebag.sim.imu import ImuConfig, ImuSensor
from turtlebag.sim.robots import load_robot
from turtlebag.sim.simulator import SimConfig, Simulator
from turtlebag.sim.worlds import load_world

BURGER = load_robot("burger")
PERFECT = ImuConfig(
    gyro_noise=0, gyro_bias=0, gyro_walk=0, accelerometer_noise=0, accelerometer_bias=0, accelerometer_walk=0
)


def sensor(config, seed=0):
    return ImuSensor(BURGER, config, np.random.default_rng(seed))


def test_a_hundred_samples_a_second_at_even_stamps():
    imu = sensor(ImuConfig())
    stamps = [sample.stamp_ns for step in range(91) for sample in imu.samples(step, Twist())]
    assert stamps == [10_000_000 * (k + 1) for k in range(300)]


def test_perfect_imu_feels_acceleration_turning_and_gravity():
    imu = sensor(PERFECT)
    for step in range(1, 31):  # speed and rate rise evenly for a second
        samples = imu.samples(step, Twist(0.3 * step / 30.0, 1.2 * step / 30.0))
    last = samples[-1]
    x = BURGER.imu.position[0]
    assert last.angular_velocity[2] == pytest.approx(1.2)
    assert last.linear_acceleration[0] == pytest.approx(0.3 - 1.2**2 * x)
    assert last.linear_acceleration[1] == pytest.approx(0.3 * 1.2 + 1.2 * x)
    assert last.linear_acceleration[2] == pytest.approx(9.81)


def test_integrated_gyro_of_a_drive_is_the_true_turn():
    with Simulator(load_world("empty"), BURGER, SimConfig(imu=PERFECT.model_dump()), 0) as simulator:
        simulator.reset()
        samples = [s for _ in range(60) for s in simulator.step(Twist(0.1, 1.0)).imu]
        assert len(samples) == 200
        turned = sum(s.angular_velocity[2] for s in samples) * 0.01
        assert turned == pytest.approx(float(simulator.truth.T_world_base.yaw), abs=0.01)


@pytest.mark.slow
def test_noise_and_bias_have_the_stated_deviations():
    imu = sensor(ImuConfig(gyro_walk=0, accelerometer_walk=0), seed=1)
    samples = [s for step in range(1, 3001) for s in imu.samples(step, Twist())]
    gyro = np.array([s.angular_velocity for s in samples])
    force = np.array([s.linear_acceleration for s in samples])
    np.testing.assert_allclose(gyro.std(axis=0), 2e-4, rtol=0.05)
    np.testing.assert_allclose(force.std(axis=0), 1.7e-2, rtol=0.05)
    biases = [
        sensor(ImuConfig(gyro_noise=0), k).samples(1, Twist())[0].angular_velocity[2] for k in range(200)
    ]
    assert np.std(biases) == pytest.approx(5e-4, rel=0.15)


@pytest.mark.slow
def test_bias_walks_with_the_root_of_time():
    ends = []
    for seed in range(60):
        imu = sensor(ImuConfig(gyro_noise=0, gyro_bias=0, gyro_walk=1e-3), seed)
        ends.append([s for step in range(1, 121) for s in imu.samples(step, Twist())][-1].angular_velocity[2])
    assert np.std(ends) == pytest.approx(1e-3 * np.sqrt(4.0), rel=0.25)


def test_a_switched_off_imu_is_silent():
    assert sensor(ImuConfig(enabled=False)).samples(1, Twist()) == ()
