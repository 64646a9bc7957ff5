"""The poses of a lattice path, and the arcs that DWA considers, by hand-computed cases."""

import itertools
import math

import numpy as np
import pytest

from tests.helpers.planning_room import BURGER
from turtlebag.datasets.se2 import SE2
from turtlebag.datasets.types import Twist
from turtlebag.planners import lattice
from turtlebag.planners.control.controller import ramped
from turtlebag.planners.control.dwa import WAYS_EVERY, Dwa, DwaConfig, best_arc, numbers
from turtlebag.planners.costmap import Costmap, distance_field
from turtlebag.planners.grid_distance import grid_distance

RES = 0.05


def test_headings_are_all_directions_within_three_cells_in_order():
    steps = {(a, b) for a, b in itertools.product(range(-3, 4), repeat=2) if math.gcd(a, b) == 1}
    assert set(map(tuple, lattice.HEADINGS.tolist())) == steps
    assert np.all(np.diff(lattice.YAWS) > 0.0)
    assert np.diff([*lattice.YAWS, lattice.YAWS[0] + 2 * math.pi]).max() == pytest.approx(
        math.radians(18.435), abs=1e-3
    )
    np.testing.assert_allclose(lattice.YAWS, np.arctan2(*lattice.HEADINGS.T[::-1]))


def test_each_step_is_driven_as_its_state_says_or_else_forwards():
    k = {tuple(h): i for i, h in enumerate(lattice.HEADINGS.tolist())}
    points = np.array([[0.0, 0.0], [1.0, 0.0], [2.0, 0.0], [2.0, 1.0], [1.0, 1.0], [1.0, 1.0], [1.0, 2.0]])
    headings = np.array([-1, k[1, 0], k[-1, -3], -1, k[0, 1]])
    yaws = lattice.step_yaws(points, headings, 0.3, 2.0, False)
    # on to (2, 0) as told, up to (2, 1) backwards, then as it looks; no step keeps what is told
    expected = [0.0, 0.0, -0.5 * math.pi, math.pi, 0.5 * math.pi, 0.5 * math.pi]
    np.testing.assert_allclose(np.cos(yaws), np.cos(expected), atol=1e-9)
    np.testing.assert_allclose(np.sin(yaws), np.sin(expected), atol=1e-9)
    # a slip to the side keeps the heading the robot has there
    slipped = lattice.step_yaws(
        np.array([[0.0, 0.0], [0.3, 1.0], [0.6, 1.0], [1.0, 0.0]]),
        np.array([k[1, 0], k[1, 0]]),
        0.0,
        0.0,
        True,
    )
    np.testing.assert_allclose(slipped, [0.0, 0.0, 0.0], atol=1e-9)
    straight = lattice.step_yaws(
        np.array([[0.0, 0.0], [0.3, 1.0], [0.6, 1.0], [1.0, 0.0]]),
        np.array([k[1, 0], k[1, 0]]),
        0.0,
        0.0,
        False,
    )
    assert straight[0] == pytest.approx(math.atan2(1.0, 0.3))
    assert straight[2] == pytest.approx(math.atan2(-1.0, 0.4))


def test_poses_stand_along_the_drives_and_long_turns_are_said_step_by_step():
    kept = np.array([[0.0, 0.0], [1.0, 0.0], [1.0, 0.5]])
    headings = np.array([0.5, 0.0, 0.5 * math.pi, 1.0])
    poses = lattice.drive_poses(kept, headings, np.array([-0.5, 0.5 * math.pi, 1.0 - 0.5 * math.pi]), 0.3)
    expected = [
        (0.0, 0.0, 0.5), *[(0.25 * k, 0.0, 0.0) for k in (1, 2, 3)],
        *[(1.0, 0.25 * k, 0.5 * math.pi) for k in (0, 1)], (1.0, 0.5, 1.0),
    ]  # fmt: skip
    np.testing.assert_allclose(poses.xyt, expected, atol=1e-9)
    long = 0.5 * math.pi - 2.0 * math.pi
    turned = lattice.drive_poses(
        kept[:2], np.array([0.5, 0.0, -1.0]), np.array([-0.5 + 2 * math.pi, 0.0]), 1.0
    )
    np.testing.assert_allclose(turned.xy, [[0, 0]] * 3 + [[1, 0]], atol=1e-9)
    step = (2 * math.pi - 0.5) / 3
    wanted = SE2.from_xyt(np.zeros(4), np.zeros(4), np.array([0.5, 0.5 + step, 0.5 + 2 * step, -1.0]))
    np.testing.assert_allclose(turned.yaw, wanted.yaw, atol=1e-9)
    corner = lattice.drive_poses(kept, headings, np.array([-0.5, long, 1.0 - 0.5 * math.pi]), 9.0)
    np.testing.assert_allclose(corner.xy[1:4], [[1, 0]] * 3, atol=1e-9)


def test_the_inscribed_radius_reaches_from_the_base_to_the_nearest_edge():
    assert lattice.inscribed_radius(BURGER.footprint) == pytest.approx(0.041)
    assert lattice.inscribed_radius(BURGER.footprint - [-0.032, 0.0]) == pytest.approx(0.073)


def dwa(**window):
    controller = Dwa(BURGER, DwaConfig(), 0.1)
    controller.window = controller.window._replace(**window)
    return controller


