from dataclasses import replace

import numpy as np
import pytest

from tests.helpers.planning_room import BURGER, room
from turtlebag.datasets.se2 import SE2, wrap
from turtlebag.datasets.types import Twist
from turtlebag.planners.control.along_path import arc_lengths, point_at, project
from turtlebag.planners.control.collision_monitor import (
    CollisionMonitor,
    depth_inside,
    free_time,
    moved,
    padded,
)
from turtlebag.planners.control.controller import SpeedLimits, ramped, slowed
from turtlebag.planners.control.dwa import Dwa, DwaConfig, numbers
from turtlebag.planners.control.goal_checker import GoalChecker, GoalCheckerConfig
from turtlebag.planners.control.pursuit import Pursuit
from turtlebag.planners.costmap import CostmapConfig, costmap_from_grid
from turtlebag.planners.smoothing import densify, with_headings
from turtlebag.sim.robots import load_robot

DT = 1.0 / 30.0
LIMITS = SpeedLimits(0.22, 1.5, 0.8, 3.0, DT)


def follow(controller, start: SE2, path: SE2, seconds: float, costmap):
    """A perfect unicycle under the controller: poses and commands."""
    controller.set_path(path)
    pose, last = start, Twist()
    poses, commands = [pose.xyt], []
    for _ in range(round(seconds / DT)):
        last = controller.command(pose, last, costmap)
        pose = SE2.from_xyt(*moved(*pose.xyt.tolist(), last.v, last.w, DT))
        poses.append(pose.xyt)
        commands.append((last.v, last.w))
        if controller.state == "arrived" and last == Twist():
            break
    return np.array(poses), np.array(commands)


def big_room():
    return costmap_from_grid(room(rows=200, cols=200), CostmapConfig())


@pytest.mark.parametrize("goal_yaw", [-3.0, -1.5, 0.0, 1.5, 3.1])
def test_pursuit_settles_on_position_and_heading(goal_yaw):
    costmap = big_room()
    corner = np.array([[1.0, 1.0], [3.0, 1.0], [3.0, 2.5]])
    path = with_headings(densify(corner, 0.05), 0.0, goal_yaw)
    poses, commands = follow(Pursuit(BURGER, DT), SE2.from_xyt(1.0, 1.0, 2.0), path, 60.0, costmap)
    assert np.linalg.norm(poses[-1, :2] - [3.0, 2.5]) < 0.03
    assert abs(wrap(poses[-1, 2] - goal_yaw)) < 0.03
    assert np.abs(commands[:, 0]).max() <= BURGER.max_v + 1e-9
    assert np.abs(np.diff(commands[:, 0], prepend=0.0)).max() <= 0.8 * BURGER.max_dv * DT + 1e-9
    # It cuts the corner by less than its least look-ahead.
    d = np.minimum(np.abs(poses[:, 1] - 1.0), np.abs(poses[:, 0] - 3.0))
    assert d.max() < 0.2


def test_pursuit_returns_to_a_path_it_stands_beside():
    path = SE2.from_xyt(np.linspace(1.0, 5.0, 50), np.full(50, 2.0), np.zeros(50))
    poses, _ = follow(Pursuit(BURGER, DT), SE2.from_xyt(1.0, 2.3, 0.0), path, 60.0, big_room())
    late = poses[np.searchsorted(poses[:, 0], 2.5) :]
    assert np.abs(late[:, 1] - 2.0).max() < 0.02


@pytest.mark.parametrize("radius", [0.6, 1.0, -0.8])
def test_pursuit_on_a_circle_steers_its_curvature(radius):
    turn = np.linspace(0.0, 2.0, 200)
    path = SE2.from_xyt(4.0 + abs(radius) * np.sin(turn), 4.0 + radius * (1.0 - np.cos(turn)), turn)
    pursuit = Pursuit(BURGER, DT)
    pursuit.set_path(path)
    costmap = big_room()
    # turned to the path it follows it, and goes on to when it has turned further
    command = pursuit.command(SE2.from_xyt(4.0, 4.0, 0.1 / radius), Twist(), costmap)
    for _ in range(60):
        command = pursuit.command(SE2.from_xyt(4.0, 4.0, 0.0), command, costmap)
    assert pursuit.state == "follow"
    assert command.v > 0.1
    assert command.w / command.v == pytest.approx(1.0 / radius, rel=0.02)


