import math
from dataclasses import replace

import numpy as np
import pytest

from tests.helpers.planning_room import BURGER, room
from turtlebag.datasets.se2 import SE2
from turtlebag.datasets.types import Twist
from turtlebag.pipeline.navigation.guarded_avoidance import GuardedAvoidance
from turtlebag.pipeline.navigation.obstacle_memory import ObstacleMemory
from turtlebag.pipeline.navigation.sensing import DeskewedScan
from turtlebag.planners.costmap import Costmap, CostmapConfig, clearance_field, costmap_from_grid
from turtlebag.planners.obstacle_layer import Marking, ObstacleLayer
from turtlebag.planners.tasks.recovery import Ladder, ProgressWatch, RecoveryConfig
from turtlebag.planners.tasks.sector_rule import Decision, Sectors
from turtlebag.sim.robots import load_robot

NOTHING = np.zeros((0, 2))


def layer(**settings) -> ObstacleLayer:
    return ObstacleLayer(costmap_from_grid(room(60, 60), CostmapConfig()), Marking(**settings))


def test_two_sweeps_mark_what_the_map_does_not_know_and_the_clearance_is_exact():
    obstacles = layer()
    origin, hit = SE2.from_xyt(-0.2, 0.5, 0.0), np.array([[0.77, 0.52]])
    obstacles.update(0.0, origin, hit, NOTHING)
    assert obstacles.marked == 0
    obstacles.update(0.2, origin, hit, NOTHING)
    assert obstacles.marked == 1
    expected = clearance_field(obstacles.costmap.lethal, 0.05)
    near = expected < 1.0
    np.testing.assert_allclose(obstacles.costmap.clearance[near], expected[near], atol=1e-6)


def test_known_walls_are_not_marked():
    obstacles = layer()
    wall = np.array([[-0.98, 0.5], [-0.95, 0.6], [-0.91, 0.7]])
    for k in range(4):
        obstacles.update(0.2 * k, SE2.from_xyt(0.3, 0.5, 0.0), wall, NOTHING)
    assert obstacles.marked == 0


def test_beams_that_pass_clear_and_time_forgets():
    obstacles = layer(decay=5.0)
    origin, hit = SE2.from_xyt(-0.2, 0.5, 0.0), np.array([[0.77, 0.52]])
    for k in range(3):
        obstacles.update(0.2 * k, origin, hit, NOTHING)
    obstacles.update(0.8, origin, NOTHING, np.array([[1.77, 0.54]]))
    assert obstacles.marked == 0
    for k in range(3):
        obstacles.update(1.0 + 0.2 * k, origin, hit, NOTHING)
    assert obstacles.marked == 1
    obstacles.update(9.0, origin, NOTHING, NOTHING)
    assert obstacles.marked == 0
    assert obstacles.costmap is obstacles.static


def test_a_way_out_of_a_keepout_is_open_until_a_plan_is_made_from_elsewhere():
    area = np.array([[0.0, -0.5], [2.0, -0.5], [2.0, 2.5], [0.0, 2.5]])
    closed = costmap_from_grid(room(60, 60), CostmapConfig(), [area])
    obstacles, inside, hit = ObstacleLayer(closed), SE2.from_xyt(0.6, 0.5, 0.0), np.array([[-0.53, 0.52]])
    for now in (0.0, 0.2):
        obstacles.update(now, SE2.from_xyt(-0.8, 0.5, 0.0), hit, NOTHING)
    obstacles.let_out(inside, 0.15)
    for costmap in (obstacles.static, obstacles.costmap):
        assert costmap.clearance_at(inside.xy) > 0.15
        assert costmap.clearance_at(np.array([1.5, 0.5])) == 0.0
    assert obstacles.marked == 1
    assert obstacles.costmap.clearance_at(hit[0]) == 0.0
    obstacles.let_out(SE2.from_xyt(-0.6, 0.5, 0.0), 0.15)
    assert obstacles.static is closed
    assert obstacles.costmap.clearance_at(inside.xy) == obstacles.costmap.clearance_at(hit[0]) == 0.0


