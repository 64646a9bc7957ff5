"""Reactive avoidance and its escape, by hand-computed cases."""

import math

import numpy as np
import pytest
from scipy.spatial import cKDTree

from tests.helpers.planning_room import BURGER
from turtlebag.datasets.se2 import SE2
from turtlebag.datasets.types import Twist
from turtlebag.pipeline.navigation.bump_reflex import Escape
from turtlebag.pipeline.navigation.guarded_avoidance import (
    RESTLESS_M,
    RESTLESS_S,
    GuardedAvoidance,
    most_room,
)
from turtlebag.pipeline.navigation.obstacle_memory import MEMORY_NS, ObstacleMemory, misfit
from turtlebag.pipeline.navigation.sensing import DeskewedScan
from turtlebag.planners.tasks.recovery import ProgressWatch
from turtlebag.planners.tasks.sector_rule import Decision, Sectors

S, HERE = 10**9, SE2.identity()
OPEN = Sectors(1.5, 2.0, 1.5)
FAR = 3.0 * np.column_stack([np.cos(np.linspace(-3, 3, 90)), np.sin(np.linspace(-3, 3, 90))])


def view(points=FAR, now=0.0, pose=None, sectors=OPEN):
    pose = pose or SE2.identity()
    hits = pose @ np.asarray(points, dtype=float)
    return DeskewedScan(round(now * 1e9), pose, hits, np.zeros((0, 2)), sectors)


def avoidance():
    return GuardedAvoidance(BURGER, ObstacleMemory(BURGER))


HALF = 0.105 + 0.06
"""Half of the corridor before the nose."""


@pytest.mark.parametrize(
    ("sectors", "points", "expected"),
    [
        (Sectors(2.0, 1.01, 1.0), FAR, ("straight", 0.2, 0.0)),
        (Sectors(2.0, 1.0, 1.0), FAR, ("slow, veer left", 0.1, 0.3)),
        (Sectors(1.0, 0.5, 1.0), FAR, ("slow, veer right", 0.1, -0.3)),
        (Sectors(2.0, 0.49, 1.0), FAR, ("stop, turn left", 0.0, 0.5)),
        (Sectors(1.0, 0.49, 1.0), FAR, ("stop, turn right", 0.0, -0.5)),
        (Sectors(2.0, 2.0, 1.0), [[0.24, 0.1]], ("stop, turn left", 0.0, 0.5)),
        (Sectors(2.0, 2.0, 1.0), [[0.242, 0.1]], ("straight", 0.2, 0.0)),
        (Sectors(2.0, 2.0, 1.0), [[1.0, 0.0], [0.2, HALF - 0.001]], ("stop, turn left", 0.0, 0.5)),
        (Sectors(2.0, 2.0, 1.0), [[0.2, 0.001 - HALF]], ("stop, turn left", 0.0, 0.5)),
        (Sectors(2.0, 2.0, 1.0), [[0.2, HALF + 0.001], [0.2, -HALF - 0.001]], ("straight", 0.2, 0.0)),
        (Sectors(2.0, 2.0, 1.0), [[-0.2, 0.0]], ("straight", 0.2, 0.0)),
    ],
)
def test_the_guard_decides_by_sectors_and_by_the_gap_before_its_nose(sectors, points, expected):
    decision = avoidance().decide(view(points, sectors=sectors), HERE, Twist())
    assert (decision.action, decision.command.v, decision.command.w) == expected


def test_most_room_is_where_the_nearest_point_of_a_sector_is_farthest():
    centers = np.linspace(-math.pi, math.pi, 24, endpoint=False)
    distance = np.full(720, 1.0)
    bearing = np.linspace(-math.pi, math.pi, 720, endpoint=False)
    for wide in (5, 11, 20):
        off = np.abs((bearing - centers[wide] + math.pi) % (2 * math.pi) - math.pi)
        r = np.where(off < math.radians(15.5), 2.0, distance)
        points = r[:, None] * np.column_stack([np.cos(bearing), np.sin(bearing)])
        assert most_room(points) == pytest.approx(centers[wide])
        # a sector in which nothing was hit has the most
        assert most_room(points[r < 1.5]) == pytest.approx(centers[wide])
    assert most_room(12.0 * points) == pytest.approx(centers[20])
    assert most_room(points[r < 0.0]) == pytest.approx(-math.pi)


