"""The small types, by known answers."""

import math

import numpy as np
import pytest

from tests.helpers.planning_room import BURGER
from turtlebag.datasets import se3
from turtlebag.datasets.grid import OccupancyGrid
from turtlebag.datasets.se2 import SE2
from turtlebag.datasets.trajectories import load_tum, save_tum_3d
from turtlebag.datasets.types import LidarSpec, Recording3D, Trajectory, yaw_difference


def test_a_robot_s_inner_and_outer_circle():
    assert BURGER.inscribed_radius == pytest.approx(0.041)
    assert BURGER.circumscribed_radius == pytest.approx(math.hypot(0.105, 0.105))


def test_a_trajectory_has_a_length_and_a_duration():
    path = Trajectory(
        np.array([5, 7, 4]) * 10**9, SE2.from_xyt([0.0, 3.0, 3.0], [0.0, 4.0, 5.0], [0.0, 1.0, 2.0])
    )
    assert path.length() == pytest.approx(6.0)
    assert path.duration() == pytest.approx(3.0)
    assert Recording3D("x", path.stamps_ns, [], np.eye(4)).duration() == pytest.approx(3.0)
    nothing = Trajectory(np.zeros(0, dtype=np.int64), SE2(np.zeros((0, 3))))
    assert nothing.duration() == 0.0


def test_the_extent_of_a_grid_is_that_of_its_cells():
    grid = OccupancyGrid(np.zeros((20, 30), dtype=np.int8), 0.1, SE2.from_xyt(-1.0, 2.0, 0.0))
    assert grid.extent() == pytest.approx((-1.0, 2.0, 2.0, 4.0))


@pytest.mark.parametrize(
    ("a", "b", "between"), [(3.1, -3.1, 2 * math.pi - 6.2), (1.0, -1.0, 2.0), (0.5, 0.7, 0.2)]
)
def test_yaws_differ_by_the_shorter_way(a, b, between):
    assert float(yaw_difference(np.array(a), np.array(b))) == pytest.approx(between)


def turned(yaw, x):
    T = np.eye(4)
    T[:2, :2] = [[math.cos(yaw), -math.sin(yaw)], [math.sin(yaw), math.cos(yaw)]]
    T[0, 3] = x
    return T


def test_half_way_along_a_screw_in_space_twice_is_the_whole():
    a, b = turned(0.3, 1.0), turned(1.5, 2.0)
    b[2, 3] = 0.5
    (half,) = se3.interpolate(a[None], b[None], np.array([0.5]))
    step = se3.inverse(a) @ half
    np.testing.assert_allclose(half @ step, b, atol=1e-9)
    np.testing.assert_allclose(se3.interpolate(a[None], b[None], np.array([0.0]))[0], a, atol=1e-12)


def test_poses_in_space_are_written_with_place_and_quaternion(tmp_path):
    poses = np.stack([turned(0.0, 1.0), turned(math.pi / 2, -2.0)])
    poses[:, 2, 3] = 0.25
    save_tum_3d(np.array([10**9, 2 * 10**9 + 5]), poses, tmp_path / "t.tum")
    rows = np.loadtxt(tmp_path / "t.tum")
    np.testing.assert_allclose(rows[1], [2.0, -2.0, 0.0, 0.25, 0.0, 0.0, 0.5**0.5, 0.5**0.5], atol=1e-8)
    read = load_tum(tmp_path / "t.tum")
    np.testing.assert_allclose(read.poses.xyt, [[1.0, 0.0, 0.0], [-2.0, 0.0, math.pi / 2]], atol=1e-9)
    assert read.stamps_ns.tolist() == [10**9, 2 * 10**9 + 5]


@pytest.mark.parametrize(
    ("first", "increment", "order"),
    [
        (0, 0.1, [0, 1, 2, 3]),
        (3, 0.1, [1, 2, 3, 0]),
        (0, -0.1, [3, 2, 1, 0]),
        (3, -0.1, [2, 1, 0, 3]),
        (0, 0.0, [0, 1, 2, 3]),
    ],
)
def test_beams_are_taken_from_the_first_one_on_in_either_direction(first, increment, order):
    lidar = LidarSpec(4, 0.0, 1.5, 0.1, 4.0, increment, 0.4, first)
    assert lidar.order.tolist() == order
    np.testing.assert_allclose(lidar.shares, np.array(order) / 3.0)
    assert lidar.sweep_s == pytest.approx(3.0 * abs(increment))


@pytest.mark.parametrize("first", [-1, 4])
def test_the_first_beam_is_one_of_them(first):
    with pytest.raises(ValueError, match="cannot be the first"):
        LidarSpec(4, 0.0, 1.5, 0.1, 4.0, first_beam=first)
