"""What a robot with two lidars sees around it."""

import math

import numpy as np
import pytest

from turtlebag.datasets.se2 import SE2
from turtlebag.datasets.types import LidarSpec, Observation, Odometry, Scan, Twist
from turtlebag.pipeline.navigation.obstacle_memory import ObstacleMemory
from turtlebag.pipeline.navigation.sensing import Sensing
from turtlebag.sim.robots import load_robot

HALF = LidarSpec(181, -math.pi / 2, math.pi / 180.0, 0.12, 8.0)
REAR = SE2.from_xyt(-0.2, 0.0, math.pi)
TICK_NS = 100_000_000


def observed(sensing, tick, sensor=None, ranges=2.0):
    scan = None
    if sensor is not None:
        scan = Scan(tick * TICK_NS, np.full(HALF.n_beams, ranges, dtype=np.float32), HALF, sensor)
    odometry = Odometry(tick * TICK_NS, SE2.identity(), Twist())
    return sensing.observe(Observation(tick * TICK_NS, odometry, None, scan))


def test_what_is_near_is_near_whichever_lidar_saw_it_last():
    sensing = Sensing(SE2.identity(), [REAR])
    observed(sensing, 0, 0, 2.0)
    rear = observed(sensing, 1, 1, 0.5)
    np.testing.assert_allclose(rear.T_odom_lidar.xyt, REAR.xyt)
    assert rear.hits_odom[90] == pytest.approx([-0.7, 0.0])
    assert len(rear.hits_odom) == HALF.n_beams
    points = sensing.points_base(SE2.identity())
    assert len(points) == 2 * HALF.n_beams
    assert points[:, 0].max() == pytest.approx(2.0)
    assert points[:, 0].min() == pytest.approx(-0.7)
    # the rear lidar sees both sides, and nothing in front
    assert (rear.sectors.left, rear.sectors.front, rear.sectors.right) == (0.5, 2.0, 0.5)
    front = observed(sensing, 2, 0, 3.0)
    assert (front.sectors.left, front.sectors.front) == (0.5, 3.0)
    assert len(front.around_odom) == 2 * HALF.n_beams


def test_a_robot_is_blind_when_one_of_its_lidars_is():
    sensing = Sensing(SE2.identity(), [REAR])
    for tick in range(12):
        observed(sensing, tick, 0)
        observed(sensing, tick)
    assert sensing.blind
    assert sensing.silent_s == pytest.approx(1.1)
    observed(sensing, 12, 1)
    assert not sensing.blind


def test_what_moves_is_judged_by_scans_of_one_lidar():
    sensing, memory = Sensing(SE2.identity(), [REAR]), ObstacleMemory(load_robot("burger").model)
    for tick in range(20):
        # each sees its own half of a room that does not move, the rear one a nearer wall
        memory.observe(observed(sensing, tick, tick % 2, (3.0, 0.6)[tick % 2]))
        assert len(memory.moving_odom) == 0
    memory.observe(observed(sensing, 20, 0, 2.0))
    nearer = len(memory.moving_odom)
    assert nearer > 0.5 * HALF.n_beams
    memory.observe(observed(sensing, 21, 1, 0.6))
    assert len(memory.moving_odom) == nearer
