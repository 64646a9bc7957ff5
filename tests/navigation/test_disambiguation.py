"""Active disambiguation: pose hypotheses are found and decided between, and only then do goals count."""

import dataclasses
import math
from types import SimpleNamespace
from typing import ClassVar

import numpy as np
import pytest

from tests.helpers.exact_rays import rectangle
from tests.helpers.localisation_room import STILL_LIDAR, T_BASE_LIDAR, Room, l_shaped_room
from turtlebag.datasets.maps import save_map
from turtlebag.datasets.se2 import SE2, wrap
from turtlebag.datasets.types import Scan, Twist
from turtlebag.pipeline.localisation.deskewed_beams import prepare
from turtlebag.pipeline.localisation.global_search import GlobalSearch
from turtlebag.pipeline.localisation.likelihood_field import distance_field
from turtlebag.pipeline.localisation.parameters import AmclConfig
from turtlebag.pipeline.localisation.pose_hypotheses import (
    ALIKE,
    SETTLING,
    Aliasing,
    Keyframe,
    PoseHypotheses,
    apart,
)
from turtlebag.pipeline.navigation.config import NavigateConfig
from turtlebag.pipeline.navigation.disambiguation import (
    Disambiguation,
    nearest_difference,
    passable_under_all,
    walls_of,
)
from turtlebag.pipeline.navigation.driver_setup import prepare as prepare_mission
from turtlebag.pipeline.navigation.episode import drive
from turtlebag.pipeline.navigation.goal_runner import Tick, Tools
from turtlebag.pipeline.navigation.mission import Request
from turtlebag.pipeline.navigation.navigator import ALIKE as REASON
from turtlebag.pipeline.navigation.navigator import LOST
from turtlebag.pipeline.navigation.pose_watch import RelocaliseConfig
from turtlebag.planners.control.collision_monitor import PADDING_M, CollisionMonitor
from turtlebag.planners.control.goal_checker import GoalCheckerConfig
from turtlebag.planners.control.pursuit import Pursuit
from turtlebag.planners.costmap import Costmap, CostmapConfig, costmap_from_grid
from turtlebag.planners.global_plan import OmplPlanner
from turtlebag.planners.obstacle_layer import Marking, ObstacleLayer
from turtlebag.planners.planner import PlanConfig
from turtlebag.planners.tasks.frontier import SPENT_M
from turtlebag.planners.tasks.recovery import RecoveryConfig
from turtlebag.sim import shapes
from turtlebag.sim.faults import FaultConfig
from turtlebag.sim.robots import load_robot
from turtlebag.sim.simulator import SimConfig, Simulator
from turtlebag.sim.world import World
from turtlebag.sim.worlds import load_world

# 12 x 4 m, the same when turned by half a circle about (6, 2) but for a cupboard at the right end.
TWIN = SE2.from_xyt(12.0, 4.0, math.pi)
PILLARS = ((4.0, 1.0, 4.3, 1.4), (7.7, 2.6, 8.0, 3.0), (5.6, 0.0, 5.9, 0.5), (6.1, 3.5, 6.4, 4.0))
CUPBOARD = (10.8, 1.2, 12.0, 2.8)
BURGER = load_robot("burger")


def room(*, cupboard=True):
    parts = [(0.0, 0.0, 12.0, 4.0), *PILLARS, *([CUPBOARD] if cupboard else [])]
    return Room(np.vstack([rectangle(*part) for part in parts]), (4.0, 2.0))


def world(*, cupboard=True):
    parts = [(-0.1, -0.1, 12.1, 0.0), (-0.1, 4.0, 12.1, 4.1), (-0.1, 0.0, 0.0, 4.0), (12.0, 0.0, 12.1, 4.0)]
    parts += [*PILLARS, *([CUPBOARD] if cupboard else [])]
    solids = tuple(
        shapes.box(f"part_{k}", (0.5 * (a + c), 0.5 * (b + d)), (c - a, d - b), 0.0, (0.0, 0.5))
        for k, (a, b, c, d) in enumerate(parts)
    )
    return World("aliased", "burger", SE2.from_xyt(5.0, 2.4, 0.3), solids, (-0.5, 12.5, -0.5, 4.5), (), {})


