"""What a person does to the simulated world, and beginning anew."""

import numpy as np
import pytest

from tests.studio.walk import at_the_studio, differences, silent
from turtlebag.datasets.maps import load_map
from turtlebag.datasets.outputs import Output
from turtlebag.datasets.se2 import SE2
from turtlebag.datasets.types import Twist
from turtlebag.datasets.yaml_files import read_mapping
from turtlebag.pipeline.stages.studio import replay
from turtlebag.planners.tasks.waypoints import parse_polygons
from turtlebag.sim.robots import load_robot
from turtlebag.sim.shapes import box
from turtlebag.sim.simulator import SimConfig, Simulator
from turtlebag.sim.worlds import load_world

pytestmark = pytest.mark.slow


def ahead(scan):
    """Least range within 10 degrees of straight on [m]."""
    ranges = np.where(np.isfinite(scan.ranges), scan.ranges, np.inf)
    return float(min(ranges[:10].min(), ranges[-10:].min()))


def driven(simulator, command, steps):
    """The last scan on the way, and whether something was touched."""
    scan, touched = None, False
    for _ in range(steps):
        observation = simulator.step(command)
        scan = observation.scan or scan
        touched |= simulator.truth.contact_visible
    return scan, touched


def test_a_dropped_box_is_seen_touched_and_measured_and_gone_after_a_reset():
    with Simulator(load_world("empty"), load_robot("burger"), SimConfig(sensors="clean"), 1) as simulator:
        simulator.reset(SE2.identity())
        assert simulator.clearance() == np.inf
        driven(simulator, Twist(), 6)
        simulator.drop(box("box", (0.6, 0.0), (0.2, 0.2), 0.0, (0.0, 0.5)))
        assert simulator.clearance() == pytest.approx(0.5 - 0.07, abs=0.05)
        scan, _ = driven(simulator, Twist(), 12)
        assert ahead(scan) == pytest.approx(0.5, abs=0.1)
        _, touched = driven(simulator, Twist(0.2), 120)
        assert touched
        assert simulator.truth.T_world_base.x < 0.5
        simulator.reset(SE2.identity())
        scan, touched = driven(simulator, Twist(0.2), 120)
        assert ahead(scan) == np.inf
        assert not touched
        assert simulator.clearance() == np.inf


def test_stamps_go_on_after_a_reset_and_all_else_begins_anew():
    with Simulator(load_world("turtlebot3_world"), load_robot("burger"), SimConfig(), 1) as simulator:
        first = [simulator.reset(), *(simulator.step(Twist(0.1, 0.3)) for _ in range(30))]
        again = [simulator.reset(step=900), *(simulator.step(Twist(0.1, 0.3)) for _ in range(30))]
    for one, other in zip(first, again, strict=True):
        assert other.stamp_ns - one.stamp_ns == 30 * 10**9
        assert one.odometry.T_odom_base.xyt.tolist() == other.odometry.T_odom_base.xyt.tolist()
        assert (one.scan is None) == (other.scan is None)
        if one.scan is not None:
            assert np.array_equal(one.scan.ranges, other.scan.ranges)
            assert abs(other.scan.stamp_ns - one.scan.stamp_ns - 30 * 10**9) <= 1


def test_a_carried_robot_stands_elsewhere_and_its_wheels_notice_nothing(tmp_path):
    with at_the_studio(tmp_path / "live") as person:
        person.wait(1.0)
        before = person.view.T_odom_base
        person.do("kidnap", pose=[0.5, -0.5, 1.0])
        assert np.allclose(person.view.T_world_base.xyt, [0.5, -0.5, 1.0])
        person.wait(1.0)
        assert np.allclose(person.view.T_world_base.xyt, [0.5, -0.5, 1.0], atol=0.01)
        assert np.allclose(person.view.T_odom_base.xyt, before.xyt, atol=0.01)
    assert replay(tmp_path / "live/session.yaml", Output(tmp_path / "again"), say=silent) == 0
    assert differences(tmp_path / "live", tmp_path / "again") == []


def test_the_plan_keeps_out_of_what_was_drawn_which_is_saved_with_the_map(tmp_path, true_map):
    middle = [[-0.8, -0.2], [-0.3, -0.2], [-0.3, 0.2], [-0.8, 0.2]]
    with at_the_studio(tmp_path / "live", map_path=true_map) as person:
        person.do("pose_estimate", pose=[-2.0, -0.5, 0.0])
        person.do("keepout", outlines=[middle])
        lethal = person.view.costmap.costmap.clearance_at(np.array([[-0.55, 0.0]]))
        assert lethal[0] == 0.0
        person.do("map_save", name="kept")
        person.do("keepout", outlines=[])
        assert person.view.costmap.costmap.clearance_at(np.array([[-0.55, 0.0]]))[0] > 0.0
        person.do("map_load", name="kept")
        assert [outline.tolist() for outline in person.view.keepout] == [middle]
        assert person.view.costmap.cells.max() == 254
        person.do("map_load", name="")
        assert person.view.keepout == ()
        assert person.view.maps == ("", "kept")
    saved = read_mapping(tmp_path / "live/maps/kept-keepout.yaml")["keepout"]
    assert parse_polygons(saved, "kept")[0].tolist() == middle
    assert np.array_equal(load_map(tmp_path / "live/maps/kept.yaml").cells, load_map(true_map).cells)


