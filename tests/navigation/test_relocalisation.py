"""Relocalisation: a robot that is lost, kidnapped or blind stops, recovers its pose, or gives a reason."""

import math

import numpy as np
import pytest

from turtlebag.datasets.maps import save_map
from turtlebag.datasets.se2 import SE2
from turtlebag.pipeline.localisation.lost_detection import DOUBTS
from turtlebag.pipeline.navigation.config import NavigateConfig
from turtlebag.pipeline.navigation.driver_setup import prepare
from turtlebag.pipeline.navigation.episode import drive
from turtlebag.pipeline.navigation.goal_states import Event, Machine
from turtlebag.pipeline.navigation.mission import Request
from turtlebag.pipeline.navigation.navigator import LOST
from turtlebag.pipeline.navigation.pose_watch import PoseWatch, RelocaliseConfig
from turtlebag.planners.tasks.patrol import GoalSequence, SequenceConfig
from turtlebag.planners.tasks.waypoints import Waypoint
from turtlebag.sim.faults import FaultConfig
from turtlebag.sim.robots import load_robot
from turtlebag.sim.simulator import SimConfig, Simulator
from turtlebag.sim.worlds import load_world

S = 10**9
ARENA, BURGER = load_world("turtlebot3_world"), load_robot("burger")


def run(map_path, faults, restarts=2, **request):
    config = NavigateConfig(sim=SimConfig(faults=faults), relocalise=RelocaliseConfig(restarts=restarts))
    asked = Request(**{"task": "goal", "seed": 1, "map_path": map_path, "initial_pose": "start"} | request)
    mission = prepare(asked, BURGER, config, ARENA.keepout)
    with Simulator(ARENA, BURGER, config.sim, asked.seed) as simulator:
        return drive(simulator, mission)


@pytest.fixture(scope="module")
def house_map(tmp_path_factory):
    """A map of another world than the robot is in."""
    grid = load_world("turtlebot3_house").rasterize(BURGER.lidar_height)
    return save_map(grid, tmp_path_factory.mktemp("house"), "house")


@pytest.mark.slow
def test_a_kidnapped_robot_stops_finds_itself_and_arrives(true_map):
    kidnap = FaultConfig(kidnap=((2.0, 1.6, -0.55, 2.0),))
    episode = run(true_map, kidnap, goal=SE2.from_xyt(1.65, 0.6, 1.57), timeout_s=120.0)
    goal = episode.metrics["goals"][0]
    assert goal["status"] == "reached"
    assert goal["error_m"] < 0.05
    assert "look" in episode.log.state
    assert not any(episode.metrics["collisions"].values())
    # The jump is in the truth, and is not driven.
    steps = np.linalg.norm(np.diff(episode.log.T_world_base.xy, axis=0), axis=1)
    assert steps.max() > 3.0
    assert episode.metrics["distance_m"] == pytest.approx(steps[steps < 0.1].sum())


@pytest.mark.slow
def test_kidnapped_to_an_aliased_place_the_robot_counts_no_goal_before_it_knows_where_it_is(true_map):
    kidnap = FaultConfig(kidnap=((6.0, -1.12, -1.87, 1.63),))
    start, goal = SE2.from_xyt(1.0, 1.7, 0.0), SE2.from_xyt(0.0, 2.0, 0.0)
    episode = run(true_map, kidnap, seed=2, start=start, goal=goal, timeout_s=90.0, keepout=())
    (outcome,) = episode.metrics["goals"]
    assert outcome["status"] == "reached"
    assert outcome["error_m"] < 0.05


