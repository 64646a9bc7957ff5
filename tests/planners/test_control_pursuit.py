"""Pure pursuit by its formulas, for a robot that follows every command at once."""

import math
from dataclasses import replace

import numpy as np
import pytest

from tests.helpers.planning_room import BURGER, room
from turtlebag.datasets.se2 import SE2, wrapped
from turtlebag.datasets.types import Twist
from turtlebag.planners.control.collision_monitor import CollisionMonitor, free_time, moved, padded
from turtlebag.planners.control.controller import Ramped, SpeedLimits, ramped
from turtlebag.planners.control.goal_checker import GoalChecker, GoalCheckerConfig
from turtlebag.planners.control.pursuit import (
    LOOKAHEAD_M,
    LOOKAHEAD_S,
    MAX_LATERAL,
    NEAR_M,
    SLOWEST,
    TURN_FIRST_RAD,
    TURNED_RAD,
    Pursuit,
    grid_pose,
    regulated_speed,
    turning_speed,
)
from turtlebag.planners.costmap import Costmap, CostmapConfig, costmap_from_grid
from turtlebag.planners.footprint import footprint_clearance, sample_footprint
from turtlebag.planners.smoothing import path_length

DT = 0.05
PROMPT = replace(BURGER, max_v=0.5, max_w=2.0, max_dv=1e3, max_dw=1e5)
ROOM = costmap_from_grid(room(rows=200, cols=200), CostmapConfig())


def line(x0=1.0, x1=6.0, n=101, y=4.0):
    return SE2.from_xyt(np.linspace(x0, x1, n), np.full(n, y), np.zeros(n))


def following(poses=None):
    pursuit = Pursuit(PROMPT, DT)
    pursuit.set_path(line() if poses is None else poses)
    pursuit.state = "follow"
    return pursuit


@pytest.mark.parametrize("last_v", [0.0, 0.3, 0.5])
@pytest.mark.parametrize("off", [-0.06, 0.02])
def test_it_steers_the_arc_to_the_point_its_speed_looks_ahead_to(last_v, off):
    pursuit = following()
    reach = min(max(last_v * LOOKAHEAD_S, LOOKAHEAD_M[0]), LOOKAHEAD_M[1])
    found = pursuit.command(SE2.from_xyt(1.8, 4.0 + off, 0.1), Twist(last_v, 0.0), ROOM)
    bearing = math.atan2(-off, reach) - 0.1
    curvature = 2.0 * math.sin(bearing) / math.hypot(reach, off)
    assert found.w / found.v == pytest.approx(curvature)
    assert found.v == pytest.approx(regulated_speed(pursuit.limits, 9.0, curvature, pursuit.remaining()))
    assert pursuit.remaining() == pytest.approx(4.2)


def test_where_it_is_is_looked_for_from_a_little_behind_to_a_metre_ahead():
    out_and_back = np.vstack([line(1.0, 4.0, 61).xy, line(4.0, 1.0, 61, 4.1).xy])
    pursuit = following(SE2.from_xyt(*out_and_back.T, np.zeros(122)))
    length = pursuit.remaining()
    for x, y, along, off in (
        (2.0, 4.0, 1.0, 1e-6),
        (2.3, 4.1, 1.3, 1e-6),
        (1.0, 4.0, 1.3 - LOOKAHEAD_M[0], 0.06),
    ):
        pursuit.command(SE2.from_xyt(x, y, 0.0), Twist(0.2, 0.0), ROOM)
        assert length - pursuit.remaining() == pytest.approx(along, abs=off)


def test_it_turns_to_the_path_beyond_one_bearing_and_drives_on_below_another():
    pursuit = following()
    ahead = math.atan2(0.0, 1.0)
    for yaw, last, state in (
        (ahead - TURN_FIRST_RAD + 0.01, Twist(), "follow"),
        (ahead - TURN_FIRST_RAD - 0.01, Twist(), "turn"),
        (ahead + TURNED_RAD + 0.01, Twist(), "turn"),
        (ahead - TURNED_RAD + 0.01, Twist(), "follow"),
    ):
        found = pursuit.command(SE2.from_xyt(1.8, 4.0, yaw), last, ROOM)
        assert pursuit.state == state
        if state == "turn":
            assert (found.v, found.w) == (0.0, pytest.approx(turning_speed(pursuit.limits, -yaw)))
        else:
            assert found.v > 0.0
    # still rolling, it lets the turn die down first
    pursuit.state = "turn"
    pose = SE2.from_xyt(1.8, 4.0, 1.0)
    assert pursuit.command(pose, Twist(0.3, 0.4), ROOM) == Twist(0.0, 0.2)
    assert pursuit.command(pose, Twist(-0.011, 0.4), ROOM) == Twist(0.0, 0.2)
    assert pursuit.command(pose, Twist(0.01, 0.4), ROOM).w == turning_speed(pursuit.limits, -1.0)


