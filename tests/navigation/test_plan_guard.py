"""The guard and its escape, by hand-computed cases."""

import math

import numpy as np
import pytest
from planning_room import BURGER
from scipy.spatial import cKDTree

from turtlebag.datasets.se2 import SE2
from turtlebag.datasets.types import Twist
from turtlebag.pipeline.navigation.guarded import Guard, GuardConfig, SlipWatch, View, _Escape, _misfit
from turtlebag.planners.tasks.avoid import AvoidConfig, Decision, Sectors

OPEN = Sectors(1.5, 2.0, 1.5)
FAR = 3.0 * np.column_stack([np.cos(np.linspace(-3, 3, 90)), np.sin(np.linspace(-3, 3, 90))])


def view(points=FAR, now=0.0, pose=None, sectors=OPEN):
    pose = pose or SE2.identity()
    return View(now, pose, pose @ np.asarray(points, dtype=float), sectors)


def guard(**settings):
    return Guard(BURGER, AvoidConfig(), GuardConfig(**settings))


def test_the_gap_is_the_free_length_before_the_nose_within_the_corridor():
    half = 0.105 + 0.06
    points = np.array(
        [[1.0, 0.0], [0.5, half - 0.001], [0.3, half + 0.001], [0.3, -half - 0.001], [-0.2, 0.0]]
    )
    assert guard()._gap(points) == pytest.approx(0.5 - 0.041)
    assert guard()._gap(points[[0, 2, 3, 4]]) == pytest.approx(1.0 - 0.041)
    assert guard()._gap(points[[2, 4]]) == math.inf
    assert guard()._gap(np.array([[0.4, 0.1 - half]])) == pytest.approx(0.4 - 0.041)


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
    ],
)
def test_the_guard_decides_by_sectors_and_by_the_gap_before_its_nose(sectors, points, expected):
    decision = guard().decide(view(points, sectors=sectors), Twist())
    assert (decision.action, decision.command.v, decision.command.w) == expected


def test_most_room_is_where_the_nearest_point_of_a_sector_is_farthest():
    centers = np.linspace(-math.pi, math.pi, 24, endpoint=False)
    distance = np.full(720, 1.0)
    bearing = np.linspace(-math.pi, math.pi, 720, endpoint=False)
    for wide in (5, 11, 20):
        off = np.abs((bearing - centers[wide] + math.pi) % (2 * math.pi) - math.pi)
        r = np.where(off < math.radians(15.5), 2.0, distance)
        points = r[:, None] * np.column_stack([np.cos(bearing), np.sin(bearing)])
        pose = SE2.from_xyt(2.0, -1.0, 0.8)
        assert guard()._to_most_room(view(points, pose=pose)) == pytest.approx(centers[wide])
        # a sector in which nothing was hit has the most
        assert guard()._to_most_room(view(points[r < 1.5], pose=pose)) == pytest.approx(centers[wide])
    assert guard()._to_most_room(view(12.0 * points)) == pytest.approx(centers[20])
    assert guard()._to_most_room(view(points[r < 0.0])) == pytest.approx(-math.pi)


def test_a_robot_long_about_one_place_turns_to_where_most_room_is():
    g = guard(restless=20.0, restless_reach=0.4)
    at = lambda now, x: g._restless(view(now=now, pose=SE2.from_xyt(x, 0.0, 0.0)))  # noqa: E731
    assert [at(0.0, 0.0), at(19.9, 0.3), at(20.0, 0.3), at(25.0, 0.3)] == [False, False, True, False]
    # begun anew when it said so, and wherever the robot has come to
    assert [at(40.0, 0.3), at(41.0, 0.71), at(60.9, 0.8), at(61.0, 0.8)] == [True, False, False, True]
    g.interrupted()
    assert g._anchor is None
    again = guard(restless=1.0)
    again.decide(view(now=0.0), Twist())
    assert again.decide(view(now=1.0), Twist()).action == "turn away"
    assert again._manoeuvre is not None
    assert again.decide(view(now=1.2), Twist()).command == Twist(0.0, -0.5)


def test_an_interrupted_guard_forgets_what_it_was_doing_and_not_what_it_knows():
    g = guard()
    g._got_stuck(view(sectors=Sectors(2.0, 2.0, 1.0)), Twist(0.1, 0.0))
    g._turning, g._flips = 1.0, 2
    g._slip.slipping(SE2.identity(), FAR)
    g.interrupted()
    assert (g._manoeuvre, g._turning, g._flips, g._slip._pose) == (None, 0.0, 0, None)
    assert len(g.points_base(view())) == len(FAR) + 5
    assert len(g.points_base(view(now=120.1))) == len(FAR)
    assert g.stuck == 1


