"""Teleop scripts in any world: their routes, their motion, and that they touch nothing."""

import itertools
import time

import numpy as np
import pytest

from turtlebag.datasets.errors import InputError
from turtlebag.datasets.se2 import SE2
from turtlebag.datasets.types import Twist
from turtlebag.sim.raycast import distance_to_point, roomiest
from turtlebag.sim.robots import load_robot
from turtlebag.sim.routes import EXACT_SIDE_M, ROUTES, RoutePlanner, random_goals, route
from turtlebag.sim.script_driver import Stuck
from turtlebag.sim.simulator import SimConfig, Simulator, Truth
from turtlebag.sim.teleop_scripts import Script, commands, load_script, script_names
from turtlebag.sim.worlds import load_world

BURGER = load_robot("burger")
QUICK = SimConfig(lidar={"turning": False, "noise": "none"}, imu={"enabled": False})


def drive(script, world="turtlebot3_world", seed=1, contacts_allowed=False):
    """True poses (n, 3) and least clearance of a drive that touched nothing."""
    world = load_world(world)
    poses, clearance = [], np.inf
    with Simulator(world, BURGER, QUICK, seed) as simulator:
        simulator.reset()
        driver = commands(script, world, BURGER, seed)
        next(driver)
        while True:
            truth = simulator.truth
            touching = truth.contact_visible or truth.contact_low
            assert contacts_allowed or not touching
            poses.append(truth.T_world_base.xyt)
            clearance = min(clearance, simulator.clearance())
            try:
                simulator.step(driver.send(truth))
            except StopIteration:
                return np.array(poses), clearance


def script(*steps, **options):
    return Script(name="test", steps=list(steps), **options)


@pytest.mark.slow
def test_built_in_scripts_load_in_every_kind_of_world():
    assert {"fast", "perimeter_then_rooms", "random_walk", "spiral", "tour", "wall_follow"} <= set(
        script_names()
    )
    for name, world in itertools.product(script_names(), ("turtlebot3_world", "maze:1,cells=4")):
        next(commands(load_script(name), load_world(world), BURGER, 1))


def test_steps_that_take_no_time_are_over_however_often_they_are_repeated():
    for_ever = {"repeat": 10**5, "steps": [{"wait": 0.0}, {"repeat": 10**5, "steps": [{"through": []}]}]}
    driver = commands(script(for_ever), load_world("empty"), BURGER, 1)
    next(driver)
    with pytest.raises(StopIteration):
        driver.send(Truth(0, SE2.identity(), Twist(), False, False))


@pytest.mark.slow
@pytest.mark.parametrize("world", ["turtlebot3_world", "maze:1,cells=5", "office:2", "forest:3,size=8"])
@pytest.mark.parametrize("name", sorted(ROUTES))
def test_a_planned_route_keeps_clear_and_passes_near_all_of_the_floor(world, name):
    planner = RoutePlanner(load_world(world), BURGER)
    points = ROUTES[name](planner)
    outlines = planner.world.touchable(BURGER.height)
    line = np.vstack(
        [a + np.linspace(0.0, 1.0, 40)[:, None] * (b - a) for a, b in itertools.pairwise(points)]
    )
    room = min(distance_to_point(x, y, outlines.segments, outlines.circles) for x, y in line)
    assert room > BURGER.model.circumscribed_radius + 0.05
    farthest = max(np.hypot(*(line - place).T).min() for place in planner.places[::7])
    assert farthest < 2.3
    assert np.hypot(*(points[-1] - planner.world.spawn.xy)) < 0.2


def test_a_worlds_own_route_is_for_robots_that_fit():
    world = load_world("turtlebot3_world")
    np.testing.assert_array_equal(route("tour", RoutePlanner(world, BURGER)), world.routes["tour"])
    between = RoutePlanner(world, load_robot("waffle_pi"))
    assert between.fits(world.routes["tour"], EXACT_SIDE_M)
    assert not between.fits(world.routes["tour"])
    wide = RoutePlanner(world, load_robot("jackal"))
    assert not wide.fits(world.routes["tour"])
    assert wide.fits(route("tour", wide)[1:])


