"""Movers: where they go, and that lidar, contacts and clearance include them."""

import dataclasses

import numpy as np
import pytest

from turtlebag.datasets.se2 import SE2
from turtlebag.datasets.types import Twist
from turtlebag.sim.movers import Mover, MovingSolid
from turtlebag.sim.nearby import Nearby
from turtlebag.sim.raycast import distance_to_point
from turtlebag.sim.robots import load_robot
from turtlebag.sim.shapes import box, cylinder
from turtlebag.sim.simulator import SimConfig, Simulator
from turtlebag.sim.worlds import load_world

BURGER = load_robot("burger")
EMPTY, ARENA = load_world("empty"), load_world("turtlebot3_world")
POST = cylinder("post", (0.0, 0.0), 0.2, (0.0, 1.0))
QUIET = SimConfig(lidar={"noise": "none"})


def walk(mover, steps, world=EMPTY, robot=(99.0, 99.0), seed=0):
    one = MovingSolid(mover, Nearby(world.touchable(0.2), 3.0), 0.15, np.random.default_rng(seed))
    places = [one.position.copy()]
    for _ in range(steps):
        one.step(1.0 / 30.0, np.array(robot))
        places.append(one.position.copy())
    return np.array(places)


def test_a_mover_goes_to_and_fro_at_its_speed():
    places = walk(Mover(POST, np.array([[0.0, 0.0], [1.0, 0.0]]), 0.5), 180)
    np.testing.assert_allclose(places[60], [1.0, 0.0], atol=1e-9)
    np.testing.assert_allclose(places[120], [0.0, 0.0], atol=1e-9)
    np.testing.assert_allclose(np.linalg.norm(np.diff(places, axis=0), axis=1)[:50], 0.5 / 30.0)


def test_a_loop_is_gone_round():
    path = np.array([[0.0, 0.0], [1.0, 0.0], [1.0, 1.0], [0.0, 1.0]])
    places = walk(Mover(POST, path, 1.0, loop=True), 120)
    for second, corner in enumerate([*path[1:], path[0]], start=1):
        np.testing.assert_allclose(places[30 * second], corner, atol=1e-9)


def test_a_wanderer_stays_in_its_area_and_off_the_walls():
    mover = Mover(POST, np.array([[-2.0, 0.0]]), 0.6, wander=True, area=(-2.5, 2.0, -2.0, 2.0))
    places = walk(mover, 1500, world=ARENA, seed=3)
    outlines = ARENA.touchable(0.2)
    room = min(distance_to_point(x, y, outlines.segments, outlines.circles) for x, y in places)
    assert room > 0.2 + 0.1
    assert np.ptp(places, axis=0).max() > 1.0
    assert np.all((places >= (-2.5, -2.0)) & (places <= (2.0, 2.0)))
    np.testing.assert_array_equal(places, walk(mover, 1500, world=ARENA, seed=3))


def test_one_that_yields_waits_for_the_robot_and_others_do_not():
    path = np.array([[0.0, 0.0], [3.0, 0.0]])
    polite = walk(Mover(POST, path, 0.5, yields=True), 200, robot=(1.5, 0.0))
    rude = walk(Mover(POST, path, 0.5), 200, robot=(1.5, 0.0))
    assert polite[-1, 0] < 1.5 - 0.2 - 0.15
    assert rude[:, 0].max() > 2.5


def scene(*movers):
    return dataclasses.replace(EMPTY, movers=movers)


def test_the_lidar_sees_a_mover_where_it_is_when_the_beam_is_taken():
    wall = box("board", (0.0, 0.0), (0.1, 4.0), 0.0, (0.0, 1.0))
    mover = Mover(wall, np.array([[3.0, 0.0], [-3.0, 0.0]]), 1.0)
    with Simulator(scene(mover), BURGER, QUIET, 0) as simulator:
        simulator.reset()
        scan = [o.scan for o in (simulator.step(Twist()) for _ in range(30)) if o.scan is not None][-1]
    # At 0.8 s the board's face is at 3 - 0.8 - 0.05; the beam at 359 degrees is taken 0.2 s later.
    assert scan.ranges[0] == pytest.approx(2.15 + 0.032, abs=0.04)
    assert scan.ranges[359] == pytest.approx(1.95 + 0.032, abs=0.04)


def test_contact_with_a_mover_counts_and_pushes_the_robot():
    mover = Mover(POST, np.array([[1.0, 0.0], [-3.0, 0.0]]), 0.3)
    with Simulator(scene(mover), BURGER, QUIET, 0) as simulator:
        simulator.reset()
        touched, clearances = False, []
        for _ in range(150):
            simulator.step(Twist())
            touched |= simulator.truth.contact_visible
            clearances.append(simulator.clearance())
        assert touched
        assert float(simulator.truth.T_world_base.x) < -0.1
    # 1 m away, radius 0.2, the footprint 0.041 ahead; coming nearer at 0.3 m/s.
    assert clearances[0] == pytest.approx(1.0 - 0.2 - 0.041 - 0.01, abs=0.01)
    assert clearances[29] == pytest.approx(clearances[0] - 0.29, abs=0.01)


def test_a_low_mover_is_felt_but_not_seen():
    low = cylinder("low", (0.0, 0.0), 0.3, (0.0, 0.05))
    mover = Mover(low, np.array([[1.0, 0.0], [-3.0, 0.0]]), 0.3)
    with Simulator(scene(mover), BURGER, QUIET, 0) as simulator:
        simulator.reset()
        observations = [simulator.step(Twist()) for _ in range(6)]
        assert np.all(np.isinf(observations[-1].scan.ranges))
        seen = [(simulator.step(Twist()), simulator.truth)[1] for _ in range(120)]
    assert any(truth.contact_low for truth in seen)
    assert not any(truth.contact_visible for truth in seen)


def test_movers_come_from_world_files(tmp_path):
    path = tmp_path / "w.yaml"
    path.write_text(
        "name: w\nspawn: [0, 0, 0]\nbounds: [-5, 5, -5, 5]\nshapes: []\nmovers:\n"
        "  - {name: cart, size: [0.4, 0.3], path: [[2, 0], [2, 2]], speed: 0.4, loop: true}\n"
        "  - {name: person, radius: 0.2, path: [[-2, 0]], speed: 0.5, wander: [-4, 0, -4, 4], yields: true}\n"
    )
    cart, person = load_world(str(path)).movers
    assert cart.loop
    assert person.wander
    with Simulator(load_world(str(path)), BURGER, QUIET, 0) as simulator:
        simulator.reset(SE2.identity())
        for _ in range(12):
            simulator.step(Twist())
        assert simulator.clearance() < 2.0