def aliasing_of(grid, searched=GlobalSearch):
    config = AmclConfig()
    # as many per square metre of these rooms as of a house
    search = searched(grid, distance_field(grid, 2.0), config, STILL_LIDAR.range_max, candidates=5000)
    return Aliasing(search, np.random.default_rng(1))


def scans_at(place, poses, rng):
    """Scans from poses (n,) of a room; odometry is the truth."""
    out = []
    for pose in poses:
        ranges = place.ranges(pose @ T_BASE_LIDAR, STILL_LIDAR.angles, STILL_LIDAR.range_max)
        noisy = (ranges + 0.01 * rng.standard_normal(len(ranges))).astype(np.float32)
        out.append(Keyframe(prepare(Scan(0, noisy, STILL_LIDAR), T_BASE_LIDAR), pose))
    return out


def turning_at(x, y):
    return [SE2.from_xyt(x, y, yaw) for yaw in (0.3, 0.8, 1.3)]


def find_far(T_map_odom):
    """Scans far from the cupboard, and the hypotheses of a robot that takes itself to be there, or not."""
    scans = scans_at(room(), turning_at(5.0, 2.4), np.random.default_rng(2))
    return scans, aliasing_of(room().grid()).find(scans, T_map_odom)


@pytest.fixture(scope="module")
def far():
    return find_far(SE2.identity())


@pytest.mark.slow
@pytest.mark.parametrize("T_map_odom", [SE2.identity(), TWIN])
def test_far_from_what_tells_them_apart_both_places_are_kept(far, T_map_odom):
    scans, found = find_far(TWIN) if T_map_odom is TWIN else far
    assert len(found) == 2
    np.testing.assert_array_equal(found[0].xyt, np.zeros(3))
    there = found[1] @ T_map_odom @ scans[-1].T_odom_base
    other = (SE2.identity() if T_map_odom is TWIN else TWIN) @ scans[-1].T_odom_base
    assert np.linalg.norm(there.xy - other.xy) < 0.05
    assert abs(wrap(there.yaw - other.yaw)) < 0.05


@pytest.mark.slow
def test_beside_what_tells_them_apart_one_is_left_and_it_is_the_right_one():
    scans = scans_at(room(), turning_at(10.2, 1.6), np.random.default_rng(2))
    aliasing = aliasing_of(room().grid())
    (same,) = aliasing.find(scans, SE2.identity())
    np.testing.assert_array_equal(same.xyt, np.zeros(3))
    # The estimate at the twin is told where the robot is.
    (moved,) = aliasing.find(scans, TWIN)
    there = moved @ TWIN @ scans[-1].T_odom_base
    assert np.linalg.norm(there.xy - (10.2, 1.6)) < 0.05
    fits = aliasing.fits([SE2.identity(), TWIN], scans[0], SE2.identity())
    assert fits[0] > fits[1] + 2.0 * ALIKE


def test_poses_drawn_beside_the_true_place_do_not_stand_for_it():
    """Seen from the first scan the search ends beside the true place, where no small step explains more."""
    scans = scans_at(room(), turning_at(9.5, 3.0), np.random.default_rng(2))
    beside = scans[0].T_odom_base @ SE2.from_xyt(0.3, 0.0, 0.7)
    drawn = iter([beside, *(scan.T_odom_base for scan in scans[1:])])

    class Beside(GlobalSearch):
        def draw(self, count, beams, rng, around=None, without=None):
            poses = np.tile(next(drawn).xyt, (count, 1))
            return poses[~without(poses)]

    (moved,) = aliasing_of(room().grid(), Beside).find(scans, TWIN)
    there = moved @ TWIN @ scans[-1].T_odom_base
    assert not apart(scans[-1].T_odom_base, there, 0.05)


@pytest.mark.slow
@pytest.mark.parametrize(("x", "y"), [(2.0, 2.0), (0.7, 0.8), (4.3, 2.2), (2.6, 0.5)])
def test_a_world_without_a_twin_has_one_hypothesis(x, y):
    place = l_shaped_room()
    found = aliasing_of(place.grid()).find(
        scans_at(place, turning_at(x, y), np.random.default_rng(3)), SE2.identity()
    )
    assert len(found) == 1
    np.testing.assert_array_equal(found[0].xyt, np.zeros(3))