def test_ramping_keeps_the_limits_and_the_curvature():
    step = ramped(Twist(0.2, 0.4), Twist(), LIMITS)
    assert step.v == pytest.approx(0.8 * DT)
    assert step.w == pytest.approx(2.0 * step.v)
    stop = ramped(Twist(), Twist(0.2, 0.0), LIMITS)
    assert stop.v == pytest.approx(0.2 - 0.8 * DT)
    assert ramped(Twist(0.3, 9.0), Twist(0.22, 1.5), LIMITS) == Twist(0.22, 1.5)


@pytest.mark.parametrize("factor", [0.0, 0.1, 0.5])
def test_a_robot_that_is_slowed_down_keeps_to_its_arc(factor):
    """It was known to be able to stop along that arc; the tangent may lead into something."""
    jackal = load_robot("jackal").model
    controller, last, wanted = Pursuit(jackal, DT), Twist(1.3, -0.8), Twist(1.3, -0.8)
    pose = SE2.identity()
    while last.v > factor * wanted.v + 1e-9:
        last = slowed(controller, wanted, factor, last)
        pose = SE2.from_xyt(*moved(*pose.xyt.tolist(), last.v, last.w, DT))
    off_m = np.hypot(pose.x, pose.y + 1.3 / 0.8) - 1.3 / 0.8
    assert float(pose.x) > 0.25
    assert abs(off_m) < 1e-6
    assert last.w == pytest.approx(factor * wanted.w)


def test_braking_to_a_standstill_keeps_to_the_arc():
    limits = SpeedLimits(2.0, 3.0, 2.0, 6.0, DT)
    last = Twist(1.3, -0.8)
    while last.v > 0.0:
        last, before = ramped(Twist(), last, limits), last
        assert last.w == pytest.approx(before.w * last.v / before.v)
    assert ramped(Twist(), Twist(0.0, -0.8), limits).w == pytest.approx(-0.6)


def test_projection_and_lookahead_on_a_bent_path():
    points = np.array([[0.0, 0.0], [1.0, 0.0], [1.0, 1.0]])
    lengths = arc_lengths(points)
    assert project(points, lengths, 0.4, 0.3, 0.0, 2.0) == pytest.approx((0.4, 0.3))
    assert project(points, lengths, 1.2, 0.5, 0.0, 2.0) == pytest.approx((1.5, 0.2))
    assert point_at(points, lengths, 1.25) == pytest.approx((1.0, 0.25))
    assert point_at(points, lengths, 9.0) == pytest.approx((1.0, 1.0))


def test_padding_moves_every_edge_out_by_as_much():
    grown = padded(BURGER.footprint, 0.02)
    np.testing.assert_allclose(grown.min(axis=0), BURGER.footprint.min(axis=0) - 0.02)
    np.testing.assert_allclose(grown.max(axis=0), BURGER.footprint.max(axis=0) + 0.02)


def test_depth_in_a_polygon():
    assert depth_inside(BURGER.footprint, 0.0, 0.0) == pytest.approx(0.041)
    assert depth_inside(BURGER.footprint, 0.141, 0.0) == pytest.approx(-0.1)


@pytest.mark.slow
@pytest.mark.parametrize(("v", "w"), [(0.2, 0.0), (0.2, 0.5), (-0.1, 0.3), (0.0, 1.0)])
def test_free_time_matches_plain_simulation(v, w):
    rng = np.random.default_rng(4)
    polygon = padded(BURGER.footprint, 0.02)
    for _ in range(25):
        point = rng.uniform(-0.4, 0.4, 2)
        if depth_inside(polygon, *point) > 0.0:
            continue
        found = free_time(point[None], polygon, 0.2, v, w, 1.5, 0.01)
        hit = 1.5
        for t in np.linspace(0.0, 1.5, 301):
            pose = SE2.from_xyt(*moved(0.0, 0.0, 0.0, v, w, t))
            if depth_inside(polygon, *(pose.inverse() @ point)) > 0.0:
                hit = t
                break
        assert found == pytest.approx(hit, abs=0.026)


def test_the_monitor_stops_before_a_wall_and_lets_the_robot_leave_it():
    monitor = CollisionMonitor(BURGER)
    wall = np.stack([np.full(40, 0.075), np.linspace(-0.3, 0.3, 40)], axis=1)
    assert monitor.limit(Twist(0.22, 0.0), wall) < 0.5
    assert monitor.limit(Twist(-0.1, 0.0), wall) == 1.0
    assert monitor.limit(Twist(0.22, 0.0), wall + np.array([0.4, 0.0])) == 1.0
    touching = np.array([[0.05, 0.0]])
    assert monitor.limit(Twist(0.1, 0.0), touching) == 0.0
    assert monitor.limit(Twist(-0.1, 0.0), touching) == 1.0


