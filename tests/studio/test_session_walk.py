"""The tutorial walked in a session, without a window: drive, map, localise, go, patrol, avoid; and again."""

import math

import numpy as np
import pytest

from tests.studio.walk import ROOM, at_the_studio, differences, files, silent
from turtlebag.datasets.bags.reader import read_commands
from turtlebag.datasets.grid import FREE
from turtlebag.datasets.maps import load_map
from turtlebag.datasets.outputs import Output
from turtlebag.datasets.runlog import RunLog
from turtlebag.datasets.trajectories import load_tum
from turtlebag.pipeline.stages.studio import replay
from turtlebag.planners.tasks.waypoints import load_waypoints
from turtlebag.sim.worlds import load_world

pytestmark = pytest.mark.slow

STEP_V, STEP_W = 0.01, 0.1


def free_area(view):
    return 0 if view.map is None else int(np.count_nonzero(view.map.cells == FREE))


def drive_by_keys(person):
    """About the room, with presses of W and some of A and D."""
    for press in range(1, 19):
        person.do("drive", v=press * STEP_V, w=0.0)
        person.wait(0.1)
    for w, seconds in ((0.0, 1.0), (7 * STEP_W, 3.0), (0.0, 2.0), (-3 * STEP_W, 2.0)):
        person.do("drive", v=0.18, w=w)
        person.wait(seconds)
    person.do("stop")
    person.wait(0.5)
    person.do("release")


@pytest.fixture(scope="module")
def walked(tmp_path_factory):
    """A session that walks the tutorial in a room: its folder, and what was seen on the way."""
    folder, seen = tmp_path_factory.mktemp("walk"), {}
    out, world = folder / "live", folder / "room.yaml"
    world.write_text(ROOM)
    with at_the_studio(out, str(world)) as person:
        person.do("record", name="drive")
        person.do("map_start")
        person.wait(1.0)
        seen["before"] = free_area(person.view)
        person.do("explore")
        person.wait(4.0)
        person.do("cancel")
        seen["early"] = free_area(person.view)
        drive_by_keys(person)
        person.do("explore")
        assert person.until_done(240.0) is not None
        seen["grown"] = free_area(person.view)
        person.do("map_save", name="map_world")
        person.do("record_stop")
        person.do("map_load", name="map_world")
        seen["loaded"] = person.view
        x, y, yaw = person.view.T_world_base.xyt
        person.do("pose_estimate", pose=[x + 0.3, y, yaw + math.radians(20.0)])
        seen["told"] = person.view
        person.do("wiggle")
        person.wait(0.5)
        seen["wiggling"] = person.view
        assert person.until_done(30.0) is not None
        seen["wiggled"] = person.view
        person.do("goal", pose=[1.2, -0.8, 1.57])
        assert person.until_done(120.0) is not None
        seen["there"] = person.view
        places = [{"pose": [0.5, 0.8, 3.14]}, {"pose": [-0.8, 0.4, -1.57], "wait": 2.0}]
        person.do("waypoints_save", name="two", waypoints=places)
        person.do("patrol", waypoints=places, laps=1)
        person.wait(5.0)
        seen["underway"] = person.view
        assert person.until_done(120.0) is not None
        seen["patrolled"] = person.view
        seen["lines"] = person.lines
    return out, seen


def test_the_map_grows_and_is_one_of_the_world(walked):
    out, seen = walked
    assert seen["before"] < seen["early"] < seen["grown"]
    true = load_world(str(out.with_name("room.yaml"))).rasterize(0.172)
    assert seen["grown"] > 0.9 * np.count_nonzero(true.cells == FREE)
    saved = load_map(out / "maps/map_world.yaml")
    assert np.array_equal(saved.cells == FREE, seen["loaded"].map.grid.cells == FREE)


def test_the_particles_draw_together_about_the_truth(walked):
    _, seen = walked
    told, wiggled = seen["told"], seen["wiggled"]
    assert not seen["loaded"].localised
    assert told.localised
    std = [np.linalg.norm(view.particles[:, :2].std(axis=0)) for view in (told, wiggled)]
    error = [np.linalg.norm(view.T_map_base.xy - view.T_world_base.xy) for view in (told, wiggled)]
    assert seen["wiggling"].task == "wiggle"
    assert abs(seen["wiggling"].command[1]) > 0.1
    assert std[1] < 0.5 * std[0]
    assert error[0] > 0.15
    assert error[1] < 0.05
    assert wiggled.lost is None
    assert wiggled.sure > 0.5