def test_a_robot_long_about_one_place_turns_to_where_most_room_is():
    watch = ProgressWatch(RESTLESS_S, RESTLESS_M, math.inf)
    at = lambda now, x: watch.stuck(round(now * 1e9), SE2.from_xyt(x, 0.0, 9.0 * now))  # noqa: E731
    assert [at(0.0, 0.0), at(19.9, 0.3), at(20.0, 0.3), at(25.0, 0.3)] == [False, False, True, False]
    # begun anew when it said so, and wherever the robot has come to
    assert [at(40.0, 0.3), at(41.0, 0.71), at(60.9, 0.8), at(61.0, 0.8)] == [True, False, False, True]
    again = avoidance()
    again.decide(view(now=-30.0), HERE, Twist())
    again.interrupted()
    again.decide(view(now=0.0), HERE, Twist())
    assert again.decide(view(now=19.8), HERE, Twist()).action == "straight"
    assert again.decide(view(now=20.0), HERE, Twist()).action == "turn away"
    assert again.decide(view(now=20.2), HERE, Twist()).command == Twist(0.0, -0.5)


def pushing(g, v=0.1, pose=HERE, **seen):
    """What it decides at a sweep that shows that it pushes against something: odometry has gone on, and the
    robot sees what it saw before."""
    before = pose @ SE2.from_xyt(math.copysign(-0.11, v), 0.0, 0.0)
    g.decide(view(pose=before, **seen), before, Twist(v, 0.0))
    return g.decide(view(pose=pose, **seen), pose, Twist(v, 0.0))


@pytest.mark.parametrize(("wall", "v"), [(0.08, -0.1), (-0.17, 0.1)])
def test_a_robot_long_in_a_corner_drives_to_the_freer_side_and_only_then_turns(wall, v):
    g = avoidance()
    points = np.vstack([FAR, [[wall, y] for y in np.arange(-0.2, 0.2, 0.02)]])
    corner = Sectors(1.0, 0.3, 1.0)
    assert g.decide(view(points, sectors=corner), HERE, Twist()).action.startswith("stop, turn")
    assert g.decide(view(points, 19.8, sectors=corner), HERE, Twist()).action.startswith("stop, turn")
    g.decide(view(points, 20.0, sectors=corner), HERE, Twist())
    decision = g.decide(view(points, 20.2, sectors=corner), HERE, Twist())
    assert (decision.action, decision.command) == ("back off", Twist(v, 0.0))
    out = SE2.from_xyt(math.copysign(0.25, v), 0.0, 0.0)
    assert g.decide(view(points, 22.8, sectors=corner), out, Twist()).action == "turn away"


def test_an_interrupted_guard_forgets_what_it_was_doing_and_not_what_it_knows():
    g = avoidance()
    assert pushing(g, sectors=Sectors(2.0, 2.0, 1.0)).command == Twist(-0.1, 0.0)
    g.turning = 1.0
    g.interrupted()
    assert (g.turning, g.decision.action) == (0.0, "hold")
    # No escape any more, and sweeps are compared anew.
    on = SE2.from_xyt(0.2, 0.0, 0.0)
    assert g.decide(view(pose=on), on, Twist(0.1, 0.0)).action == "straight"
    assert len(g.points_base(view(), HERE)) > len(FAR)
    assert len(g.points_base(view(now=MEMORY_NS * 1e-9 - 0.1), HERE)) > len(FAR)
    assert len(g.points_base(view(now=MEMORY_NS * 1e-9), HERE)) == len(FAR)


