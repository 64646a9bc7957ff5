"""What odometry and map say of the wheels, on made paths."""

import numpy as np
import pytest

from turtlebag.datasets.se2 import SE2
from turtlebag.datasets.types import LidarSpec, MountedLidar, Recording
from turtlebag.pipeline.identify.wheels import wheel_findings
from turtlebag.pipeline.stages.identify import tell_of
from turtlebag.sim.robots import load_robot


def path(yaw, step_m):
    """A path with these headings (n,), driven at one speed."""
    ahead = 0.5 * (yaw[1:] + yaw[:-1])
    xy = np.cumsum(step_m * np.stack([np.cos(ahead), np.sin(ahead)]), axis=1)
    return SE2.from_xyt(*np.column_stack([np.zeros(2), xy]), yaw)


def log(odom, lidars=()):
    n = len(odom)
    stamps = np.arange(n) * 200_000_000
    lidar = LidarSpec(4, 0.0, 0.5, 0.1, 5.0, 0.0, 0.2)
    ranges = np.full((n, 4), 2.0, np.float32)
    return Recording("log", stamps, ranges, lidar, SE2.identity(), odom, topic="/front", others=lidars)


def headings(n=3000):
    """Turns to and fro, of some seconds each."""
    rng = np.random.default_rng(4)
    rates = np.repeat(rng.uniform(-0.8, 0.8, n // 15 + 1), 15)[:n]
    return np.cumsum(0.2 * rates)


def test_the_scale_of_the_turns_is_found():
    yaw = headings()
    noise = np.random.default_rng(5).normal(0.0, 1e-3, len(yaw))
    found = wheel_findings(log(path(yaw / 1.04, 0.05)), path(yaw + noise, 0.05), load_robot("burger").wheels)
    scale = next(one for one in found.estimates if one.name == "turn_scale")
    assert scale.value == pytest.approx(1.04, abs=0.003)
    assert scale.sigma < 0.005


def test_headings_that_go_astray_in_turns_and_come_back_are_no_scale():
    """Of each turn a tenth is missing at first and comes back within seconds, as in MIT's CSAIL log."""
    yaw, lag = headings(), np.zeros(3000)
    for k in range(1, len(yaw)):
        lag[k] = 0.75 * lag[k - 1] + 0.1 * (yaw[k] - yaw[k - 1])
    noise = np.random.default_rng(5).normal(0.0, 1e-3, len(yaw))
    found = wheel_findings(log(path(yaw - lag, 0.05)), path(yaw + noise, 0.05), load_robot("burger").wheels)
    scale = next(one for one in found.estimates if one.name == "turn_scale")
    low, high = scale.interval_95
    assert low < 1.0 < high
    assert high - low < 0.1


def test_which_of_several_lidars_is_identified_is_said_in_a_line(caplog):
    rear = MountedLidar(log(path(headings(50), 0.05)).lidar, SE2.identity(), "/rear")
    with caplog.at_level("INFO", logger="turtlebag"):
        tell_of(log(path(headings(50), 0.05), (rear,)))
    assert "/front" in caplog.text
    assert "--topic /rear" in caplog.text


def test_a_lidar_that_sweeps_the_other_way_is_simulated_that_way():
    lidar = load_robot("burger").lidar.model_copy(update={"sweep": -0.8})
    spec = lidar.spec(turning=True)
    assert spec.time_increment < 0.0
    assert (spec.shares[0], spec.shares[-1]) == (1.0, 0.0)