def test_speed_is_the_least_that_curve_room_braking_and_turning_allow():
    limits, top = Pursuit(PROMPT, DT).limits, 0.5
    for room_m, curvature, remaining in (
        (9.0, 0.0, 3.0), (9.0, 1.0, 3.0), (9.0, -4.0, 3.0), (0.15, 0.0, 3.0), (0.01, 0.5, 3.0),
        (-1.0, 0.0, 3.0), (9.0, 0.0, 1e-4), (9.0, 60.0, 3.0), (9.0, -2.3, 3.0),
    ):  # fmt: skip
        bend = abs(curvature)
        v = min(top, math.sqrt(MAX_LATERAL / max(bend, 1e-6)))
        if room_m < NEAR_M:
            v = min(v, top * max(SLOWEST, room_m / NEAR_M))
        v = min(v, math.sqrt(1.2 * 0.8 * 1e3 * remaining), 2.0 / max(bend, 1e-6))
        assert regulated_speed(limits, room_m, curvature, remaining) == pytest.approx(v)
    fast = Pursuit(replace(PROMPT, max_v=2.0), DT).limits
    assert regulated_speed(fast, 9.0, 0.5, 3.0) == pytest.approx(math.sqrt(MAX_LATERAL / 0.5))


def test_a_new_path_keeps_the_state_where_it_leads_to_the_same_goal():
    for first, state, second, expected in (
        (line(), "follow", line(2.0), "follow"),
        (line(), "follow", line(1.0, 6.1), "turn"),
        (line(), "settle", line(), "turn"),
        (line(), "settle", line(5.9, 6.0), "turn"),
        (line(), "align", line(5.7, 6.1), "turn"),
    ):
        pursuit = Pursuit(PROMPT, DT)
        pursuit.set_path(first)
        pursuit.state = "follow"
        pursuit.command(SE2.from_xyt(1.9, 4.0, 0.0), Twist(), ROOM)
        assert pursuit.remaining() == pytest.approx(4.1)
        pursuit.state = state
        pursuit.set_path(second)
        assert pursuit.state == expected
        assert pursuit.remaining() == pytest.approx(path_length(second.xy))
    assert Pursuit(PROMPT, DT).remaining() == 0.0
    still = Pursuit(PROMPT, DT)
    assert still.command(SE2.identity(), Twist(), ROOM) == Twist()


def test_turning_is_fast_while_far_off_and_slow_enough_to_stop_on_the_mark():
    limits = Pursuit(replace(BURGER, max_w=1.0, max_dw=2.0), DT).limits
    for error in (3.0, 0.9, 0.5, 0.3, 0.15, 0.01, 0.001):
        size = min(1.0, 3.0 * error)
        assert turning_speed(limits, error) == pytest.approx(size)
        assert turning_speed(limits, -error) == pytest.approx(-size)


@pytest.mark.parametrize("backwards", [False, True])
@pytest.mark.parametrize("aside", [0.0, 0.02, -0.03])
@pytest.mark.parametrize("gap", [0.05, 0.11, 0.4])
def test_it_settles_along_its_heading_by_a_share_of_the_gap(gap, aside, backwards):
    pursuit = Pursuit(PROMPT, DT)
    pursuit.set_path(line(5.9, 6.0, 5))
    pursuit.state = "settle"
    x = 6.0 + gap if backwards else 6.0 - gap
    found = pursuit.command(SE2.from_xyt(x, 4.0 + aside, 0.0), Twist(), ROOM)
    distance = math.hypot(gap, aside)
    steer = math.atan2(aside if backwards else -aside, gap)
    if abs(steer) > TURNED_RAD:
        assert (found.v, found.w) == (0.0, pytest.approx(turning_speed(pursuit.limits, steer)))
        return
    v = min(0.25, 1.5 * distance)
    assert found.v == pytest.approx(-v if backwards else v)
    assert found.w == pytest.approx(1.5 * steer)