@pytest.mark.parametrize(("v", "left", "backs", "turns"), [(0.1, 2.0, -0.1, 0.5), (-0.1, 1.0, 0.1, -0.5)])
def test_what_it_is_stuck_at_is_remembered_and_left_the_other_way(v, left, backs, turns):
    g, pose, sectors = avoidance(), SE2.from_xyt(1.0, 2.0, 0.5), Sectors(left, 2.0, 1.5)
    decision = pushing(g, v=v, now=3.0, pose=pose, sectors=sectors)
    assert (decision.command, g.turning) == (Twist(backs, 0.0), 0.0)
    there = pose @ SE2.from_xyt(-0.25 if v > 0 else 0.25, 0.0, 0.0)
    for turned, action in ((0.0, "turn away"), (1.59, "turn away"), (1.61, "straight")):
        at = there @ SE2.from_xyt(0.0, 0.0, math.copysign(turned, turns))
        decision = g.decide(view(now=3.0, pose=at, sectors=sectors), at, Twist())
        assert decision.action == action
        assert decision.command == (Twist(0.0, turns) if action == "turn away" else Twist(0.2, 0.0))


def test_after_some_changes_of_the_freer_side_it_keeps_to_one_until_it_is_interrupted():
    g = avoidance()
    left, right = Sectors(1.0, 0.3, 0.5), Sectors(0.5, 0.3, 1.0)
    order = (left, right, left, right, left, right)
    sides = [g.decide(view(sectors=s), HERE, Twist()).action.rpartition(" ")[2] for s in order]
    assert sides == ["left", "right", "left", "right", "right", "right"]
    g.interrupted()
    sides = [g.decide(view(sectors=s), HERE, Twist()).action.rpartition(" ")[2] for s in order]
    assert sides == ["left", "right", "left", "right", "right", "right"]
    # and a robot that bumps into something begins anew with its sides too
    assert g.turning == -1.0
    pushing(g, sectors=right)
    assert g.turning == 0.0


@pytest.mark.parametrize(("v", "edge"), [(0.1, 0.041 + 0.05), (0.0, 0.041 + 0.05), (-0.1, -0.105 - 0.05)])
def test_a_bump_is_a_line_beyond_the_leading_edge_as_wide_as_the_robot_in_the_frame_asked_for(v, edge):
    memory, T_map_odom, pose = (
        ObstacleMemory(BURGER),
        SE2.from_xyt(0.3, 0.1, -0.2),
        SE2.from_xyt(1.0, 2.0, 0.5),
    )
    before = pose @ SE2.from_xyt(-0.11, 0.0, 0.0)
    assert not memory.bumped(view(pose=before), before, v, T_map_odom)
    assert memory.bumped(view(pose=pose), pose, v, T_map_odom)
    line = (T_map_odom @ pose).inverse() @ memory.bumps(0)
    np.testing.assert_allclose(line[:, 0], edge)
    np.testing.assert_allclose(np.diff(line[:, 1]), 0.02)
    ys = BURGER.footprint[:, 1]
    assert line[0, 1] == pytest.approx(ys.min())
    assert 0.0 <= line[-1, 1] - ys.max() < 0.02 + 1e-9


def test_an_escape_is_bounded_in_time_and_in_the_turn():
    escape = Escape(S, HERE, -0.25, 3.1)
    assert [escape.command(round(t * S), HERE) for t in (1.0, 4.9)] == [Twist(-0.1, 0.0)] * 2
    assert [escape.command(round(t * S), HERE) for t in (5.0, 10.9)] == [Twist(0.0, 0.5)] * 2
    assert escape.command(11 * S, HERE) is None
    whole = Escape(0, SE2.from_xyt(0.0, 0.0, 3.0), 0.0, 3.1)
    assert whole.command(0, SE2.from_xyt(0.0, 0.0, 3.0)) == Twist(0.0, 0.5)
    assert whole.command(0, SE2.from_xyt(0.0, 0.0, 3.0 + 3.05)) is not None
    assert whole.command(0, SE2.from_xyt(0.0, 0.0, 3.0 + 3.15)) is None


NOSE, LEFT, RIGHT, TAIL = (0.065, 0.0), (0.03, 0.115), (0.03, -0.115), (-0.128, 0.0)
"""Posts that touch the robot when it goes on, turns to either side, or goes back."""
AHEAD, BACK = Twist(0.2, 0.0), Twist(-0.1, 0.0)


