"""What there is to draw: what is the same object has not changed, and nothing that was shown changes."""

import numpy as np
import pytest

from tests.studio.walk import Person, at_the_studio
from turtlebag.datasets.grid import OccupancyGrid
from turtlebag.datasets.se2 import SE2
from turtlebag.pipeline.studio.session import Session
from turtlebag.pipeline.studio.setup import StudioSetup
from turtlebag.pipeline.studio.view import CostLayer, MapLayer
from turtlebag.pipeline.studio.visuals import MOST_EVENTS, MOST_POINTS, EventLog, Trail
from turtlebag.planners.costmap import Costmap
from turtlebag.sim.worlds import load_world


def line(count, start=0):
    return np.stack([0.1 * np.arange(start, start + count), np.zeros(count)], axis=1)


def test_a_trail_grows_and_what_was_shown_stays():
    trail, shown = Trail(), []
    for xy in line(3000):
        trail.add(xy)
        trail.add(xy + 0.001)
        shown.append(trail.path)
    assert {path.version for path in shown} == {0}
    for count, path in enumerate(shown, start=1):
        assert np.array_equal(path.points, line(count))


def test_of_a_long_trail_the_newer_part_is_kept_under_another_version():
    trail = Trail()
    for xy in line(3 * MOST_POINTS):
        trail.add(xy)
        assert len(trail.path.points) <= 2 * MOST_POINTS
    assert trail.path.version > 0
    assert np.array_equal(trail.path.points[-100:], line(3 * MOST_POINTS)[-100:])


def test_a_trail_that_is_cleared_or_replaced_has_another_version():
    trail = Trail()
    trail.add(np.zeros(2))
    trail.replace(line(5, 7))
    assert (trail.path.version, trail.path.points.tolist()) == (1, line(5, 7).tolist())
    trail.clear()
    assert (trail.path.version, len(trail.path.points)) == (2, 0)


def test_the_newest_events_are_kept_and_numbered():
    told = []
    log = EventLog(told.append)
    for k in range(MOST_EVENTS + 5):
        log.add(k * 10**9, f"line {k}")
    assert len(log.events) == MOST_EVENTS
    assert log.events[-1][:3] == (MOST_EVENTS + 5, float(MOST_EVENTS + 4), f"line {MOST_EVENTS + 4}")
    assert len(told) == MOST_EVENTS + 5


def test_cells_are_drawn_as_the_design_says():
    grid = OccupancyGrid(np.array([[0, 100, -1]], dtype=np.int8), 0.05)
    assert MapLayer(grid).cells.tolist() == [[0, 100, 255]]
    lethal = np.zeros((41, 41), dtype=bool)
    lethal[20, 20] = True
    T_map_odom = SE2.from_xyt(1.0, 2.0, 0.5)
    layer = CostLayer(Costmap(lethal, 0.05, SE2.from_xyt(-1.0, 0.0, 0.0)), T_map_odom, 0.1)
    costs = layer.cells[20]
    assert costs.dtype == np.uint8
    assert costs[20:23].tolist() == [254, 253, 253]
    assert np.all(np.diff(costs[23:30].astype(int)) < 0)
    assert np.allclose(layer.origin.xyt, (T_map_odom @ SE2.from_xyt(-1.0, 0.0, 0.0)).xyt)


@pytest.mark.slow
def test_what_has_not_changed_is_the_same_object(tmp_path):
    with Session(StudioSetup("turtlebot3_world", seed=1), tmp_path, lambda text: None) as session:
        person = Person(session)
        person.do("map_start")
        person.do("drive", v=0.15)
        person.wait(4.0)
        one, other = person.view, person.view
        for layer in ("scan", "map", "graph", "odom_path", "slam_path", "events", "keepout", "sectors"):
            assert getattr(one, layer) is not None
            assert getattr(one, layer) is getattr(other, layer), layer
        seen = one.scan.copy()
        person.wait(0.5)
        after = person.view
        assert after.scan is not one.scan
        assert np.array_equal(one.scan, seen)
        assert after.odom_path is not one.odom_path
        assert after.odom_path.version == one.odom_path.version
        assert np.array_equal(after.odom_path.points[: len(one.odom_path.points)], one.odom_path.points)
        assert after.keepout is one.keepout


@pytest.mark.slow
def test_layers_lie_where_the_robot_is(tmp_path):
    """The scan on the walls of the true map, the costmap of a goal without a map about the robot."""
    with at_the_studio(tmp_path / "live") as person:
        person.wait(1.0)
        view, true = person.view, load_world("turtlebot3_world").rasterize(0.172)
        rows, cols = true.cell_of(view.scan).T
        near = [
            true.cells[r - 1 : r + 2, c - 1 : c + 2].max() == 100 for r, c in zip(rows, cols, strict=True)
        ]
        assert np.mean(near) > 0.9
        person.do("goal", pose=[-1.2, -0.5, 0.0])
        person.wait(3.0)
        view = person.view
        assert np.linalg.norm(view.plan[-1] - [-1.2, -0.5]) < 0.3
        assert view.goal == (-1.2, -0.5, 0.0)
        assert view.local is not None
        xy = view.costmap.origin.inverse() @ view.T_world_base.xy
        assert np.all(np.abs(xy / 0.05 - np.array(view.costmap.cells.shape) / 2) < 30)
        person.do("explore")
        person.wait(12.0)
        view = person.view
        assert view.graph.edges[:, :2].max() == len(view.graph.nodes) - 1
        assert len(np.unique(view.graph.edges, axis=0)) == len(view.graph.edges), "a step drawn twice"
        assert view.sure > 0.5
        assert np.linalg.norm(view.graph.nodes[-1, :2] - view.T_world_base.xy) < 1.0
