"""What cannot be planned, or is no waypoint, area or setting: one table of each, with the sentence."""

import math
import re

import numpy as np
import pytest
import yaml

from tests.helpers.planning_room import BURGER
from turtlebag.datasets.errors import InputError
from turtlebag.datasets.se2 import SE2
from turtlebag.datasets.yaml_files import checked
from turtlebag.planners.costmap import Costmap
from turtlebag.planners.global_plan import NoPath, plan_path
from turtlebag.planners.obstacle_layer import Marking
from turtlebag.planners.planner import PlanConfig
from turtlebag.planners.rolling_costmap import RollingLayer
from turtlebag.planners.tasks.waypoints import load_keepout, load_waypoints, parse_waypoint

RES = 0.05
START, GOAL = SE2.from_xyt(1.0, 1.0, 0.0), SE2.from_xyt(3.0, 1.0, 0.0)

POSE = {"position": {"x": 1, "y": 2}, "orientation": {"x": 0, "y": 0, "z": 0, "w": 1}}
NUMBER = "is not a finite number"
ENTRIES = [
    ("home", "not an entry"),
    (7, "not an entry"),
    ({"y": 2}, "x is missing"),
    ({"x": 1, "yaw": 0}, "y is missing"),
    ({"x": "a", "y": 2}, f"x {NUMBER}"),
    ({"x": "1_0", "y": 2}, f"x {NUMBER}"),
    ({"x": True, "y": 2}, f"x {NUMBER}"),
    ({"x": 10**400, "y": 2}, f"x {NUMBER}"),
    ({"x": 1, "y": math.inf}, f"y {NUMBER}"),
    ({"x": 1, "y": 2, "yaw": math.nan}, f"yaw {NUMBER}"),
    ([1, 2, None], f"yaw {NUMBER}"),
    ({"x": 1, "y": 2, "speed": 2}, "unknown key speed"),
    ({**POSE, "speed": 1.0}, "unknown key speed"),
    *(({"x": 1, "y": 2, "wait": wait}, "wait must be 0 to 3600 s") for wait in (-1, 3601, "long")),
    ({"x": 1, "y": 2, "quaternion": [0, 0, 0, 0]}, "its norm is zero"),
    ({"x": 1, "y": 2, "quaternion": [0, 0, math.inf, 1]}, "not finite"),
    ({"x": 1, "y": 2, "quaternion": [0, 0, 1]}, "expected [x, y, z, w]"),
    ({"header": {"frame_id": "odom"}, "pose": POSE}, "its frame is odom, not map"),
    ({"frame_id": "body", "x": 1, "y": 2}, "its frame is body, not map"),
    ({"pose": [1, 2, 0]}, "orientation: expected [w, x, y, z]"),
    ({"pose": [1, 2], "orientation": [1, 0, 0, 0]}, "pose: expected [x, y, z]"),
    ({"pose": 3}, "pose: expected [x, y, z]"),
    (yaml.safe_load("&a {pose: *a}"), "pose: expected"),
    ({"pose": {"position": {"x": 1}}}, "y is missing"),
    ({"position": "here"}, "position: expected x, y and z"),
    ({"position": {"x": 1, "y": 2}, "orientation": {"w": 1}}, "orientation: expected x, y, z and w"),
    ({"position": {"x": 1, "y": 2}, "orientation": [1, 2]}, "invalid quaternion: expected [x, y, z, w]"),
]
"""An entry of a waypoints file, and why it is no pose."""


@pytest.mark.parametrize(("entry", "reason"), ENTRIES, ids=range(len(ENTRIES)))
def test_an_entry_that_is_no_pose_says_why(entry, reason):
    found = parse_waypoint(entry)
    assert found.T_map_goal is None
    assert reason in found.reason


