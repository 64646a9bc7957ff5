"""Recovery, relocalisation and the order of goals, by hand-computed cases."""

import math

import pytest

from turtlebag.datasets.se2 import SE2
from turtlebag.datasets.types import Twist
from turtlebag.pipeline.navigation.goal_states import Event, Machine
from turtlebag.pipeline.navigation.pose_watch import PoseWatch, RelocaliseConfig
from turtlebag.planners.tasks.patrol import GoalSequence, SequenceConfig
from turtlebag.planners.tasks.recovery import Ladder, Move, ProgressWatch, RecoveryConfig, Rung, Wait
from turtlebag.planners.tasks.waypoints import Waypoint, parse_polygons, parse_waypoint, parse_waypoints
from turtlebag.planners.tasks.wiggle import Wiggle

S = 10**9


def test_manoeuvres_end_after_their_amount_or_time():
    start = SE2.from_xyt(1.0, 1.0, 3.0)
    back = Move(start, Twist(-0.08, 0.0), 0.15, 5 * S, "x")
    turn = Move(start, Twist(0.0, 0.6), 1.6, 5 * S, "x")
    for move, before, after in (
        (back, (0.14, 0.0, 1.0), (0.0, -0.15001, 0.0)),
        (turn, (1.0, 0.0, 1.59), (0.0, 0.0, -1.61)),
    ):
        assert move.command(5 * S - 1, start @ SE2.from_xyt(*before)) == move.twist
        assert move.command(0, start @ SE2.from_xyt(*after)) is None
        assert move.command(5 * S, start) is None
    wait = Wait(3 * S)
    assert (wait.command(3 * S - 1, start), wait.command(3 * S, start)) == (Twist(), None)


def test_the_ladder_takes_the_side_with_more_room_and_waits_where_there_is_none():
    rungs = (
        Rung(kind="back_up", amount=0.3),
        Rung(kind="rotate", amount=5.0),
        Rung(kind="rotate", amount=1.0),
    )
    config, pose = RecoveryConfig(ladder=rungs), SE2.identity()
    cases = (
        (lambda t, a: 0.0, "recover_back_up", Twist(-0.08, 0.0), 0.3, 0.3 / 0.08 + 1.0),
        (lambda t, a: 1.0 if t.v > 0 else 0.5, "recover_go_on", Twist(0.08, 0.0), 0.3, 0.3 / 0.08 + 1.0),
    )
    for room, name, twist, amount, seconds in cases:
        move = Ladder(config, list).climb(7 * S, pose, room)
        assert (move.name, move.twist, move.amount, move.start) == (name, twist, amount, pose)
        assert move.until_ns == 7 * S + round(seconds * S)
    ladder = Ladder(config, list)
    assert not ladder.climbed
    blocked = ladder.climb(7 * S, pose, lambda t, a: -math.inf)
    assert (blocked.name, blocked.until_ns) == ("recover_wait", 9 * S)
    assert ladder.climbed
    # turns begin to the other side each time
    first, second = ladder.climb(0, pose), ladder.climb(0, pose)
    assert (first.twist.w, first.amount) == (-0.6, 5.0)
    assert (second.twist.w, second.amount) == (0.6, 1.0)
    ladder.rest()
    ladder.climb(0, pose)
    other = ladder.climb(0, pose, lambda t, a: -t.w)
    assert (other.name, other.twist.w, ladder.used) == ("recover_rotate_back", -0.6, 5)
    cleared: list[bool] = []
    config = RecoveryConfig(ladder=(Rung(kind="clear"), Rung(kind="wait", amount=2.5)), total=1)
    clear = Ladder(config, lambda: cleared.append(True))
    assert (clear.climb(S, pose).until_ns, clear.climb(S, pose)) == (S + 300_000_000, None)
    assert cleared == [True]


def test_a_turn_may_be_longer_than_half_a_circle():
    turn = Move(SE2.from_xyt(0.0, 0.0, 3.0), Twist(0.0, 0.6), 5.0, 9 * S, "turn")
    yaws = (3.0, 4.5, 6.2, 7.9, 8.1)
    assert [turn.command(0, SE2.from_xyt(0.0, 0.0, yaw)) is None for yaw in yaws] == [False] * 4 + [True]