def test_near_enough_it_turns_to_the_goals_yaw_and_drifting_off_it_settles_again():
    pursuit = Pursuit(PROMPT, DT)
    poses = SE2.from_xyt(np.linspace(5.9, 6.0, 5), np.full(5, 4.0), np.array([0.0, 0.0, 0.0, 0.0, 0.5]))
    for dx, dy, state in (
        (-0.011, 0.0, "align"), (-0.013, 0.0, "settle"), (0.0, 0.023, "align"), (0.0, 0.025, "settle"),
        (-0.004, 0.015, "settle"), (-0.002, 0.015, "align"),
    ):  # fmt: skip
        pursuit.set_path(poses)
        pursuit.state = "settle"
        found = pursuit.command(SE2.from_xyt(6.0 + dx, 4.0 + dy, 0.0), Twist(), ROOM)
        assert pursuit.state == state
        if state == "align":
            assert found == Twist(0.0, turning_speed(pursuit.limits, 0.5))
    pursuit.state = "align"
    assert pursuit.command(SE2.from_xyt(6.0, 4.0, 0.5 - 0.011), Twist(), ROOM) == Twist()
    assert pursuit.state == "arrived"
    assert pursuit.command(SE2.from_xyt(6.0, 4.0, 0.5 + 0.013), Twist(), ROOM).w < 0.0
    assert pursuit.state == "align"
    assert pursuit.command(SE2.from_xyt(6.0, 4.031, 0.5), Twist(0.011, 0.0), ROOM).v == 0.0
    assert pursuit.state == "arrived"
    assert pursuit.command(SE2.from_xyt(6.0, 4.031, 0.2), Twist(0.01, 0.0), ROOM) == Twist()
    assert pursuit.state == "settle"


def test_room_is_that_of_the_footprint_in_a_turned_map():
    T = SE2.from_xyt(1.0, -2.0, 0.7)
    lethal = np.zeros((60, 80), dtype=bool)
    lethal[30, 40] = True
    turned = Costmap(lethal, 0.05, T)
    for pose in (SE2.from_xyt(1.9, 1.4, 0.3), SE2.from_xyt(1.8, 1.53, 1.3)):
        x, y, yaw = (T @ pose).xyt
        pursuit = following(T @ pose @ line(0.0, 3.0, 61, 0.0))
        expected = footprint_clearance(turned.clearance, 0.05, pursuit.samples, *pose.xyt.tolist())
        assert SLOWEST * NEAR_M < expected < NEAR_M
        speed = pursuit.command(T @ pose, Twist(0.1, 0.0), turned).v
        assert speed == pytest.approx(PROMPT.max_v * expected / NEAR_M, abs=1e-6)
        back = grid_pose(turned, x, y, yaw)
        assert back[:2] == pytest.approx(tuple(pose.xy))
        assert wrapped(back[2] - float(pose.yaw)) == pytest.approx(0.0)


@pytest.mark.parametrize(
    "target", [Twist(0.5, 1.0), Twist(-0.5, 1.0), Twist(0.02, -0.4), Twist(0.0, 3.0), Twist(1.0, 9.0)]
)
@pytest.mark.parametrize("last", [Twist(), Twist(0.2, 0.5), Twist(-0.3, -1.0), Twist(0.5, 0.0)])
def test_a_command_changes_by_no_more_than_the_limits_and_keeps_its_curve(target, last):
    limits = SpeedLimits(0.4, 1.5, 0.8, 3.0, 0.1)
    found = ramped(target, last, limits)
    v = float(np.clip(np.clip(target.v, last.v - 0.08, last.v + 0.08), -0.4, 0.4))
    wanted = target.w
    if target.v * v > 0.0 and abs(v) < abs(target.v):
        wanted *= v / target.v
    w = float(np.clip(np.clip(wanted, last.w - 0.3, last.w + 0.3), -1.5, 1.5))
    assert (found.v, found.w) == pytest.approx((v, w))


