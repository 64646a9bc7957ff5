"""The navigation benchmark: intervals, rows that can be resumed, episodes that come from their seed alone."""

import dataclasses

import numpy as np
import pytest

from benchmarks import navigate_cases as cases
from benchmarks.drives import Maps
from benchmarks.navigate import about, failures, own_contacts, row_of, scenarios, spans, summary
from benchmarks.runner import Rows, interval
from turtlebag.datasets.maps import load_map
from turtlebag.datasets.runlog import Row, RunLog
from turtlebag.datasets.se2 import SE2
from turtlebag.datasets.types import Twist
from turtlebag.pipeline.navigation.episode import Episode
from turtlebag.planners.costmap import CostmapConfig, costmap_from_grid
from turtlebag.sim.movers import Mover
from turtlebag.sim.shapes import cylinder


class OneMap:
    """Stands for the maps: nothing is driven here."""

    def slam(self, world, robot):
        return f"{world}-{robot}.yaml"


def test_intervals_are_those_of_the_books():
    # Brown, Cai, DasGupta (2001).
    assert interval(0, 10) == pytest.approx((0.0, 0.2775), abs=1e-4)
    assert interval(95, 100) == pytest.approx((0.8883, 0.9785), abs=1e-3)
    assert interval(0, 0) == (0.0, 1.0)


def same(a, b):
    return np.array_equal(a.xyt, b.xyt)


@pytest.mark.slow
def test_an_episode_comes_from_its_seed_alone():
    known = scenarios(OneMap(), False)
    for name in ("house burger", "kidnap, house"):
        a, b, other = (known[name].trial(seed) for seed in (3, 3, 4))
        assert same(a.request.start, b.request.start)
        assert same(a.request.goal, b.request.goal)
        assert not same(a.request.goal, other.request.goal)
        assert a.config == b.config


def test_other_sensors_change_nothing_else_of_an_episode():
    kidnap = scenarios(OneMap(), False)["kidnap, house"]
    clean = dataclasses.replace(kidnap, sensors="clean")
    a, b = kidnap.trial(3), clean.trial(3)
    assert same(a.request.start, b.request.start)
    assert same(a.request.goal, b.request.goal)
    assert (a.config.sim.sensors, b.config.sim.sensors) == ("realistic", "clean")
    assert a.config.sim.faults == b.config.sim.faults


@pytest.mark.slow
def test_goals_are_reachable_with_room_to_spare_and_kidnaps_are_far():
    for seed in range(2):
        case = cases.kidnap(OneMap(), "house", "kidnap, house", seed)
        world, robot = case.world, case.robot
        costmap = costmap_from_grid(world.rasterize(robot.lidar_height), CostmapConfig(), world.keepout)
        room = robot.model.circumscribed_radius + cases.ROOM_M
        regions = cases.regions_of(costmap, room)
        ((_, *carried),) = case.config.sim.faults.kidnap
        places = [case.request.start.xy, case.request.goal.xy, np.array(carried[:2])]
        assert np.all(costmap.clearance_at(np.stack(places)) > room)
        cells = [costmap.T_grid_map @ xy / costmap.resolution for xy in places]
        assert len({int(regions[int(c[1]), int(c[0])]) for c in cells}) == 1
        assert np.linalg.norm(places[0] - places[1]) > cases.FAR_M
        assert np.linalg.norm(places[0] - places[2]) > cases.CARRIED_M


def episode(error_m, odometry_step, status="reached"):
    """Three ticks of which the last two touch something, after a step of odometry."""
    rows = [
        Row(
            k * 33_333_333,
            T_world_base=SE2.identity(),
            T_map_base=None,
            T_odom_base=SE2.from_xyt(odometry_step * k, 0.0, 0.0),
            command=Twist(),
            clearance_m=0.0,
            contact_visible=k > 0,
            contact_low=False,
            goal_index=0,
            state="follow",
        )
        for k in range(3)
    ]
    goal = {"status": status, "error_m": error_m, "error_rad": 0.0, "reason": "no way"}
    metrics = {
        "goals": [goal],
        "collisions": {"visible": 1, "low": 0},
        "min_clearance_m": 0.0,
        "localisation_error_m": None,
        "distance_m": 1.0,
        "time_s": 0.1,
    }
    return Episode(metrics, RunLog.of(rows), None, None)


def test_who_is_run_into_did_not_collide_and_who_drives_did():
    assert own_contacts(episode(0.0, 0.0).log) == 0
    assert own_contacts(episode(0.0, 0.005).log) == 1