@pytest.mark.parametrize(("v", "left", "backs", "turns"), [(0.1, 2.0, -0.1, 0.5), (-0.1, 1.0, 0.1, -0.5)])
def test_what_it_is_stuck_at_is_remembered_and_left_the_other_way(v, left, backs, turns):
    g, pose = guard(), SE2.from_xyt(1.0, 2.0, 0.5)
    g._turning = 1.0
    g._got_stuck(view(now=3.0, pose=pose, sectors=Sectors(left, 2.0, 1.5)), Twist(v, 0.0))
    assert (g.stuck, g._turning) == (1, 0.0)
    when, points = g._unseen[0]
    edge = 0.041 + 0.05 if v > 0 else -0.105 - 0.015
    np.testing.assert_allclose(
        pose.inverse() @ points, [[edge, y] for y in np.linspace(-0.165, 0.165, 5)], atol=1e-9
    )
    assert when == 3.0
    assert g._manoeuvre.command(pose) == Twist(backs, 0.0)
    there = pose @ SE2.from_xyt(-0.25 if v > 0 else 0.25, 0.0, 0.0)
    assert g._manoeuvre.command(there) == Twist(0.0, turns)
    assert g._manoeuvre.command(there @ SE2.from_xyt(0.0, 0.0, math.copysign(1.59, turns))) is not None
    assert g._manoeuvre.command(there @ SE2.from_xyt(0.0, 0.0, math.copysign(1.61, turns))) is None


def test_an_escape_is_bounded_in_sweeps_and_in_the_turn():
    escape = _Escape(SE2.identity(), 0.25, 3.1, GuardConfig())
    backing = [escape.command(SE2.identity()) for _ in range(19)]
    assert backing == [Twist(-0.1, 0.0)] * 19
    turning = [escape.command(SE2.identity()) for _ in range(31)]
    assert turning == [Twist(0.0, 0.5)] * 31
    assert escape.command(SE2.identity()) is None
    whole = _Escape(SE2.from_xyt(0.0, 0.0, 3.0), 0.0, 3.1, GuardConfig())
    assert whole.command(SE2.from_xyt(0.0, 0.0, 3.0)) == Twist(0.0, 0.5)
    assert whole.command(SE2.from_xyt(0.0, 0.0, 3.0 + math.pi - 0.21)) is not None
    assert whole.command(SE2.from_xyt(0.0, 0.0, 3.0 + math.pi - 0.19)) is None


def test_what_touches_is_replaced_by_the_first_motion_that_does_not():
    wall = np.column_stack([np.full(30, 0.065), np.linspace(-0.1, 0.1, 30)])
    ahead = Decision("straight", Twist(0.2, 0.0))
    g = guard()
    free = Decision("straight", Twist(-0.1, 0.0))
    assert g._possible(free, view(wall)) is free
    turned = g._possible(ahead, view([[0.065, 0.0]]))
    assert turned.action in ("turn", "back off")
    # a post beside the nose on the left: it turns right into free space, and remembers the side
    post = [[0.06, 0.09], [0.066, 0.0]]
    g = guard()
    found = g._possible(Decision("stop, turn left", Twist(0.2, 0.5)), view(post))
    limits = {w: g.monitor.limit(Twist(0.0, w), np.array(post)) for w in (0.5, -0.5)}
    expected = next((w for w in (0.5, -0.5) if limits[w] > 0.15), None)
    if expected is None:
        assert found.action == "back off"
    else:
        assert (found.action, found.command.w) == ("turn", expected)
        assert g._turning == math.copysign(1.0, expected)
    ring = np.vstack([wall, np.column_stack([np.full(30, -0.128), np.linspace(-0.1, 0.1, 30)])])
    ring = np.vstack([ring, np.column_stack([np.linspace(-0.12, 0.06, 30), np.full(30, 0.128)])])
    ring = np.vstack([ring, ring * [1.0, -1.0]])
    held = guard()._possible(ahead, view(ring))
    assert all(
        guard().monitor.limit(t, ring) <= 0.15 for t in (Twist(0.0, 0.5), Twist(-0.1, 0.0), Twist(0.05, 0.0))
    )
    assert (held.action, held.command) == ("hold", Twist())


def test_sweeps_are_compared_once_odometry_has_passed_far_enough():
    rng = np.random.default_rng(1)
    points = rng.uniform(-2.0, 2.0, (80, 2))
    watch = SlipWatch(GuardConfig(slip_travel=0.1))
    assert not watch.slipping(SE2.identity(), points)
    # standing on a spot while odometry goes on: the same sweep in the base frame
    near, far = SE2.from_xyt(0.09, 0.0, 0.1), SE2.from_xyt(0.11, 0.0, 0.1)
    assert not watch.slipping(near, near @ points)
    assert watch.slipping(far, far @ points)
    on = far @ SE2.from_xyt(0.2, 0.0, 0.0)
    assert not watch.slipping(on, far @ points)  # it did move: the world stood still
    turned = on @ SE2.from_xyt(0.0, 0.0, 0.7)
    assert not watch.slipping(turned, far @ points)
    assert watch._pose is turned
    few = turned @ SE2.from_xyt(0.5, 0.0, 0.0)
    assert not watch.slipping(few, few @ points[:29])
    assert not watch.slipping(few @ SE2.from_xyt(0.5, 0.0, 0.0), few @ points)
    watch.reset()
    assert watch._pose is None
    # turning on the spot while only the way is false
    spun = SlipWatch(GuardConfig())
    spun.slipping(SE2.identity(), points)
    there = SE2.from_xyt(0.3, 0.0, 0.5)
    assert spun.slipping(there, there @ (SE2.from_xyt(0.0, 0.0, -0.5) @ points))


def test_the_misfit_is_the_mean_gap_cut_at_twenty_centimetres():
    tree = cKDTree(np.array([[0.0, 0.0], [1.0, 0.0]]))
    assert _misfit(tree, np.array([[0.1, 0.0], [1.0, 0.05], [5.0, 5.0]])) == pytest.approx(
        (0.1 + 0.05 + 0.2) / 3
    )