def test_the_ladder_is_bounded_and_starts_again_after_progress():
    cleared = []
    config = RecoveryConfig(total=11)
    ladder = Ladder(config, lambda: cleared.append(1))
    pose = SE2.identity()
    names = [ladder.climb(0, pose).name for _ in config.ladder]
    assert names[:3] == ["recover_wait", "recover_clear", "recover_back_up"]
    assert len(cleared) == 1
    assert ladder.climb(0, pose) is None
    ladder.rest()
    assert ladder.climb(0, pose) is not None
    assert ladder.climb(0, pose) is not None
    assert ladder.climb(0, pose) is None


def test_backing_up_ends_after_its_distance_or_its_time():
    ladder = Ladder(RecoveryConfig(), lambda: None)
    start = SE2.from_xyt(1.0, 1.0, 0.0)
    ladder.climb(0, start)
    ladder.climb(0, start)
    back = ladder.climb(0, start)
    assert back.command(0, start).v < 0.0
    assert back.command(10**9, SE2.from_xyt(0.84, 1.0, 0.0)) is None
    assert back.command(60 * 10**9, start) is None


def test_standing_still_is_noticed_and_turning_is_not_standing():
    watch = ProgressWatch(2.0)
    pose = SE2.from_xyt(0.0, 0.0, 0.0)
    assert not watch.stuck(0, pose)
    assert not watch.stuck(10**9, pose)
    assert watch.stuck(3 * 10**9, pose)
    watch.reset()
    for k in range(20):
        assert not watch.stuck(k * 10**9, SE2.from_xyt(0.0, 0.0, 0.3 * k))


HERE, NONE = SE2.identity(), np.zeros((0, 2))


def sweep(points_base, sectors, pose=HERE, now=0.0):
    return DeskewedScan(round(now * 1e9), pose, pose @ points_base, NONE, sectors)


def passed(avoidance, wanted, view):
    avoidance.decision = Decision("asked for", wanted)
    return avoidance.command(view, HERE, Twist(), new_sweep=False)


def avoidance_and_view(points_base, pose=None, now=0.0, sectors=None):
    pose = pose or SE2.identity()
    sectors = sectors or Sectors(1.0, 2.0, 1.0)
    return GuardedAvoidance(BURGER, ObstacleMemory(BURGER)), sweep(points_base, sectors, pose, now)


def circle(radius=2.0, n=360):
    angle = np.linspace(-math.pi, math.pi, n, endpoint=False)
    return np.stack([radius * np.cos(angle), radius * np.sin(angle)], axis=1)


def test_the_guard_turns_to_the_freer_side_and_stops_dithering():
    avoidance, _ = avoidance_and_view(circle())

    def turn(left: float, right: float) -> float:
        return avoidance.decide(sweep(circle(), Sectors(left, 0.4, right)), HERE, Twist()).command.w

    assert turn(1.0, 1.0) < 0.0
    assert turn(1.2, 1.0) > 0.0
    assert turn(1.0, 1.2) < 0.0
    assert turn(1.2, 1.0) > 0.0
    # The third change of mind was the last one, until the way was free.
    assert turn(1.0, 1.2) > 0.0
    avoidance.decide(sweep(circle(), Sectors(1.0, 2.0, 1.2), now=1.0), HERE, Twist())
    assert turn(1.0, 1.2) < 0.0


def test_the_guard_lets_nothing_pass_that_touches():
    touching = np.concatenate([circle(), [[0.06, 0.0], [0.06, 0.03]]])
    avoidance, view = avoidance_and_view(touching)
    assert passed(avoidance, Twist(0.2, 0.0), view).v < 0.05
    assert passed(avoidance, Twist(-0.1, 0.0), view).v == -0.1