@pytest.mark.slow
def test_in_a_crowd_nothing_is_said_about_other_places():
    """The scans beside the cupboard, which would move the estimate at the twin."""
    scans = scans_at(room(), turning_at(10.2, 1.6), np.random.default_rng(2))
    aliasing = aliasing_of(room().grid())
    crowded = []
    for scan in scans:
        beams = scan.beams
        near = beams.points.copy()
        away = near - beams.origins
        hidden = np.arange(len(near)) < 0.7 * len(near)
        near[hidden] = (beams.origins + 0.4 * away / np.linalg.norm(away, axis=1)[:, None])[hidden]
        crowded.append(dataclasses.replace(scan, beams=dataclasses.replace(beams, points=near)))
    (same,) = aliasing.find(crowded, TWIN)
    np.testing.assert_array_equal(same.xyt, np.zeros(3))


def test_a_heading_a_little_off_is_no_other_place():
    here = SE2.from_xyt(-5.25, 2.42, 2.41)
    assert not apart(here, SE2.from_xyt(-5.17, 2.46, 3.14))
    assert apart(here, SE2.from_xyt(-5.17, 2.46, 2.41 + math.pi))
    assert apart(here, SE2.from_xyt(-5.25, 1.2, 2.41))


@pytest.mark.slow
def test_the_same_seed_finds_the_same_hypotheses(far):
    for a, b in zip(far[1], find_far(SE2.identity())[1], strict=True):
        np.testing.assert_array_equal(a.xyt, b.xyt)


def test_what_stops_the_robot_under_one_hypothesis_stops_it():
    costmap = costmap_from_grid(room().grid(), CostmapConfig())
    both = passable_under_all(costmap, [SE2.identity(), TWIN])
    assert both.clearance_at(np.array([10.82, 2.0])) == 0.0
    assert both.clearance_at(TWIN @ np.array([10.82, 2.0])) == 0.0
    assert costmap.clearance_at(TWIN @ np.array([10.82, 2.0])) > 0.0
    assert np.all(both.lethal[costmap.lethal])


def test_a_keepout_under_any_hypothesis_is_one_but_for_walls():
    area = np.array([[1.0, 1.0], [3.0, 1.0], [3.0, 3.0], [1.0, 3.0]])
    costmap = costmap_from_grid(room().grid(), CostmapConfig(), [area])
    both = passable_under_all(costmap, [SE2.identity(), TWIN])
    walls = passable_under_all(costmap_from_grid(room().grid(), CostmapConfig()), [SE2.identity(), TWIN])
    assert np.array_equal(both.keepout, both.lethal & ~walls.lethal)
    here, there = (both.clearance_at(T @ np.array([2.0, 2.0])) for T in (SE2.identity(), TWIN))
    assert here == there == 0.0
    assert both.keepout.sum() > 1.8 * costmap.keepout.sum()


def test_the_drive_goes_to_the_nearest_place_that_differs_and_not_twice():
    walls, both = costmap_from_grid(room().grid(), CostmapConfig()), [SE2.identity(), TWIN]
    floor = passable_under_all(walls, both)
    start = SE2.from_xyt(7.0, 1.6, 0.0)
    place = nearest_difference(walls, both, floor, 0.2, start, [])
    # A metre from the cupboard, which is there under one hypothesis alone.
    assert 9.75 < place.x < 10.0
    assert floor.clearance_at(place.xy) > 0.2
    # From the other half the nearest one is its twin.
    mirrored = nearest_difference(walls, both, floor, 0.2, TWIN @ start, [])
    assert 2.0 < mirrored.x < 2.25
    other = nearest_difference(walls, both, floor, 0.2, start, [place.xy])
    assert 0.5 < np.linalg.norm(other.xy - place.xy) < 0.6


@pytest.mark.parametrize("here", [0, 1, 2])
def test_what_differs_behind_a_wall_is_not_seen(here):
    """Three equal rooms on a corridor: the room next door is there, or is not, behind a wall of all rooms."""
    lethal, pitch = np.ones((100, 200), dtype=bool), 3.1
    lethal[8:38, 10:196] = False
    for k in range(3):
        left = 10 + 62 * k
        lethal[40:, left : left + 60] = lethal[38:40, left + 20 : left + 40] = False
    lethal[-2:] = True
    walls = Costmap(lethal, 0.05, SE2.identity())
    rooms = [SE2.from_xyt(pitch * (k - here), 0.0, 0.0) for k in range(3)]
    start = SE2.from_xyt(2.0 + pitch * here, 3.5, 0.0)
    place = nearest_difference(walls, rooms, passable_under_all(walls, rooms), 0.2, start, [])
    assert place.y < 2.0  # in the corridor, near one of its ends