@pytest.mark.slow
def test_a_robot_put_into_a_keepout_leaves_it_and_arrives(true_map):
    area = np.array([[-1.1, -1.1], [1.1, -1.1], [1.1, 1.1], [-1.1, 1.1]])
    start, goal = SE2.from_xyt(0.55, 0.55, 1.0), SE2.from_xyt(-0.4, 1.7, 3.14)
    episode = run(true_map, FaultConfig(), start=start, goal=goal, keepout=(area,))
    assert episode.metrics["goals"][0]["status"] == "reached"
    inside = np.all(np.abs(episode.log.T_world_base.xy) < 1.1, axis=1)
    steps = np.linalg.norm(np.diff(episode.log.T_world_base.xy, axis=0), axis=1)
    # 0.55 m to the edge, between two pillars; then round them, and in no more.
    assert steps[inside[1:]].sum() < 0.8
    assert not inside[int(inside.sum()) :].any()


@pytest.mark.slow
def test_a_robot_told_a_pose_in_a_wall_looks_about_and_arrives(true_map):
    initial = SE2.from_xyt(-2.9, -0.4, 0.5)
    goal = SE2.from_xyt(-0.55, -0.55, 0.0)
    episode = run(true_map, FaultConfig(), goal=goal, initial_pose=initial, timeout_s=120.0)
    assert "look" in episode.log.state
    assert episode.metrics["goals"][0]["status"] == "reached"
    assert episode.metrics["goals"][0]["error_m"] < 0.05
    assert not any(episode.metrics["collisions"].values())


@pytest.mark.slow
def test_a_lost_robot_whose_goals_are_out_of_time_looks_for_itself_no_longer(house_map):
    initial, goal = SE2.from_xyt(-3.0, 1.0, 0.0), SE2.from_xyt(-3.0, 2.0, 0.0)
    episode = run(house_map, FaultConfig(), goal=goal, initial_pose=initial, timeout_s=8.0)
    assert "look" in episode.log.state
    assert episode.metrics["goals"][0]["status"] == "timeout"
    assert episode.log.state[-2] == "look"
    assert episode.metrics["time_s"] < 8.5


@pytest.mark.slow
def test_on_the_map_of_another_world_no_goal_counts_as_reached(house_map):
    initial, goal = SE2.from_xyt(-3.0, 1.0, 0.0), SE2.from_xyt(-3.0, 2.0, 0.0)
    episode = run(house_map, FaultConfig(), 1, goal=goal, initial_pose=initial, timeout_s=60.0, seed=0)
    assert episode.log.state.count("arrived") > 0
    (outcome,) = episode.metrics["goals"]
    assert (outcome["status"], outcome["reason"]) == ("unreachable", LOST)


@pytest.mark.slow
def test_the_robot_stands_while_the_lidar_is_silent_and_goes_on_after(true_map):
    episode = run(true_map, FaultConfig(scan_silent=((3.0, 5.0),)), goal=SE2.from_xyt(-0.55, 0.55, 0.0))
    log = episode.log
    t = log.t_ns * 1e-9
    blind = np.array([state == "blind" for state in log.state])
    # The last scan came at 3.0 s at the latest, the next comes at 5.2 s.
    assert 1.4 < blind.sum() / 30.0 < 1.9
    assert np.all(log.v[(t > 4.0) & (t < 5.1)] == 0.0)
    assert episode.metrics["goals"][0]["status"] == "reached"


@pytest.mark.slow
@pytest.mark.parametrize("task", ["avoid", "explore"])
def test_without_a_map_it_stands_in_the_dark_too(task):
    config = NavigateConfig(sim=SimConfig(faults=FaultConfig(scan_silent=((3.0, 5.0),))))
    mission = prepare(Request(task=task, seed=1, duration_s=7.0), BURGER, config)
    with Simulator(ARENA, BURGER, config.sim, 1) as simulator:
        log = drive(simulator, mission).log
    t = log.t_ns * 1e-9
    assert np.all(np.abs(log.v[(t > 4.1) & (t < 5.1)]) < 1e-6)
    assert np.any(np.abs(log.v[t < 3.0]) > 0.05)
    assert np.any(np.abs(log.v[t > 5.3]) > 0.02)