CORNERS = ": keepout 2: expected three or more corners"
AREA = "[[0, 0], [1, 0], [1, 1]]"
BAD_AREAS = ("[[0, 0], [1, 0]]", "[[0, 0], [1, 0], [1]]", "[[0, 0, 0], [0, 0, 0], [0, 0, 0]]")
BAD_AREAS += ("[[0, 0], [1, 0], [.nan, 1]]", f"[[0, 0], [1, 0], [1{'0' * 400}, 1]]", "home", "1")
WAYPOINTS = {
    "home": ": expected a list of waypoints",
    "[]": ": contains no waypoints",
    "waypoints: 1": ": expected a list of waypoints",
    "{waypoints: [[1, 2]], home: 1}": ": unknown key home",
    "{header: {frame_id: odom}, poses: [{position: {x: 1, y: 2}}]}": ": its frame is odom, not map",
    "{pause: 1, poses: [{position: {x: 1, y: 2}}]}": ": unknown key pause (known: frame_id, header, keepout,",
    "- [1, 2]\n---\na: [\n---\n": ", line 3: not valid YAML",
    "---\n" * 20_000: ": more than 10000 documents",
    **{f"{{waypoints: [[1, 2]], keepout: [{AREA}, {bad}]}}": CORNERS for bad in BAD_AREAS},
}
KEEPOUT = {
    "keepout: home": ": keepout: expected a list of polygons",
    "waypoints: []": ": keepout: expected a list of polygons",
    **{f"keepout: [{AREA}, {bad}]": CORNERS for bad in BAD_AREAS},
}
FILES = [
    *((load_waypoints, text, said) for text, said in WAYPOINTS.items()),
    *((load_keepout, text, said) for text, said in KEEPOUT.items()),
]


@pytest.mark.parametrize(("load", "text", "said"), FILES, ids=range(len(FILES)))
def test_a_file_of_waypoints_or_areas_that_is_none_is_refused_by_its_name(tmp_path, load, text, said):
    (tmp_path / "file.yaml").write_text(text)
    with pytest.raises(InputError, match=re.escape(f"file.yaml{said}")) as error:
        load(tmp_path / "file.yaml")
    assert "\n" not in str(error.value)


SETTINGS = [
    # It was a warning of NumPy's from the middle of the search.
    ({"margins": [1e300]}, "margins.0: must be less than or equal"),
    ({"inflation_radius": 1e300}, "inflation_radius: must be less than or equal"),
]


@pytest.mark.parametrize(("settings", "said"), SETTINGS, ids=range(len(SETTINGS)))
def test_settings_that_no_plan_has_are_refused(settings, said):
    with pytest.raises(InputError, match=re.escape(f"c.yaml: {said}")):
        checked(PlanConfig, settings, where="c.yaml")


def halves(*, opening=0, pen=False):
    """4 x 4 m with a wall at x = 2 that leaves an opening of so many cells, and a pen round the start."""
    lethal = np.zeros((80, 80), dtype=bool)
    lethal[[0, -1]] = lethal[:, [0, -1]] = True
    lethal[:, 40] = True
    lethal[30 : 30 + opening, 40] = False
    if pen:
        lethal[14:27, 14:27] = True
        lethal[19:22, 19:22] = False
    return Costmap(lethal, RES, SE2.identity())


OFF = "the goal is in an obstacle or off the map"
PATHS = [
    *((halves(opening=20), SE2.from_xyt(x, y, 0.0), OFF) for x, y in ((2, 1), (9, 1), (-3, 1))),
    (halves(), GOAL, "no path to the goal"),
    (halves(opening=3), GOAL, "no path to the goal"),
    (halves(opening=20, pen=True), GOAL, "the robot is too close to an obstacle"),
]


@pytest.mark.parametrize(("costmap", "goal", "reason"), PATHS, ids=range(len(PATHS)))
def test_where_no_path_leads_the_reason_is_said(costmap, goal, reason):
    with pytest.raises(NoPath, match=f"^{reason}$"):
        plan_path(costmap, BURGER, START, goal, PlanConfig(), seed=1)


def rings(*radii):
    angles = np.linspace(0.0, 2.0 * np.pi, 400)
    return np.concatenate([r * np.stack([np.cos(angles), np.sin(angles)], axis=1) for r in radii])


OBSTACLES = [
    (rings(1.5), "no path out of the visible area"),
    (rings(*np.arange(0.0, 1.0, 0.02)), "the robot is too close to an obstacle"),
]


@pytest.mark.parametrize(("points", "reason"), OBSTACLES, ids=range(len(OBSTACLES)))
def test_out_of_rings_of_obstacles_there_is_no_way(points, reason):
    layer = RollingLayer(np.zeros(2), 8.0, RES, 1.0, Marking(wall_margin=0.0, hits=1, obstacle_range=9.0))
    layer.update(0.0, SE2.from_xyt(2.0, 2.0, 0.0), points, np.zeros((0, 2)))
    with pytest.raises(NoPath, match=f"^{reason}$"):
        layer.aim(SE2.identity(), SE2.from_xyt(9.0, 0.0, 0.0), 0.45)