def test_progress_is_a_move_or_a_turn_large_enough_within_the_time():
    watch = ProgressWatch(5.0)
    at = lambda s, x, yaw=3.1: watch.stuck(round(s * S), SE2.from_xyt(x, 0.0, yaw))  # noqa: E731
    assert [at(0, 0.0), at(5, 0.059), at(5.001, 0.059)] == [False, False, True]
    # it says so once, and begins anew
    assert [at(6, 0.12), at(11, 0.12), at(11.1, 0.1205), at(11.2, 0.1205)] == [False, False, True, False]
    # across the turn of the circle
    assert [at(15, 0.12, 3.1 + 0.26), at(19.9, 0.12, -2.9), at(20.1, 0.12, -2.9)] == [False, False, True]


def test_a_lost_robot_keeps_its_times():
    config = RelocaliseConfig(look=5.0, roam=45.0, restarts=1)
    r = PoseWatch(config, Machine())
    at = lambda s, narrow, agrees, updates: r.update(round(s * S), narrow, agrees, updates)  # noqa: E731
    assert [at(0, False, True, 1), at(1, False, True, 1), at(2, True, True, 2), at(3, False, True, 3)] == [
        "wait"
    ] * 4
    assert at(4, True, False, 4) == "look"
    # settled needs an update since, and its whole second
    assert [at(5, True, True, 4), at(6.5, True, True, 4), at(6.6, False, True, 5)] == ["look"] * 3
    assert [at(7, True, True, 5), at(7.99, True, True, 5), at(8, True, True, 5)] == ["look", "look", "wait"]
    r.on(Event.DOUBT, 20 * S, 9)
    assert [at(24.9, False, False, 10), at(25, False, False, 10)] == ["look", "roam"]
    assert [at(69.9, False, True, 11), at(70, False, True, 11)] == ["roam", "restart"]
    assert [at(70.1, False, True, 12), at(75.0, False, True, 12), at(75.1, False, True, 13)] == [
        "look",
        "look",
        "roam",
    ]
    assert [at(120.1, False, True, 14), at(120.2, False, True, 14)] == ["give_up", "wait"]
    # a narrow cloud after looking about is trusted, for a while, whatever the scans say
    r.on(Event.DOUBT, 200 * S, 20)
    assert [at(205, True, False, 20), at(206, True, False, 21)] == ["roam", "roam"]
    r = PoseWatch(config, Machine())
    r.on(Event.DOUBT, 300 * S, 30)
    assert [at(304, True, False, 31), at(305, True, False, 31)] == ["look", "wait"]
    assert [at(319.9, True, False, 40), at(319.95, True, False, 41), at(320, True, False, 42)] == ["wait"] * 3
    assert at(320.1, True, False, 43) == "look"


GOALS = [Waypoint(SE2.from_xyt(float(k), 0.0, 0.0)) for k in range(3)]


def test_a_postponed_goal_has_its_time_afterwards():
    order = GoalSequence(GOALS, SequenceConfig(initial_wait=2.0, timeout=10.0, pause=1.0))
    order.postpone(5 * S)  # before it began: nothing to wait for
    assert [order.update(t * S) for t in (0, 1)] == [None, None]
    order.postpone(3 * S)
    assert order.update(4 * S) is None
    assert order.update(5 * S) is GOALS[0].T_map_goal
    order.postpone(4 * S)
    assert order.update(19 * S - 1) is GOALS[0].T_map_goal
    assert order.update(19 * S, "mud") is GOALS[1].T_map_goal
    assert order.outcomes[0].reason == "not reached within 10 s: mud"
    assert order.outcomes[0].time_s == pytest.approx(14.0)
    order.close("reached", "", 20 * S)
    assert (order.update(21 * S - 1), order.goal, order.finished) == (None, None, False)
    assert order.update(21 * S) is GOALS[2].T_map_goal
    assert order.waypoint is GOALS[2]
    assert order.update(31 * S - 1) is GOALS[2].T_map_goal
    assert order.update(31 * S) is None
    assert order.finished
    assert [o.status for o in order.outcomes] == ["timeout", "reached", "timeout"]


@pytest.mark.parametrize("status", ["rejected", "unreachable", "timeout"])
def test_the_rest_of_the_goals_gets_one_end(status):
    bad = Waypoint(None, "x is missing")
    order = GoalSequence([GOALS[0], bad, GOALS[2]], SequenceConfig(initial_wait=0.0))
    order.update(0)
    order.close_all(status, "no way", 7 * S)
    assert [o.status for o in order.outcomes] == [status, "rejected", status]
    assert [o.reason for o in order.outcomes] == ["no way", "x is missing", "no way"]
    assert [(o.started_ns, o.ended_ns) for o in order.outcomes] == [
        (0, 7 * S),
        (7 * S, 7 * S),
        (7 * S, 7 * S),
    ]
    assert [o.index for o in order.outcomes] == [0, 1, 2]
    assert order.finished