@pytest.mark.slow
def test_a_lidar_that_stays_silent_ends_the_run_with_the_reason(true_map):
    episode = run(true_map, FaultConfig(scan_silent=((3.0, 1e6),)), goal=SE2.from_xyt(0.55, 1.75, 0.0))
    goal = episode.metrics["goals"][0]
    assert (goal["status"], goal["reason"]) == ("unreachable", "the lidar has been silent for 30 s")
    assert episode.metrics["time_s"] < 35.0


def watch(**config):
    return PoseWatch(RelocaliseConfig(**config), Machine())


def test_a_few_doubts_are_nothing_and_many_stop_the_robot():
    task = watch(look=5.0)
    few = DOUBTS - 1
    assert [task.update(k * S, True, False, k) for k in range(1, DOUBTS)] == ["wait"] * few
    assert task.update(3 * S, True, True, 3) == "wait"
    # Time alone, without the filter being asked, is no doubt.
    assert [task.update(k * S, False, True, 3) for k in range(4, 20)] == ["wait"] * 16
    doubts = [task.update((20 + k) * S, False, True, 4 + k) for k in range(DOUBTS)]
    assert doubts == ["wait"] * few + ["look"]
    assert task.update(23 * S, True, True, 8) == "look"
    assert task.update(24 * S, True, True, 9) == "wait"


def test_a_narrow_cloud_is_trusted_when_looking_about_finds_no_better_place():
    task = watch(look=5.0)
    assert [task.update(S, True, False, k) for k in range(1, DOUBTS + 1)][-1] == "look"
    assert task.update(6 * S, True, False, 9) == "wait"
    assert [task.update((6 + k) * S, True, False, 10 + k) for k in range(1, 10)] == ["wait"] * 9
    assert [task.update(22 * S, True, False, 30 + k) for k in range(DOUBTS)][-1] == "look"


def test_what_it_does_when_it_never_finds_out_is_bounded():
    task = watch(look=5.0, roam=10.0, restarts=2)
    states = [task.update(k * S, False, False, k) for k in range(1, 60)]
    turns = [a for a, b in zip(states, [None, *states], strict=False) if a != b]
    assert turns[:10] == ["wait", *["look", "roam", "restart"] * 2, "look", "roam", "give_up"]
    # From then on it may drive, and doubts again: the next goal gets as many tries.
    assert turns[10:12] == ["wait", "look"]


def test_a_goal_that_runs_out_of_time_says_what_the_trouble_was():
    there = Waypoint(SE2.from_xyt(1.0, 0.0, 0.0), "", (1.0, 0.0, 0.0))
    tasks = GoalSequence([there, there], SequenceConfig(initial_wait=0.0, timeout=5.0))
    assert tasks.update(0) is not None
    tasks.update(5 * S, "the lidar is silent")
    assert tasks.outcomes[0].reason == "not reached within 5 s: the lidar is silent"
    tasks.close_all("unreachable", "no lidar", 6 * S)
    assert [o.status for o in tasks.outcomes] == ["timeout", "unreachable"]
    assert math.isclose(tasks.outcomes[0].time_s, 5.0)


def test_an_exploration_that_never_saw_anything_did_not_succeed():
    config = NavigateConfig(sim=SimConfig(faults=FaultConfig(scan_loss=1.0)))
    mission = prepare(Request(task="explore", seed=1, duration_s=1.0), BURGER, config)
    with Simulator(ARENA, BURGER, config.sim, 1) as simulator:
        episode = drive(simulator, mission)
    assert episode.grid is None
    assert episode.metrics["success"] is False


def test_doubts_in_a_row_are_counted_while_hypotheses_are_compared():
    task = watch()
    assert task.update(1 * S, False, True, 1) == "wait"
    task.on(Event.ALIASES, 1 * S, 1)
    assert task.update(2 * S, True, True, 2) == "disambiguate"
    assert task.update(3 * S, False, True, 3) == "disambiguate"
    task.on(Event.DECISION, 3 * S, 3)
    assert task.update(4 * S, False, True, 4) == "look"
