"""Fault injection: late commands; late, lost and silent sensors."""

import numpy as np
import pytest
from pydantic import ValidationError

from turtlebag.datasets.errors import InputError
from turtlebag.datasets.types import Twist
from turtlebag.sim.faults import FaultConfig
from turtlebag.sim.robots import load_robot
from turtlebag.sim.simulator import SimConfig, Simulator
from turtlebag.sim.worlds import load_world

BURGER, EMPTY = load_robot("burger"), load_world("turtlebot3_world")


AHEAD = Twist(0.1, 0.0)


def run(steps, command=AHEAD, **faults):
    """Observations, true poses by stamp, and (stamp, true pose) of each scan delivered."""
    with Simulator(EMPTY, BURGER, SimConfig(sensors="clean", faults=faults), 1) as simulator:
        observations, truths, scans = [simulator.reset()], {}, []
        for _ in range(steps):
            truths[observations[-1].stamp_ns] = simulator.truth.T_world_base.xyt
            observations.append(simulator.step(command))
            if observations[-1].scan is not None:
                scans.append((observations[-1].scan.stamp_ns, simulator.scan_truth.xyt))
        return observations, truths, scans


def test_a_late_command_moves_the_robot_later():
    def moved(delay):
        observations, _, _ = run(60, command_delay=delay)
        return float(observations[-1].odometry.T_odom_base.x - observations[0].odometry.T_odom_base.x)

    assert moved(0.0) - moved(0.5) == pytest.approx(0.05, abs=0.003)


def test_a_late_scan_keeps_its_stamp_and_its_truth():
    prompt, _, on_time = run(60)
    late, truths, scans = run(60, scan_delay=0.3)
    arrivals = [o.stamp_ns for o in late if o.scan is not None]
    assert arrivals[0] == 500_000_000
    assert [stamp for stamp, _ in scans] == [stamp for stamp, _ in on_time][: len(scans)]
    for stamp, pose in scans:
        np.testing.assert_array_equal(pose, truths[stamp])
    a, b = (next(o.scan for o in found if o.scan is not None) for found in (prompt, late))
    np.testing.assert_array_equal(a.ranges, b.ranges)


@pytest.mark.slow
def test_scans_are_lost_at_the_stated_rate():
    _, _, scans = run(1200, command=Twist(), scan_loss=0.3)
    assert len(scans) / 200 == pytest.approx(0.7, abs=0.1)


def test_silent_spans_hold_nothing():
    observations, _, scans = run(90, scan_silent=((1.0, 2.0),), imu_silent=((0.5, 1.5),))
    assert not [stamp for stamp, _ in scans if 1.0 <= stamp * 1e-9 < 2.0]
    stamps = np.array([sample.stamp_ns for o in observations for sample in o.imu]) * 1e-9
    assert len(stamps) == 200
    assert not np.any((stamps >= 0.5) & (stamps < 1.5))
    assert len(scans) >= 9


def test_a_span_that_ends_before_it_starts_is_refused():
    with pytest.raises(ValidationError, match="end after"):
        FaultConfig(scan_silent=((2.0, 1.0),))


def test_a_kidnap_moves_the_robot_and_not_its_odometry():
    faults = FaultConfig(kidnap=((1.0, 2.0, -1.0, 1.5),))
    config = SimConfig(sensors="clean", faults=faults)
    with Simulator(load_world("empty"), load_robot("burger"), config, 1) as simulator:
        simulator.reset()
        for _ in range(29):
            before = simulator.step(Twist())
        after = simulator.step(Twist())
        assert simulator.truth.T_world_base.xyt == pytest.approx([2.0, -1.0, 1.5], abs=2e-3)
        assert after.odometry.T_odom_base.xyt == pytest.approx(before.odometry.T_odom_base.xyt, abs=1e-3)
        # The sweep in which it was carried gives no scan; the next is of the new place alone.
        assert after.scan is None
        for _ in range(6):
            after = simulator.step(Twist())
        assert after.scan is not None
        assert simulator.scan_truth.xyt == pytest.approx([2.0, -1.0, 1.5], abs=2e-3)
        for _ in range(30):
            after = simulator.step(Twist(0.1, 0.0))
        # Set down on its wheels: it drives on, in the new direction.
        assert simulator.truth.T_world_base.y > -1.0 + 0.08


def test_a_kidnap_into_a_wall_is_refused():
    faults = FaultConfig(kidnap=((1.0, 0.0, 0.0, 0.0),))
    with (
        Simulator(
            load_world("turtlebot3_world"), load_robot("burger"), SimConfig(sensors="clean", faults=faults)
        ) as simulator,
        pytest.raises(InputError, match="kidnap 0, 0: the robot would stand in an obstacle"),
    ):
        simulator.reset()


def test_slipping_wheels_turn_in_vain():
    faults = FaultConfig(slip=((1.0, 3.0, 0.5, 0.5), (4.0, 5.0, 0.5, 0.0)))
    config = SimConfig(sensors="clean", faults=faults)
    with Simulator(load_world("empty"), load_robot("burger"), config, 1) as simulator:
        start = simulator.reset().odometry.T_odom_base
        for _ in range(105):
            seen = simulator.step(Twist(0.1, 0.0))
        driven = float(simulator.truth.T_world_base.x)
        measured = float((start.inverse() @ seen.odometry.T_odom_base).x)
        assert measured - driven == pytest.approx(0.1, abs=0.01)
        for _ in range(60):
            seen = simulator.step(Twist(0.1, 0.0))
        # The left wheel lags: the robot turned left, and its odometry does not know.
        assert simulator.truth.T_world_base.yaw > 0.2
        assert abs(float(seen.odometry.T_odom_base.yaw)) < 0.02