def test_laps_close_only_where_there_is_more_than_one_goal_and_misses_come_once_more():
    closed = SequenceConfig(laps=2, closed=True)
    assert [GoalSequence(GOALS[:n], closed).total for n in (1, 2, 3)] == [2, 5, 7]
    order = GoalSequence(GOALS, SequenceConfig(initial_wait=0.0, pause=0.0, retry_missed=True))
    for k, status in enumerate(("unreachable", "reached", "timeout", "timeout", "unreachable")):
        assert order.update(k * S) is GOALS[(0, 1, 2, 0, 2)[k]].T_map_goal
        order.close(status, "", k * S)
    assert order.update(9 * S) is None
    assert order.finished


def test_a_goal_that_was_reached_is_stayed_at_as_long_as_it_says():
    goals = [Waypoint(GOALS[0].T_map_goal, wait=4.0), Waypoint(GOALS[1].T_map_goal, wait=0.0), GOALS[2]]
    order = GoalSequence([*goals, goals[0]], SequenceConfig(initial_wait=0.0, pause=1.0))
    order.update(0)
    order.close("reached", "", 10 * S)
    assert [order.update(t) is not None for t in (14 * S - 1, 14 * S)] == [False, True]
    order.close("reached", "", 20 * S)
    assert order.update(20 * S) is goals[2].T_map_goal
    order.close("reached", "", 30 * S)
    assert [order.update(t) is not None for t in (31 * S - 1, 31 * S)] == [False, True]
    order.close("unreachable", "no way", 40 * S)
    assert order.finished
    assert order.lap == (*goals, goals[0])


def test_a_wiggle_is_a_triangle_wave_between_its_angles():
    wiggle, heading, seen, dt = Wiggle(), 0.0, [], 0.01
    for k in range(2499):
        heading += wiggle.command(5 * S + round(k * dt * S), False).w * dt
        seen.append(heading)
    assert (max(seen), min(seen)) == pytest.approx((1.2, -1.2), abs=0.02)
    assert seen[round(1.2 / 0.6 / dt)] == pytest.approx(1.2, abs=0.02)
    assert (wiggle.command(30 * S, False), wiggle.gave_up) == (None, True)
    short = Wiggle()
    assert [short.command(t, True) is None for t in (0, 3 * S - 1, 3 * S)] == [False, False, True]
    assert not short.gave_up


@pytest.mark.parametrize(
    ("entry", "pose"),
    [
        ([1, 2], (1.0, 2.0, 0.0)),
        ([1, 2, 3], (1.0, 2.0, 3.0)),
        ({"x": 1, "y": 2}, (1.0, 2.0, 0.0)),
        ({"x": 1, "y": 2, "yaw": -0.5, "wait": 3600}, (1.0, 2.0, -0.5)),
        ({"x": 1, "y": 2, "quaternion": [0, 0, 2 * math.sin(0.5), 2 * math.cos(0.5)]}, (1.0, 2.0, 1.0)),
        ({"x": 1, "y": 2, "quaternion": [0, 0, 1e300, 1e300]}, (1.0, 2.0, math.pi / 2)),
    ],
)
def test_an_entry_of_a_waypoints_file_is_a_pose(entry, pose):
    found = parse_waypoint(entry)
    assert found.reason == ""
    assert found.T_map_goal.xyt == pytest.approx(pose)
    assert found.written == pytest.approx(pose)


def test_a_waypoints_file_is_a_list_of_entries_or_says_what_to_keep_out_of_besides():
    entries, corners = [[1, 2], {"x": 3, "y": 4, "yaw": 0.5}], [[0, 0], [1, 0], [1, 1]]
    alone = parse_waypoints(entries, "file")
    both = parse_waypoints({"waypoints": entries, "keepout": [corners]}, "file")
    for found, areas in ((alone, []), (both, [corners])):
        assert [waypoint.written for waypoint in found.waypoints] == [(1.0, 2.0, 0.0), (3.0, 4.0, 0.5)]
        assert [area.tolist() for area in found.keepout] == areas


def test_areas_to_keep_out_of_are_polygons():
    corners = [[0, 0], [1, 0], [1, 1]]
    (polygon,) = parse_polygons([corners], "file")
    assert polygon.tolist() == corners