@pytest.mark.parametrize(
    ("posts", "before", "command", "instead", "done", "turning"),
    [
        ([NOSE], 0.0, AHEAD, "turn", Twist(0.0, 0.5), 1.0),
        ([NOSE], -1.0, AHEAD, "turn", Twist(0.0, -0.5), -1.0),
        ([NOSE, LEFT], 0.0, AHEAD, "turn", Twist(0.0, -0.5), -1.0),
        ([LEFT], 0.0, Twist(0.0, 0.5), "turn", Twist(0.0, -0.5), -1.0),
        ([RIGHT], 0.0, Twist(0.0, -0.5), "turn", Twist(0.0, 0.5), 1.0),
        ([NOSE, LEFT, RIGHT], 0.0, AHEAD, "back off", BACK, 0.0),
        ([LEFT, RIGHT, TAIL], 0.0, BACK, "creep", Twist(0.05, 0.0), 0.0),
        ([NOSE, LEFT, RIGHT, TAIL], 0.0, AHEAD, "hold", Twist(), 0.0),
    ],
)
def test_what_touches_is_replaced_by_the_first_motion_that_does_not(
    posts, before, command, instead, done, turning
):
    g = avoidance()
    g.turning = before
    decision = g.possible(Decision("asked", command), np.array(posts))
    assert (decision.action, decision.command, g.turning) == (instead, done, turning)


def test_what_touches_nothing_is_done():
    free = Decision("straight", BACK)
    assert avoidance().possible(free, np.array([NOSE, LEFT, RIGHT])) is free


def test_sweeps_are_compared_once_odometry_has_passed_far_enough():
    rng = np.random.default_rng(1)
    points = rng.uniform(-2.0, 2.0, (80, 2))
    memory = ObstacleMemory(BURGER)

    def slipping(T_odom_base, hits_odom, memory=memory):
        sweep = DeskewedScan(0, T_odom_base, hits_odom, np.zeros((0, 2)), OPEN)
        return memory.bumped(sweep, T_odom_base, 0.1, HERE)

    assert not slipping(SE2.identity(), points)
    # standing on a spot while odometry goes on: the same sweep in the base frame
    near, far = SE2.from_xyt(0.09, 0.0, 0.1), SE2.from_xyt(0.11, 0.0, 0.1)
    assert not slipping(near, near @ points)
    assert slipping(far, far @ points)
    on = far @ SE2.from_xyt(0.2, 0.0, 0.0)
    assert not slipping(on, far @ points)  # it did move: the world stood still
    turned = on @ SE2.from_xyt(0.0, 0.0, 0.7)
    assert not slipping(turned, far @ points)
    few = turned @ SE2.from_xyt(0.5, 0.0, 0.0)
    assert not slipping(few, few @ points[:29])
    assert not slipping(few @ SE2.from_xyt(0.5, 0.0, 0.0), few @ points)
    assert slipping(few @ SE2.from_xyt(1.0, 0.0, 0.0), few @ SE2.from_xyt(0.5, 0.0, 0.0) @ points)
    memory.begin_again()
    assert not slipping(few @ SE2.from_xyt(1.5, 0.0, 0.0), few @ SE2.from_xyt(1.0, 0.0, 0.0) @ points)
    # turning on the spot while only the way is false
    spun = ObstacleMemory(BURGER)
    slipping(SE2.identity(), points, spun)
    there = SE2.from_xyt(0.3, 0.0, 0.5)
    assert slipping(there, there @ (SE2.from_xyt(0.0, 0.0, -0.5) @ points), spun)


def test_the_misfit_is_the_mean_gap_cut_at_twenty_centimetres():
    tree = cKDTree(np.array([[0.0, 0.0], [1.0, 0.0]]))
    assert misfit(tree, np.array([[0.1, 0.0], [1.0, 0.05], [5.0, 5.0]])) == pytest.approx(
        (0.1 + 0.05 + 0.2) / 3
    )