@pytest.mark.slow
def test_turn_then_drive_does_one_at_a_time_and_flowing_does_not_stop():
    points = {"through": [[-2.0, 0.3], [-1.7, 0.55], [-0.6, 0.55]]}
    slow, _ = drive(script(points))
    fast, _ = drive(script(points, style="flowing", v=0.22, w=2.0))
    assert len(fast) < 0.7 * len(slow)
    for poses in (slow, fast):
        np.testing.assert_allclose(poses[-1, :2], [-0.6, 0.55], atol=0.08)
    speed = np.linalg.norm(np.diff(fast[:, :2], axis=0), axis=1) * 30.0
    assert np.mean(speed[90:-30] < 0.02) < 0.05


@pytest.mark.slow
def test_spiral_turns_while_driving_all_the_time():
    poses, clearance = drive(
        script({"through": [[-1.9, 0.0], [-1.7, 0.55], [0.0, 0.55]]}, style="spiral", w=1.2)
    )
    speed = np.linalg.norm(np.diff(poses[:, :2], axis=0), axis=1) * 30.0
    rate = np.abs(np.diff(np.unwrap(poses[:, 2]))) * 30.0
    assert np.mean((speed > 0.05) & (rate > 0.2)) > 0.5
    assert np.abs(np.diff(np.unwrap(poses[:, 2]))).sum() > 4.0 * np.pi
    assert clearance > 0.1


@pytest.mark.slow
def test_wall_follow_keeps_the_wall_at_its_distance_to_the_right():
    world = load_world("turtlebot3_world")
    outlines = world.touchable(BURGER.height)
    poses, _ = drive(script({"wall_follow": 60.0}, v=0.2, w=1.0))
    following = poses[-1500:]
    room = [distance_to_point(x, y, outlines.segments, outlines.circles) for x, y in following[:, :2]]
    aside = BURGER.model.circumscribed_radius + 0.2
    assert np.mean(np.abs(np.array(room) - aside) < 0.06) > 0.95
    to_the_right = following[:, :2] + 0.25 * np.stack([np.sin(following[:, 2]), -np.cos(following[:, 2])], -1)
    nearer = [distance_to_point(x, y, outlines.segments, outlines.circles) for x, y in to_the_right]
    assert np.mean(np.array(nearer) < np.array(room)) > 0.95


@pytest.mark.slow
def test_random_walk_depends_on_the_seed_alone():
    planner = RoutePlanner(load_world("office:2"), BURGER)
    walks = [random_goals(planner, np.random.default_rng(seed), 20.0) for seed in (1, 1, 2)]
    np.testing.assert_array_equal(walks[0], walks[1])
    assert walks[0].shape != walks[2].shape or not np.allclose(walks[0], walks[2])
    assert np.linalg.norm(np.diff(walks[0], axis=0), axis=1).sum() >= 19.0
    poses, clearance = drive(script({"random_walk": 3.0}))
    assert clearance > 0.05
    assert np.linalg.norm(np.diff(poses[:, :2], axis=0), axis=1).sum() > 2.5


def test_where_nothing_stands_the_tour_is_a_square():
    route = RoutePlanner(load_world("empty"), BURGER)
    from turtlebag.sim.routes import square

    assert np.ptp(square(route), axis=0) == pytest.approx([2.0, 2.0])
    with pytest.raises(InputError, match="no wall"):
        drive(script({"wall_follow": 5.0}), world="empty")


@pytest.mark.slow
def test_driving_into_a_wall_ends_as_stuck():
    with pytest.raises(Stuck):
        drive(script({"turn_deg": 180}, {"drive": 3.0}), contacts_allowed=True)


def test_room_on_a_floor_of_thousands_of_things_is_found_in_seconds():
    rng = np.random.default_rng(1)
    ends = rng.uniform(-20.0, 20.0, (3000, 2))
    segments = np.hstack([ends, ends + rng.normal(size=ends.shape) * 0.2])
    circles = np.column_stack([rng.uniform(-20.0, 20.0, (500, 2)), rng.uniform(0.05, 0.3, 500)])
    x, y = np.arange(-20.0, 20.0, 0.1), np.arange(-20.0, 20.05, 0.1)
    roomiest(x[:1], y[:1], 0.05, 0.2, segments, circles)  # compiles it
    begun = time.process_time()
    room, points = roomiest(x, y, 0.05, 0.2, segments, circles)
    assert time.process_time() - begun < 5.0
    for r, c in rng.integers(0, 400, (50, 2)):
        assert room[r, c] == distance_to_point(*points[r, c], segments, circles)
        assert room[r, c] >= distance_to_point(x[c], y[r], segments, circles)