def test_a_robot_under_the_monitor_never_drives_into_a_wall():
    monitor = CollisionMonitor(BURGER)
    x, last = 0.0, Twist()
    hard = SpeedLimits(0.22, 1.5, 1.0, 3.0, DT)
    for _ in range(300):
        wall = np.stack([np.full(60, 1.0 - x), np.linspace(-0.3, 0.3, 60)], axis=1)
        last = ramped(Twist(0.22 * monitor.limit(Twist(0.22, 0.0), wall), 0.0), last, hard)
        x += last.v * DT
    assert 0.8 < x < 1.0 - 0.041


def test_the_goal_checker_wants_position_heading_standstill_and_time():
    goal = SE2.from_xyt(1.0, 1.0, 0.5)
    checker = GoalChecker(GoalCheckerConfig(hold=0.3), goal)
    inside, still = SE2.from_xyt(1.02, 1.0, 0.53), Twist()
    assert not checker.reached(0, inside, still)
    assert not checker.reached(200_000_000, inside, still)
    # Hysteresis: a little outside again is still counted, far outside is not.
    assert checker.reached(300_000_000, SE2.from_xyt(1.034, 1.0, 0.5), still)
    assert not checker.reached(400_000_000, SE2.from_xyt(1.05, 1.0, 0.5), still)
    assert not checker.reached(10**9, inside, Twist(0.1, 0.0))
    assert not checker.reached(2 * 10**9, SE2.from_xyt(1.0, 1.0, 0.6), still)


def test_the_tutorials_tolerances_are_a_preset():
    checker = GoalChecker(GoalCheckerConfig(preset="tutorial", hold=0.0), SE2.from_xyt(0.0, 0.0, 0.0))
    assert checker.reached(0, SE2.from_xyt(0.045, 0.0, 0.16), Twist())


@pytest.mark.slow
@pytest.mark.parametrize("goal_yaw", [-1.5, 3.1])
def test_dwa_goes_round_a_block_that_the_path_does_not_know_and_settles(goal_yaw):
    costmap = big_room()
    block = np.zeros_like(costmap.lethal)
    block[95:105, 75:85] = True
    costmap = costmap.with_lethal(block)
    # The straight path leads through the block at x = 2.75..3.25, y = 4.25..4.75 (map frame).
    line = densify(np.array([[1.0, 4.4], [5.0, 4.4]]), 0.05)
    assert costmap.clearance_at(line).min() == 0.0
    controller = Dwa(BURGER, DwaConfig(), DT)
    poses, commands = follow(
        controller, SE2.from_xyt(1.0, 4.4, 0.0), with_headings(line, 0.0, goal_yaw), 90.0, costmap
    )
    assert np.linalg.norm(poses[-1, :2] - [5.0, 4.4]) < 0.03
    assert abs(wrap(poses[-1, 2] - goal_yaw)) < 0.03
    assert costmap.clearance_at(poses[:, :2]).min() > 0.105
    assert np.abs(np.diff(commands[:, 0], prepend=0.0)).max() <= 0.8 * BURGER.max_dv * DT + 1e-9


def test_dwa_settles_on_the_goal_once_it_is_near():
    costmap = big_room()
    line = densify(np.array([[1.0, 4.4], [5.0, 4.4]]), 0.05)
    controller = Dwa(BURGER, DwaConfig(), DT)
    controller.set_path(with_headings(line, 0.0, 0.0))
    for x, state in ((4.54, "follow"), (4.56, "settle"), (4.5, "follow")):
        controller.command(SE2.from_xyt(x, 4.4, 0.0), Twist(), costmap)
        assert controller.state == state


@pytest.mark.parametrize("robot", ["burger", "waffle_pi"])
def test_no_obstacle_of_a_cell_slips_between_the_points_that_dwa_looks_at(robot):
    samples = Dwa(load_robot(robot).model, DwaConfig(), DT).samples
    outline = samples.points[: samples.outline]
    assert np.linalg.norm(outline - np.roll(outline, 1, axis=0), axis=1).max() <= 0.05


def test_pursuit_that_was_settling_turns_to_the_path_when_it_is_elsewhere():
    far = SE2.from_xyt(np.linspace(1.0, 5.0, 50), np.full(50, 2.0), np.zeros(50))
    near = SE2.from_xyt(np.linspace(4.9, 5.0, 5), np.full(5, 2.0), np.zeros(5))
    pursuit = Pursuit(BURGER, DT)
    pursuit.set_path(near)
    pursuit.command(near[3], Twist(), big_room())
    assert pursuit.state == "settle"
    pursuit.set_path(near)
    pursuit.command(near[3], Twist(), big_room())
    assert pursuit.state == "settle"
    # The same goal, and the robot finds that it is four metres from it.
    pursuit.set_path(far)
    assert pursuit.state == "turn"