def test_where_the_walls_are_alike_no_place_differs_whatever_is_kept_out_of():
    area = np.array([[1.0, 1.0], [3.0, 1.0], [3.0, 3.0], [1.0, 3.0]])
    both = [SE2.identity(), TWIN]
    costmap = costmap_from_grid(room(cupboard=False).grid(), CostmapConfig(), [area])
    floor = passable_under_all(costmap, both)
    start = SE2.from_xyt(7.0, 1.6, 0.0)
    assert nearest_difference(walls_of(costmap), both, floor, 0.2, start, []) is None
    assert nearest_difference(costmap, both, floor, 0.2, start, []) is not None


def tools_on(walls, planned=lambda now_ns, poses: None):
    """What a burger uses on a map."""
    return Tools(
        BURGER.model,
        Pursuit(BURGER.model, 0.1),
        CollisionMonitor(BURGER.model),
        ObstacleLayer(walls, Marking(hits=1, obstacle_range=99.0)),
        PlanConfig(),
        GoalCheckerConfig(),
        RecoveryConfig(),
        SimpleNamespace(plan=planned),
        1,
    )


@pytest.mark.parametrize(("post_m", "possible"), [(0.2, False), (0.35, False), (0.7, True)])
def test_a_robot_does_not_back_into_what_it_has_seen_before(post_m, possible):
    """The lidar, which looks ahead, sees nothing there now; at 0.2 m a post is passed on the way."""
    tools = tools_on(costmap_from_grid(room().grid(), CostmapConfig()))
    pose, back = SE2.from_xyt(6.5, 2.0, 0.0), Twist(-0.1, 0.0)
    aside = 0.08 * (post_m < 0.3)
    tools.obstacles.update(0.0, pose, np.array([[6.5 - post_m, 2.0 + aside]]), np.zeros((0, 2)))
    tick = Tick(10**9, pose, Twist(), Twist(), np.zeros((0, 2)), new_sweep=False, stop=False)
    assert (tools.room_after(back, 0.4, tick) > 0.0) == possible
    assert tools.room_after(Twist(0.1, 0.0), 0.2, tick) > 0.0


def test_where_its_way_is_barred_a_disambiguation_roams_half_a_metre_and_then_goes_elsewhere():
    """The way to the one place is barred by what the lidar sees, for a while."""
    walls, goals = costmap_from_grid(room().grid(), CostmapConfig()), []
    tools = tools_on(walls, lambda now_ns, poses: goals.append(poses.xy[-1]))
    poses, start = [SE2.identity(), TWIN], SE2.from_xyt(6.5, 2.0, 0.0)
    disambiguation = Disambiguation(aliasing_of(room().grid()), poses, tools, 0)
    floor, radius = disambiguation.tools.obstacles, BURGER.model.circumscribed_radius + PADDING_M
    first = nearest_difference(walls, poses, floor.static, radius, start, [])
    across = np.arange(0.0, 4.0, 0.05)
    bars = np.vstack([np.column_stack([np.full(80, first.x + off), across]) for off in (-0.4, 0.4)])
    floor.update(0.0, SE2.from_xyt(6.5, 3.9, 0.0), bars, np.zeros((0, 2)))

    def at(x):
        pose = SE2.from_xyt(x, 2.0, 0.0)
        tick = Tick(10**9, pose, Twist(), Twist(), np.zeros((0, 2)), new_sweep=False, stop=False)
        return disambiguation.command(tick)

    assert at(6.5) is None
    floor.clear()
    assert [at(6.6), at(6.99)] == [None, None]
    assert at(7.01) is not None
    assert len(goals) == 1
    assert np.linalg.norm(goals[0] - first.xy) > SPENT_M


def test_a_hypothesis_that_is_left_behind_over_several_scans_is_dropped():
    hypotheses = PoseHypotheses([SE2.identity(), TWIN, SE2.from_xyt(1.0, 0.0, 0.0)])
    for _ in range(SETTLING - 1):
        assert hypotheses.judge(np.array([0.8, 0.88, 0.5])) is None
        assert len(hypotheses.poses) == 3
    assert hypotheses.judge(np.array([0.84, 0.88, 0.5])) is TWIN
    close = PoseHypotheses([SE2.identity(), TWIN])
    for k in range(100):
        assert close.judge(np.array([0.86, 0.88]) + 0.03 * (-1) ** k) is None