def test_goal_and_patrol_are_reached_in_truth(walked):
    _, seen = walked
    assert np.linalg.norm(seen["there"].T_world_base.xy - [1.2, -0.8]) < 0.25
    assert [goal.status for goal in seen["there"].goals] == ["reached"]
    underway = seen["underway"]
    assert underway.task == "patrol"
    assert underway.goal == (0.5, 0.8, 3.14)
    assert underway.plan is not None
    assert [goal.status for goal in underway.goals] == ["active", "waiting"]
    assert [goal.status for goal in seen["patrolled"].goals] == ["reached", "reached"]
    assert "goal 2 of 2: heading to (-0.8, 0.4)" in seen["lines"]
    assert any(line.startswith("succeeded: 2 of 2 goals reached, no collisions") for line in seen["lines"])


def test_what_it_leaves_is_read_by_what_reads_such_files(walked):
    out, _ = walked
    names = {str(path) for path in files(out)}
    assert {"session.yaml", "metrics.json", "config.yaml", "truth/map.yaml"} <= names
    assert not {"look", "roam"} & set(RunLog.load(out / "runlog.csv").state)
    stamps, v, _ = read_commands(out / "bags/drive")
    assert v.max() == pytest.approx(0.22, abs=0.05)
    log = RunLog.load(out / "runlog.csv")
    assert len(log) * 1e9 / 30 == pytest.approx(log.t_ns[-1], rel=1e-3)
    assert stamps[-1] < log.t_ns[-1]
    estimate, truth = load_tum(out / "trajectory.tum"), load_tum(out / "truth/trajectory.tum")
    assert np.array_equal(estimate.stamps_ns, truth.stamps_ns)
    two = load_waypoints(out / "waypoints/two.yaml").waypoints
    assert [(waypoint.written, waypoint.wait) for waypoint in two] == [
        ((0.5, 0.8, 3.14), None),
        ((-0.8, 0.4, -1.57), 2.0),
    ]


def test_all_that_the_walk_asks_for_is_driven_again_to_the_same_bytes(tmp_path):
    """The same inputs in less time."""
    with at_the_studio(tmp_path / "live") as person:
        person.do("record", name="drive")
        person.do("map_start")
        person.do("explore")
        person.wait(5.0)
        person.do("cancel")
        person.do("drive", v=0.1, w=STEP_W)
        person.wait(1.0)
        person.do("stop")
        person.do("release")
        person.do("map_save", name="map_world")
        person.do("record_stop")
        person.do("map_load", name="map_world")
        x, y, yaw = person.view.T_world_base.xyt
        person.do("pose_estimate", pose=[x + 0.1, y, yaw + 0.1])
        person.do("wiggle")
        assert person.until_done(30.0) is not None
        person.do("goal", pose=[-2.0, -0.5, 1.57])
        assert person.until_done(60.0) is not None
        places = [{"pose": [-2.0, -0.2, 1.57]}, {"pose": [-1.8, -0.4, 0.0], "wait": 1.0}]
        person.do("waypoints_save", name="two", waypoints=places)
        person.do("patrol", waypoints=places, laps=1)
        assert person.until_done(60.0) is not None
    assert replay(tmp_path / "live/session.yaml", Output(tmp_path / "again"), say=silent) == 0
    assert differences(tmp_path / "live", tmp_path / "again") == []


def test_avoiding_in_the_house_and_a_goal_without_a_map(tmp_path):
    with at_the_studio(tmp_path / "live", "turtlebot3_house") as person:
        person.do("avoid")
        person.wait(8.0)
        assert person.view.sectors.decision
        person.do("drive", v=0.1)
        person.wait(1.0)
        assert person.view.owner == "teleop"
        person.do("release")
        person.wait(0.1)
        assert person.view.owner == "navigation"
        x, y, yaw = person.view.T_map_base.xyt
        person.do("goal", pose=[x + 0.6 * math.cos(yaw), y + 0.6 * math.sin(yaw), yaw])
        assert person.until_done(60.0) is not None
        assert [goal.status for goal in person.view.goals] == ["reached"]
        assert any(line.startswith("avoid ended: another goal was set: no coll") for line in person.lines)
    assert replay(tmp_path / "live/session.yaml", Output(tmp_path / "again"), say=silent) == 0
    assert differences(tmp_path / "live", tmp_path / "again") == []