def test_a_robot_that_may_be_anywhere_finds_itself_once_it_is_sent_somewhere(tmp_path, true_map):
    """It turns to and fro first, as it was told no pose."""
    with at_the_studio(tmp_path / "live", map_path=true_map) as person:
        person.do("localise_global")
        assert not person.view.localised
        assert person.view.particles[:, :2].std(axis=0).min() > 0.5
        person.do("goal", pose=[-1.5, -0.5, 0.0])
        person.wait(1.0)
        assert "wiggle" in person.view.state
        assert person.until_done(180.0) is not None
        assert np.linalg.norm(person.view.T_world_base.xy - [-1.5, -0.5]) < 0.25


def test_what_moves_in_the_true_world_is_there_for_the_ghost(tmp_path):
    with at_the_studio(tmp_path / "live", "turtlebot3_world+clutter:7,boxes=0,movers=2") as person:
        before = person.view
        person.wait(1.0)
        after = person.view
        assert len(before.mover_circles) + len(before.mover_segments) >= 2
        assert not np.array_equal(before.mover_circles, after.mover_circles)
        assert len(person.view.boxes) == 0


def test_a_waypoint_where_the_robot_cannot_stand_says_so_at_once(tmp_path, true_map):
    with at_the_studio(tmp_path / "live", map_path=true_map) as person:
        places = ([-1.5, -0.5, 0.0], [0.0, 0.0, 0.0], [50.0, 0.0, 0.0])
        person.do("waypoints", waypoints=[{"pose": pose} for pose in places])
        free, pillar, beyond = (stop.blocked for stop in person.view.waypoints)
        assert free == ""
        assert "obstacle" in pillar
        assert beyond == "off the map"
        person.do("keepout", outlines=[[[-2.0, -1.0], [-1.0, -1.0], [-1.0, 0.0], [-2.0, 0.0]]])
        assert "keep-out" in person.view.waypoints[0].blocked
        person.do("map_start")
        assert [stop.blocked for stop in person.view.waypoints] == ["", "", ""]


def test_a_robot_that_was_carried_claims_no_fit_until_it_has_looked(tmp_path, true_map):
    with at_the_studio(tmp_path / "live", map_path=true_map) as person:
        person.do("pose_estimate", pose=[-2.0, -0.5, 0.0])
        person.do("drive", w=0.5)
        person.wait(3.0)
        person.do("stop")
        person.wait(0.5)
        assert person.view.sure > 0.5
        person.do("kidnap", pose=[1.5, 0.5, 1.0])
        assert person.view.sure is None
        person.wait(0.5)
        assert person.view.sure is None
        person.do("drive", w=0.5)
        person.wait(3.0)
        assert person.view.sure is not None


def test_a_task_that_is_cancelled_has_neither_succeeded_nor_failed(tmp_path):
    with at_the_studio(tmp_path / "live") as person:
        person.do("avoid")
        person.wait(1.0)
        person.do("cancel")
        assert person.lines[-1].startswith("avoid cancelled: no collisions, ")
        assert not any(line.startswith(("succeeded", "failed")) for line in person.lines)
        assert person.session.metrics()["tasks"][0]["broken_off"] == "cancelled"


def test_after_a_reset_all_is_as_at_the_start_but_what_was_saved(tmp_path, true_map):
    with at_the_studio(tmp_path / "live", map_path=true_map) as person:
        start = person.view
        person.do("record", name="first")
        person.do("pose_estimate", pose=[-2.0, -0.5, 0.0])
        person.do("box", xy=[-1.0, -0.5], size=0.2)
        person.do("waypoints_save", name="one", waypoints=[{"pose": [0.5, -1.8, 0.0]}])
        assert person.view.bags == ("first",)
        person.do("waypoints_load", name="one")
        assert person.view.waypoints == ((0.5, -1.8, 0.0, None, ""),)
        person.do("goal", pose=[-1.5, -1.0, 0.0])
        person.do("drive", v=0.1)
        person.wait(2.0)
        person.do("reset")
        view = person.view
        assert view.stamp_ns == 2 * 10**9
        assert (view.task, view.recording, view.localised, len(view.waypoints)) == ("", None, False, 1)
        assert view.T_world_base.xyt.tolist() == start.T_world_base.xyt.tolist()
        assert len(view.boxes) == len(view.odom_path.points) == 0
        assert view.odom_path.version > start.odom_path.version
        assert view.map_name == ""
        assert view.waypoint_files == ("", "one")
        person.wait(2.0)
        assert person.view.owner == "navigation"
        assert person.view.command == (0.0, 0.0)
        person.do("record", name="second")
        person.do("waypoints_load", name="one")
        person.wait(0.2)
    assert replay(tmp_path / "live/session.yaml", Output(tmp_path / "again"), say=silent) == 0
    assert differences(tmp_path / "live", tmp_path / "again") == []