def test_the_guard_notices_wheels_that_turn_in_vain_and_backs_off():
    rng = np.random.default_rng(0)
    xs, ys = np.linspace(-2.0, 2.0, 60), np.linspace(-1.5, 1.5, 50)
    walls = [[[x, y] for x in xs] for y in (-1.5, 1.5)] + [[[x, y] for y in ys] for x in (-2.0, 2.0)]
    room_points = np.concatenate([np.array(wall) for wall in walls])
    avoidance = GuardedAvoidance(BURGER, ObstacleMemory(BURGER))
    moving, standing = 0, 0
    for k in range(10):
        pose = SE2.from_xyt(0.04 * k, 0.0, 0.0)
        seen_moving = room_points + rng.normal(0.0, 0.01, room_points.shape)
        new = DeskewedScan(k * 10**8, pose, seen_moving, NONE, Sectors(1.5, 2.0, 1.5))
        moving += avoidance.decide(new, pose, Twist(0.2, 0.0)).command.v < 0.0
    for k in range(10):
        pose = SE2.from_xyt(0.4 + 0.04 * k, 0.0, 0.0)
        # The robot stands at 0.4 while odometry goes on: the sweep moves along with it.
        seen = room_points + np.array([0.04 * k, 0.0]) + rng.normal(0.0, 0.01, room_points.shape)
        new = DeskewedScan((20 + 2 * k) * 10**8, pose, seen, NONE, Sectors(1.5, 2.0, 1.5))
        decision = avoidance.decide(new, pose, Twist(0.2, 0.0))
        if decision.command.v < 0.0:
            standing += 1
            break
    assert moving == 0
    assert standing == 1
    assert len(avoidance.points_base(new, pose)) > len(seen)


@pytest.mark.parametrize("name", ["burger", "waffle_pi", "jackal"])
@pytest.mark.parametrize("speed", [0.2, -0.2])
def test_what_nobody_sees_is_remembered_outside_the_robot(name, speed):
    model = load_robot(name).model
    avoidance = GuardedAvoidance(model, ObstacleMemory(model))
    view = sweep(circle(), Sectors(1.0, 2.0, 1.0))
    # Odometry goes on, and what is seen stays where it was.
    before = SE2.from_xyt(math.copysign(-0.11, speed), 0.0, 0.0)
    avoidance.decide(replace(view, hits_odom=before @ view.hits_odom), before, Twist(speed, 0.0))
    avoidance.decide(view, HERE, Twist(speed, 0.0))
    remembered = avoidance.points_base(view, HERE)[len(view.hits_odom) :]
    tail, nose = model.footprint[:, 0].min(), model.footprint[:, 0].max()
    beyond = remembered[:, 0] - nose if speed > 0.0 else tail - remembered[:, 0]
    assert np.ptp(remembered[:, 1]) >= np.ptp(model.footprint[:, 1])
    assert np.all((beyond > 0.0) & (beyond < 0.06))
    # It slows the way towards it, and leaves the other one open.
    assert abs(passed(avoidance, Twist(speed, 0.0), view).v) < 0.9 * abs(speed)
    assert passed(avoidance, Twist(-speed, 0.0), view).v == -speed


def test_an_escape_from_a_corner_is_found_where_one_exists():
    # Walls close ahead and to the left, room to the right and behind.
    ahead = [[0.12, y] for y in np.linspace(-0.3, 0.2, 40)]
    left = [[x, 0.14] for x in np.linspace(-0.2, 0.12, 40)]
    avoidance = GuardedAvoidance(BURGER, ObstacleMemory(BURGER))
    view = sweep(np.array(ahead + left), Sectors(0.14, 0.12, 2.0))
    assert avoidance.command(view, HERE, Twist(), new_sweep=True) != Twist()


def test_costmaps_of_a_live_layer_keep_their_frame():
    obstacles = layer()
    assert isinstance(obstacles.costmap, Costmap)
    np.testing.assert_array_equal(obstacles.costmap.T_map_grid.xyt, obstacles.static.T_map_grid.xyt)