def run(place, tmp_path, config, seed=2, **request):
    path = save_map(place.rasterize(BURGER.lidar_height), tmp_path, "map")
    asked = Request(**{"task": "goal", "seed": seed, "map_path": path, "timeout_s": 90.0} | request)
    mission = prepare_mission(asked, BURGER, config, place.keepout)
    with Simulator(place, BURGER, config.sim, seed) as simulator:
        return drive(simulator, mission)


class NotingPlanner(OmplPlanner):
    """A user's planner that notes where plans begin."""

    starts: ClassVar[list[SE2]] = []

    def plan(self, costmap, model, T_map_start, T_map_goal, seed):
        self.starts.append(T_map_start)
        return super().plan(costmap, model, T_map_start, T_map_goal, seed)


@pytest.mark.slow
def test_a_robot_that_wakes_up_in_one_of_two_places_finds_out_which_and_arrives(tmp_path):
    """It takes itself to be in the other one first."""
    start, goal = TWIN @ SE2.from_xyt(5.0, 2.4, 0.3), TWIN @ SE2.from_xyt(4.8, 3.0, 0.0)
    config = NavigateConfig(plan=PlanConfig(planner=f"{__name__}:NotingPlanner"))
    NotingPlanner.starts.clear()
    episode = run(world(), tmp_path, config, initial_pose="global", start=start, goal=goal)
    assert "disambiguate" in episode.log.state
    # The way to the goal begins where the estimate is after it was moved.
    true = episode.log.T_world_base.xy
    off = [np.linalg.norm(true - place.xy, axis=1).min() for place in NotingPlanner.starts]
    assert off[-1] < 0.05
    (outcome,) = episode.metrics["goals"]
    assert outcome["status"] == "reached"
    assert outcome["error_m"] < 0.05
    assert not any(episode.metrics["collisions"].values())


@pytest.mark.slow
def test_where_nothing_tells_them_apart_it_roams_no_goal_counts_and_the_reason_is_said(tmp_path):
    config = NavigateConfig(relocalise=RelocaliseConfig(disambiguate=20.0))
    goal = SE2.from_xyt(4.8, 3.0, 0.0)
    episode = run(world(cupboard=False), tmp_path, config, initial_pose="global", goal=goal)
    (outcome,) = episode.metrics["goals"]
    assert outcome["status"] != "reached"
    # One place alone in its cloud has a competing hypothesis; with both in it the robot says that it is lost.
    assert REASON in outcome["reason"] or LOST in outcome["reason"]
    assert episode.metrics["distance_m"] > 1.0
    assert not any(episode.metrics["collisions"].values())


@pytest.mark.slow
def test_disambiguation_is_bounded_in_time(tmp_path):
    config = NavigateConfig(relocalise=RelocaliseConfig(disambiguate=2.0))
    goal = SE2.from_xyt(4.8, 3.0, 0.0)
    episode = run(world(), tmp_path, config, initial_pose="global", goal=goal)
    (outcome,) = episode.metrics["goals"]
    assert (outcome["status"], outcome["reason"]) == ("unreachable", REASON)
    states = np.array(episode.log.state) == "disambiguate"
    assert states.sum() / 30.0 < 2.5


@pytest.mark.slow
def test_carried_off_at_the_goal_the_last_scan_is_asked_before_the_goal_counts(tmp_path):
    arena, goal = load_world("turtlebot3_world"), SE2.from_xyt(-1.6, -0.5, 0.0)
    quiet = run(arena, tmp_path, NavigateConfig(), initial_pose="start", goal=goal)
    at = quiet.log.state.index("arrived")
    kidnap = FaultConfig(kidnap=((float(quiet.log.t_ns[at] * 1e-9) - 0.4, -0.55, -0.55, 2.0),))
    config = NavigateConfig(sim=SimConfig(faults=kidnap))
    episode = run(arena, tmp_path, config, initial_pose="start", goal=goal)
    (outcome,) = episode.metrics["goals"]
    assert outcome["status"] == "reached"
    assert outcome["error_m"] < 0.05
    assert "look" in episode.log.state