def test_dwa_turns_round_rather_than_driving_a_long_way_backwards():
    costmap, fast = big_room(), replace(BURGER, max_v=2.0, max_w=3.0, max_dv=2.5, max_dw=6.0)
    line = densify(np.array([[5.0, 4.4], [1.0, 4.4]]), 0.05)
    path = with_headings(line, 0.0, 3.1)
    share = {}
    for bias in (1.5, 0.0):
        controller = Dwa(fast, DwaConfig(), DT)
        assert controller.weights.back == 1.5
        controller.weights = controller.weights._replace(back=bias)
        poses, commands = follow(controller, SE2.from_xyt(5.0, 4.4, 0.0), path, 60.0, costmap)
        share[bias] = float((commands[:, 0] < -0.1).mean())
        assert np.linalg.norm(poses[-1, :2] - [1.0, 4.4]) < 0.05
    assert share[1.5] < 0.15 < share[0.0]


@pytest.mark.slow
def test_the_tutorials_dwa_numbers_are_a_preset_within_the_robots_own_acceleration():
    burger, costs = numbers(DwaConfig(preset="tutorial"), BURGER)
    assert (costs.time, burger.vx_samples, burger.vth_samples) == (1.5, 20, 40)
    assert (costs.path, costs.goal, costs.occupied) == (32.0, 20.0, 0.02)
    assert (costs.least_v, costs.least_w) == (pytest.approx(0.11), 1.37)
    _, slow = numbers(DwaConfig(preset="tutorial"), replace(BURGER, max_v=0.26, max_w=1.82))
    assert (slow.time, slow.least_v, slow.least_w) == (2.0, pytest.approx(0.13), 0.9)
    controller = Dwa(BURGER, DwaConfig(preset="tutorial"), DT)
    assert controller.limits.max_v == 0.22
    assert controller.limits.max_dv <= BURGER.max_dv
    line = densify(np.array([[1.0, 4.4], [5.0, 4.4]]), 0.05)
    poses, commands = follow(
        controller, SE2.from_xyt(1.0, 4.4, 0.0), with_headings(line, 0.0, 0.0), 60.0, big_room()
    )
    assert np.linalg.norm(poses[-1, :2] - [5.0, 4.4]) < 0.05
    assert np.abs(np.diff(commands[:, 0], prepend=0.0)).max() <= BURGER.max_dv * DT + 1e-9


@pytest.mark.parametrize(("x", "v_sign"), [(3.92, 1.0), (4.08, -1.0)])
@pytest.mark.parametrize("aside", [-0.01, 0.0, 0.01])
def test_pursuit_settles_forwards_from_before_the_goal_and_backwards_from_beyond_it(x, v_sign, aside):
    path = SE2.from_xyt(np.linspace(3.9, 4.0, 5), np.full(5, 4.0), np.zeros(5))
    pursuit, costmap, command = Pursuit(BURGER, DT), big_room(), Twist()
    pursuit.set_path(path)
    for _ in range(10):
        command = pursuit.command(SE2.from_xyt(x, 4.0 + aside, 0.0), command, costmap)
    assert pursuit.state == "settle"
    assert v_sign * command.v > 0.02
    # to the left of the goal it steers right when driving on, and left when backing up
    assert np.sign(command.w) == -np.sign(aside) * v_sign


def test_pursuit_looks_as_far_ahead_as_its_speed_asks_and_less_beside_a_wall():
    """5 cm beside a straight path at full speed: the arc to the point 1.3 s ahead, if there is room."""
    prompt, costmap, steering = replace(BURGER, max_dv=1e3, max_dw=1e4), big_room(), []
    for y in (4.0, -0.4):
        path = SE2.from_xyt(np.linspace(1.0, 7.0, 100), np.full(100, y), np.zeros(100))
        pursuit, last = Pursuit(prompt, DT), Twist(BURGER.max_v, 0.0)
        pursuit.set_path(path)
        pursuit.command(SE2.from_xyt(2.0, y + 0.01, 0.0), last, costmap)
        assert pursuit.state == "follow"
        command = pursuit.command(SE2.from_xyt(2.0, y + 0.05, 0.0), last, costmap)
        steering.append(command.w / command.v)
    reach = 1.3 * BURGER.max_v
    assert steering[0] == pytest.approx(-2.0 * 0.05 / (reach**2 + 0.05**2), rel=0.02)
    assert steering[1] < 1.2 * steering[0]