def test_dwa_looks_at_the_floor_with_room_to_turn_and_else_with_less():
    lethal = np.zeros((60, 60), dtype=bool)
    lethal[30, :] = True
    lethal[30, 21:27] = False  # 30 cm: too narrow to turn in
    T = SE2.from_xyt(1.0, -1.0, 0.4)
    costmap = Costmap(lethal, RES, T)
    path = T @ SE2.from_xyt(np.full(5, 1.22), np.linspace(0.72, 2.32, 5), np.zeros(5))
    controller = dwa()
    for y, tight in ((0.7, True), (2.0, False)):
        controller.set_path(path)
        floor = controller.floor(T @ SE2.from_xyt(1.2, y, 0.0), costmap)
        s = controller.samples
        radius = s.inscribed + 0.08 if tight else s.circumscribed + 0.04
        expected = grid_distance(costmap.clearance > radius, 46, 24, np.inf) * np.float32(RES)
        np.testing.assert_array_equal(floor.to_goal, expected)
        on = np.zeros((60, 60), dtype=bool)
        on[[14, 22, 30, 38, 46], 24] = True
        np.testing.assert_array_equal(floor.to_path, distance_field(on, RES))
        assert floor.clearance is costmap.clearance
    # Ways are computed once for a path and a costmap, wherever the robot has got to.
    for _ in range(WAYS_EVERY + 1):
        assert controller.floor(T @ SE2.from_xyt(1.2, 0.7, 0.0), costmap).to_goal is floor.to_goal
    assert controller.floor(T, Costmap(lethal, RES, SE2(T.xyt.copy()))).to_goal is not floor.to_goal


def test_dwa_sees_obstacles_at_once_and_computes_the_ways_round_them_from_time_to_time():
    controller, T = dwa(), SE2.identity()
    controller.set_path(SE2.from_xyt(np.array([0.5, 2.5]), np.array([1.5, 1.5]), np.zeros(2)))
    lethal = np.zeros((60, 60), dtype=bool)
    ways = controller.floor(T, Costmap(lethal, RES, T)).to_goal
    for k in range(2 * WAYS_EVERY):
        lethal = lethal.copy()
        lethal[20 + k, 20] = True
        costmap = Costmap(lethal, RES, T)
        floor = controller.floor(T, costmap)
        assert floor.clearance is costmap.clearance
        assert (floor.to_goal is not ways) == ((k + 1) % WAYS_EVERY == 0)
        ways = floor.to_goal


def test_dwa_takes_what_lies_beyond_the_floor_for_its_edge():
    controller, costmap = dwa(), Costmap(np.zeros((20, 30), dtype=bool), RES, SE2.identity())
    controller.set_path(SE2.from_xyt(np.array([0.51, -0.3, 9.0]), np.array([0.01, 0.51, 9.0]), np.zeros(3)))
    floor = controller.floor(SE2.from_xyt(0.5, 0.5, 0.0), costmap)
    on = np.zeros((20, 30), dtype=bool)
    on[[0, 10, 19], [10, 0, 29]] = True
    np.testing.assert_array_equal(floor.to_path, distance_field(on, RES))


def test_dwa_takes_the_best_of_the_speeds_its_window_opens_and_zero_among_them():
    controller = dwa(time=0.5, vx_samples=5, vth_samples=4, min_v=-0.1)
    costmap = Costmap(np.zeros((60, 60), dtype=bool), RES, SE2.from_xyt(0.5, 0.0, 0.1))
    controller.set_path(SE2.from_xyt(np.array([1.0, 2.5]), np.array([1.0, 1.5]), np.zeros(2)))
    limits = controller.limits
    near = dwa(settle_distance=0.1)
    near.set_path(SE2.from_xyt(np.array([1.0, 1.7]), np.array([1.2, 1.2]), np.zeros(2)))

    def best(one, pose, last, ahead):
        """The best arc of all that are tried, as the robot can follow it."""
        weights = numbers(DwaConfig(), BURGER)[1]._replace(braking=0.8 * limits.max_dv, ahead=ahead)
        at = tuple((costmap.T_grid_map @ pose).xyt.tolist())
        arc = best_arc(one.floor(pose, costmap), one.samples, at, *one.speeds(last), weights)
        return ramped(Twist(*arc), last, limits)

    pose = SE2.from_xyt(1.5, 1.2, 0.3)
    for last, lowest in ((Twist(0.05, 0.3), -0.1), (Twist(0.22, -1.9), -0.1)):
        vs = np.linspace(
            max(last.v - 0.5 * limits.max_dv, lowest), min(last.v + 0.5 * limits.max_dv, 0.22), 5
        )
        ws = np.linspace(max(last.w - 0.5 * limits.max_dw, -2.0), min(last.w + 0.5 * limits.max_dw, 2.0), 4)
        found = controller.speeds(last)
        np.testing.assert_allclose(found[0], np.union1d(vs, [0.0] if vs[0] < 0.0 < vs[-1] else []))
        np.testing.assert_allclose(found[1], np.union1d(ws, [0.0]))
        assert controller.command(pose, last, costmap) == best(controller, pose, last, 0.325) != Twist()
    # So near the goal the point ahead of the robot would lie beyond it.
    assert near.command(pose, Twist(), costmap) == best(near, pose, Twist(), 0.0)
    assert near.state == "follow"
    near.command(SE2.from_xyt(1.65, 1.2, 0.0), Twist(), costmap)
    assert near.state == "settle"
    near.command(pose, Twist(), costmap)
    assert near.state == "follow"
    assert dwa().command(SE2.identity(), Twist(0.2, 0.0), costmap) == Twist(0.2 - 0.1 * BURGER.max_dv, 0.0)