def test_limits_are_the_narrower_of_robots_and_configuration():
    made = SpeedLimits.of(BURGER, 0.1, max_v=0.1, max_w=9.0, max_dv=0.5)
    assert made == SpeedLimits(0.1, 2.84, 0.5, 12.5, 0.1)
    assert SpeedLimits.of(BURGER, 0.1, max_v=9.0, max_w=1.0, max_dv=9.0) == SpeedLimits(
        0.22, 1.0, 1.0, 12.5, 0.1
    )
    both = Ramped(BURGER, 0.1, max_v=9.0, max_w=9.0, acceleration_share=0.5)
    assert both.ramp(Twist(0.2, 0.0), Twist()) == Twist(0.05, 0.0)
    assert both.brake(Twist(0.2, 0.0)) == Twist(0.1, 0.0)


def test_the_goal_checker_is_wider_once_inside_and_counts_its_hold():
    config = GoalCheckerConfig(hold=0.3)
    goal, still = SE2.from_xyt(1.0, 1.0, 3.1), Twist(0.01, 0.06)
    out = SE2.from_xyt(1.035, 1.0, 3.1)
    assert not GoalChecker(config, goal).reached(0, out, still)
    checker = GoalChecker(config, goal)
    assert not checker.reached(0, SE2.from_xyt(1.0299, 1.0, 3.1), still)
    assert not checker.reached(299_999_999, out, still)
    assert checker.reached(300_000_000, out, still)
    for pose, twist in (
        (SE2.from_xyt(1.0361, 1.0, 3.1), still), (SE2.from_xyt(1.0, 1.0, 3.1 + 0.0601), still),
        (goal, Twist(0.011, 0.0)), (goal, Twist(0.0, -0.061)),
    ):  # fmt: skip
        checker = GoalChecker(config, goal)
        assert not checker.reached(0, goal, still)
        assert not checker.reached(10**9, pose, twist)
        assert not checker.reached(2 * 10**9, goal, still)
        assert checker.reached(3 * 10**9, SE2.from_xyt(1.0, 1.0, 3.1 + 0.059 - 2 * math.pi), still)
    passing = GoalChecker(GoalCheckerConfig(hold=0.0, stop=False), goal)
    assert passing.reached(0, goal, Twist(0.2, 0.0))


@pytest.mark.parametrize(("v", "w"), [(0.2, 0.0), (0.15, 1.0), (0.0, 1.5), (-0.2, 0.3)])
def test_the_monitor_allows_the_speed_that_stops_within_the_free_way(v, w):
    monitor, b = CollisionMonitor(BURGER), 0.8 * BURGER.max_dv
    reach = BURGER.circumscribed_radius + 0.02
    speed = max(abs(v), abs(w) * reach)
    horizon = (speed * 0.1 + speed**2 / (2 * b)) / speed
    factors = []
    for gap in (0.005, 0.02, 0.03, 0.3):
        x = 0.041 + 0.02 + gap if v >= 0 else -0.105 - 0.02 - gap
        points = np.array([[x, 0.05], [x, -0.05], [0.0, 0.125 + gap / 2]])
        free = free_time(points, padded(BURGER.footprint, 0.02), reach, v, w, horizon, 0.01 / speed)
        allowed = -b * 0.1 + math.sqrt((b * 0.1) ** 2 + 2 * b * free * speed)
        expected = 1.0 if free >= horizon else min(1.0, allowed / speed)
        factors.append(monitor.limit(Twist(v, w), points))
        assert factors[-1] == pytest.approx(expected)
    assert factors[-1] == 1.0 > factors[0]
    assert monitor.limit(Twist(), points) == 1.0
    assert monitor.limit(Twist(v, w), points[:0]) == 1.0
    # beside a wall on the map: what ends in it is stopped, unless it gets freer
    for x in (0.9, 1.0, 1.03, 1.06, 1.1):
        lethal = np.zeros((40, 60), dtype=bool)
        lethal[:, 24] = True
        field = Costmap(lethal, 0.05, SE2.identity()).clearance
        s = sample_footprint(BURGER)
        clear = lambda p: footprint_clearance(field, 0.05, s, *p)  # noqa: B023, E731
        at = (x, 1.0, 0.2)
        rooms = [clear(moved(*at, v, w, part * horizon)) for part in (0.5, 1.0)]
        stops = any(r <= 0.0 and r < clear(at) for r in rooms)
        assert monitor.limit_on_map(Twist(v, w), field, 0.05, *at) == (0.0 if stops else 1.0)
    assert monitor.limit_on_map(Twist(), field, 0.05, 1.21, 1.0, 0.0) == 1.0