def test_a_goal_reached_in_the_wrong_place_is_a_failure():
    patrol = cases.patrol(OneMap(), "patrol", 1)
    someone = Mover(solid=cylinder("someone", (0.0, 0.0), 0.2, (0.0, 1.0)), path=np.zeros((1, 2)), speed=0.3)
    case = dataclasses.replace(patrol, world=dataclasses.replace(patrol.world, movers=(someone,)))
    assert row_of(case, episode(0.01, 0.0), 1.0)["success"] == 1
    assert row_of(case, episode(0.01, 0.005), 1.0)["success"] == 0
    lost = row_of(case, episode(0.8, 0.0), 1.0)
    assert (lost["success"], lost["reasons"]) == (0, "reached, but truly 0.80 m and 0.00 rad off")
    shut = dataclasses.replace(case, wanted="unreachable")
    assert row_of(shut, episode(None, 0.0, "unreachable"), 1.0)["success"] == 1
    assert row_of(shut, episode(0.01, 0.0), 1.0)["success"] == 0
    low = episode(0.01, 0.005)
    low.metrics["collisions"] = {"visible": 0, "low": 1}
    assert row_of(patrol, low, 1.0)["success"] == 0
    wandering = dataclasses.replace(patrol, request=dataclasses.replace(patrol.request, task="avoid"))
    assert row_of(wandering, low, 1.0)["success"] == 1
    # Among things that stand still, any touch is the robot's own.
    assert row_of(patrol, episode(0.01, 0.0), 1.0)["success"] == 0


def test_an_exploration_that_saw_too_little_failed_whatever_it_touched_below_the_lidar():
    looked = cases.explore(60.0, "explore", 0)
    run = episode(0.0, 0.005)
    run.metrics.update(goals=[], collisions={"visible": 0, "low": 1}, area={"share": 0.96, "seen_m2": 9.0})
    assert row_of(looked, run, 1.0)["success"] == 1
    run.metrics["area"]["share"] = 0.94
    row = row_of(looked, run, 1.0)
    assert (row["success"], row["reasons"]) == (0, "saw too little of the floor")


def test_seeds_are_named_as_runs():
    assert spans([3, 1, 2, 10, 11]) == "1..3, 10..11"
    assert spans([7]) == "7..7"


def test_a_campaign_goes_on_where_it_was(tmp_path):
    case, patrol = cases.patrol(OneMap(), "patrol", 7), scenarios(OneMap(), False)["patrol"]
    rows = Rows(tmp_path / "navigate.jsonl")
    rows.add("patrol 7", about(patrol, 7) | row_of(case, episode(0.01, 0.0), 1.0) | {"success": 1})
    rows.add("patrol 8", about(patrol, 8) | {"reasons": "refused no way"})
    rows.add("patrol 9", about(patrol, 9) | {"error": "its process died"})
    again = Rows(tmp_path / "navigate.jsonl")
    assert again.get("patrol 7") is not None
    assert again.get("patrol 10") is None
    line = summary("patrol", again.all)
    assert (line["seeds"], line["success"]) == ("7..9", "1/3")
    assert (line["Wilson 95 %"], line["Clopper-Pearson 95 %"]) == ("0.061..0.792", "0.008..0.906")
    line, died = failures(again.all)
    assert "refused no way" in line
    assert "its process died" in died
    assert '"patrol" --sensors realistic --replay 8' in line


@pytest.mark.slow
def test_every_controller_is_given_the_same_goals_on_the_true_map(tmp_path):
    maps = Maps(tmp_path / "maps", "realistic")
    a, b = (cases.controlled(maps, "arena", name, name, 3) for name in ("pursuit", "tutorial's dwa"))
    assert same(a.request.start, b.request.start)
    assert same(a.request.goal, b.request.goal)
    assert (a.config.controller, b.config.dwa.preset) == ("pursuit", "tutorial")
    assert load_map(a.request.map_path).shape == a.world.rasterize(a.robot.lidar_height).shape


@pytest.mark.slow
def test_people_of_an_episode_start_away_from_the_robot_and_yield_where_said():
    for yields in (True, False):
        case = cases.obstacles(OneMap(), yields, "boxes and movers", 2)
        assert [mover.yields for mover in case.world.movers] == [yields] * 3
        gaps = [np.linalg.norm(mover.path[0] - case.request.start.xy) for mover in case.world.movers]
        assert min(gaps) >= cases.APART_M
