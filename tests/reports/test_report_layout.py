"""The viewer's layout: what Foxglove and Lichtblick read of it, checked key by key and against our bags.

No viewer runs here. The keys and their values are those of the viewers' own settings (3D panel: Maps,
LaserScans, PoseArrays, Poses; Plot panel), the paths are followed through the message definitions.
"""

import json
import re
from importlib.resources import files

import pytest
from rosbags.typesys import Stores, get_typestore

from tests.helpers.bag_samples import LINKS, observation, stamp, write_drive
from tests.helpers.report_fakes import fake_record
from tests.helpers.viewer import unresolved
from turtlebag.datasets.bags.topics import TOPICS
from turtlebag.datasets.bags.writer import BagWriter
from turtlebag.datasets.outputs import Output
from turtlebag.pipeline.stages.report import make_report

LAYOUT = json.loads((files("turtlebag.reports") / "templates" / "foxglove-layout.json").read_text())
PANELS = LAYOUT["configById"]
STORE = get_typestore(Stores.ROS2_JAZZY)
NUMBERS = {
    "float32",
    "float64",
    "int8",
    "uint8",
    "int16",
    "uint16",
    "int32",
    "uint32",
    "int64",
    "uint64",
    "bool",
}


def colour(value):
    return re.fullmatch(r"#[0-9a-f]{6}([0-9a-f]{2})?", value) is not None


def scale(value):
    return len(value) == 3 and all(0.0 < part < 2.0 for part in value)


def one_of(*names):
    return lambda value: value in names


def positive(value):
    return 0.0 < value <= 20.0


POSES = {"type": one_of("axis", "arrow", "line"), "arrowScale": scale}
# What the 3D panel lets be set for each message type it draws, of what is set here.
DRAWN = {
    "nav_msgs/msg/OccupancyGrid": {},
    "sensor_msgs/msg/LaserScan": {
        "pointSize": positive,
        "colorMode": one_of("flat", "gradient", "colormap"),
        "flatColor": colour,
    },
    "sensor_msgs/msg/PointCloud2": {
        "pointSize": positive,
        "colorMode": one_of("flat", "gradient", "colormap"),
        "flatColor": colour,
    },
    "nav_msgs/msg/Path": {**POSES, "lineWidth": positive, "gradient": lambda pair: all(map(colour, pair))},
    "geometry_msgs/msg/PoseArray": {**POSES, "gradient": lambda pair: all(map(colour, pair))},
    "geometry_msgs/msg/PoseStamped": {**POSES, "color": colour},
    "geometry_msgs/msg/PoseWithCovarianceStamped": {**POSES, "color": colour},
}


def leaves(node):
    """Panel ids of a layout tree: a split has two sides, a direction and a share."""
    if isinstance(node, str):
        return [node]
    assert set(node) <= {"first", "second", "direction", "splitPercentage"}
    assert node["direction"] in ("row", "column")
    assert 0 < node.get("splitPercentage", 50) < 100
    return leaves(node["first"]) + leaves(node["second"])


def test_the_file_has_the_parts_a_layout_must_have():
    assert set(LAYOUT) == {"configById", "globalVariables", "userNodes", "playbackConfig", "layout"}
    assert LAYOUT["playbackConfig"]["speed"] == 1


def test_every_panel_stands_in_the_layout_once_and_is_of_a_kind_the_viewers_have():
    placed = leaves(LAYOUT["layout"])
    assert sorted(placed) == sorted(PANELS)
    assert {name.partition("!")[0] for name in placed} <= {"3D", "Plot"}
    assert all(re.fullmatch(r"[A-Za-z0-9]+![a-z0-9]+", name) for name in placed)


@pytest.mark.parametrize("topic", PANELS["3D!turtlebag"]["topics"])
def test_a_topic_in_space_is_one_of_ours_and_set_as_its_type_can_be(topic):
    allowed = DRAWN[TOPICS[topic].msgtype]
    settings = dict(PANELS["3D!turtlebag"]["topics"][topic])
    assert settings.pop("visible") is True
    for key, value in settings.items():
        assert allowed[key](value), f"{topic}: {key} = {value}"


def test_what_navigation_adds_to_a_bag_can_all_be_seen():
    added = {"/map", "/amcl_pose", "/particlecloud", "/plan", "/goal_pose", "/scan"}
    assert added <= set(PANELS["3D!turtlebag"]["topics"])


def test_the_camera_looks_down_on_the_frame_of_the_map():
    panel = PANELS["3D!turtlebag"]
    assert panel["followTf"] == "map"
    assert panel["followMode"] in ("follow-pose", "follow-position", "follow-none")
    assert panel["cameraState"]["perspective"] is False
    assert panel["cameraState"]["phi"] == 0
    assert panel["layers"]["grid"]["layerId"] == "foxglove.Grid"
    published = panel["publish"]
    assert TOPICS[published["poseTopic"]].msgtype == "geometry_msgs/msg/PoseStamped"


PATHS = [
    (name, path["value"])
    for name, panel in PANELS.items()
    if name.startswith("Plot")
    for path in panel["paths"]
]


@pytest.mark.parametrize(("panel", "path"), PATHS)
def test_a_plotted_path_leads_through_the_message_to_a_number(panel, path):
    topic, *steps = path.split(".")
    kind = TOPICS[topic].msgtype
    for step in steps:
        node, description = dict(STORE.get_msgdef(kind).fields)[step]
        assert node.name in ("NAME", "BASE"), f"{path}: {step} is a list"
        kind = description if isinstance(description, str) else description[0]
    assert kind in NUMBERS


@pytest.mark.parametrize("panel", [name for name in PANELS if name.startswith("Plot")])
def test_every_plotted_line_has_a_name_with_its_unit(panel):
    for path in PANELS[panel]["paths"]:
        assert set(path) == {"value", "enabled", "timestampMethod", "label"}
        assert path["timestampMethod"] in ("receiveTime", "headerStamp")
        assert re.search(r"\[(m|m/s|rad/s)\]$", path["label"])


NAVIGATION = {"/map", "/plan", "/particlecloud", "/amcl_pose", "/goal_pose"}


def test_everything_of_the_layout_is_found_in_a_bag_of_navigation(tmp_path):
    write_drive(tmp_path / "bag", seconds=3, navigation=True)
    assert unresolved(LAYOUT, tmp_path / "bag") == []


def test_what_a_viewer_could_not_show_is_noticed(tmp_path):
    write_drive(tmp_path / "drive", seconds=3)
    blank = unresolved(LAYOUT, tmp_path / "drive", without={*NAVIGATION, "/points"})
    assert "fixed frame map is in no transform" in blank
    assert "/scan is in frame base_scan, which nothing connects" in blank
    assert "/plan is not in the bag" in unresolved(LAYOUT, tmp_path / "drive")
    with BagWriter(tmp_path / "loose", custom={}) as writer:
        writer.static_transforms(0, LINKS[:1])
        for step in range(1, 20):
            writer.observation(observation(step))
            writer.command(stamp(step), observation(step).odometry.twist)
    layout = json.loads(json.dumps(LAYOUT).replace('"followTf": "map"', '"followTf": "odom"'))
    without = {*NAVIGATION, "/points", "/ground_truth/odom"}
    assert unresolved(layout, tmp_path / "loose", without=without) == [
        "/scan is in frame base_scan, which nothing connects"
    ]


@pytest.mark.slow
def test_the_layout_beside_a_report_is_in_a_frame_its_bags_have_and_shows_all_the_ground(tmp_path):
    record = fake_record(tmp_path / "record")
    make_report([record], Output(tmp_path / "report"), animate=False)
    assert [path.name for path in (tmp_path / "report").glob("foxglove*")] == ["foxglove-layout.json"]
    layout = json.loads((tmp_path / "report/foxglove-layout.json").read_text())
    panel = layout["configById"]["3D!turtlebag"]
    assert panel["followTf"] == "odom"
    # The room is 6.6 x 5.4 m from (-3.3, -2.7).
    assert panel["cameraState"]["targetOffset"] == [0.0, 0.0, 0.0]
    assert panel["cameraState"]["distance"] == 8.6
    changed = {"followTf", "cameraState", "topics"}
    assert {key for key in panel if panel[key] != PANELS["3D!turtlebag"][key]} == changed
    without = {"/points", "/tf_static", "/amcl_pose"}
    assert unresolved(layout, record / "bag", without=without) == [
        "/scan is in frame base_scan, which nothing connects"
    ]
