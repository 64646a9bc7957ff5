"""Waypoints of other programs: Nav2's panel, ROS messages, AWS' routes, files written by hand."""

import math

import pytest
import yaml

from turtlebag.planners.tasks.waypoints import load_waypoints, parse_waypoint, parse_waypoints

HALF = math.sqrt(0.5)
PLACES = [(1.0, 2.0, math.pi / 2.0), (-3.0, 0.5, 0.0), (0.0, -1.0, -math.pi / 2.0)]


def quaternion(yaw):
    return {"x": 0.0, "y": 0.0, "z": math.sin(yaw / 2.0), "w": math.cos(yaw / 2.0)}


def message(x, y, yaw):
    return {"position": {"x": x, "y": y, "z": 0.0}, "orientation": quaternion(yaw)}


def stamped(*pose, frame="map"):
    return {"header": {"stamp": {"sec": 1, "nanosec": 0}, "frame_id": frame}, "pose": message(*pose)}


def panel(x, y, yaw):
    q = quaternion(yaw)
    return {"pose": [x, y, 0], "orientation": [q["w"], q["x"], q["y"], q["z"]]}


POSES = [message(*place) for place in PLACES]
FILES = {
    "nav2_panel": {"waypoints": {f"waypoint{k}": panel(*place) for k, place in enumerate(PLACES)}},
    "posestamped": [stamped(*place) for place in PLACES],
    "posestamped_below_waypoints": {"waypoints": [stamped(*place) for place in PLACES]},
    "pose_array": {"header": {"frame_id": "map"}, "poses": POSES},
    "aws_route": {"mode": "inorder", "poses": [{"pose": pose} for pose in POSES]},
    "amcl_poses": [{"header": {"frame_id": "map"}, "pose": {"pose": p, "covariance": [0.0]}} for p in POSES],
    "named": {"waypoints": {name: pose for name, pose in zip("cab", POSES, strict=True)}},
    "named_at_the_top": {name: {"pose": pose} for name, pose in zip("cab", POSES, strict=True)},
    "lists": {k: {"position": [x, y], "orientation": list(quaternion(a).values())} for k, (x, y, a) in
              enumerate(PLACES)},
    "flat": [{"frame_id": "map", "x": x, "y": y, "z": 0.0, **{f"q{k}": v for k, v in quaternion(a).items()}}
             for x, y, a in PLACES],
    "theta": [{"location_name": "kitchen", "x": x, "y": y, "theta": a} for x, y, a in PLACES],
    "yaw": {"waypoints": [{"position": {"x": x, "y": y}, "orientation": {"yaw": a}} for x, y, a in PLACES]},
}  # fmt: skip


@pytest.mark.parametrize("name", FILES)
def test_a_file_of_another_program_is_read(tmp_path, name):
    path = tmp_path / "route.yaml"
    path.write_text(yaml.safe_dump(FILES[name], sort_keys=False))
    found = load_waypoints(path)
    assert [waypoint.reason for waypoint in found.waypoints] == [""] * 3
    for waypoint, place in zip(found.waypoints, PLACES, strict=True):
        assert waypoint.T_map_goal.xyt == pytest.approx(place)
    assert found.notes == ()


def test_what_ros2_topic_echo_prints_is_read(tmp_path):
    path = tmp_path / "echo.yaml"
    path.write_text("".join(f"{yaml.safe_dump(stamped(*place))}---\n" for place in PLACES))
    found = load_waypoints(path).waypoints
    assert [tuple(waypoint.T_map_goal.xyt) for waypoint in found] == [pytest.approx(p) for p in PLACES]
    path.write_text(f"{yaml.safe_dump(stamped(*PLACES[0]))}---\n")
    assert load_waypoints(path).waypoints[0].T_map_goal.xyt == pytest.approx(PLACES[0])


def test_numbered_waypoints_go_by_their_numbers_and_named_ones_by_their_lines():
    numbered = {f"waypoint{k}": panel(float(k), 0.0, 0.0) for k in (10, 2, 0, 9, 100)}
    found = parse_waypoints({"waypoints": numbered}, "file")
    assert [waypoint.written[0] for waypoint in found.waypoints] == [0.0, 2.0, 9.0, 10.0, 100.0]
    named = {"b2": panel(1.0, 0.0, 0.0), "a1": panel(2.0, 0.0, 0.0)}
    assert [w.written[0] for w in parse_waypoints({"waypoints": named}, "file").waypoints] == [1.0, 2.0]


def test_nav2s_panel_has_w_first_and_messages_have_it_last():
    for entry, yaw in (
        ({"pose": [1, 2, 0], "orientation": [HALF, 0, 0, HALF]}, math.pi / 2.0),
        ({"pose": [1, 2, 0], "orientation": [0, 0, 0, 1]}, math.pi),
        ({"position": [1, 2, 0], "orientation": [0, 0, 0, 1]}, 0.0),
        ({"position": [1, 2], "orientation": [0, 0, HALF, HALF]}, math.pi / 2.0),
    ):
        assert math.remainder(parse_waypoint(entry).written[2] - yaw, 2.0 * math.pi) == pytest.approx(0.0)


def test_a_route_in_another_order_is_told():
    route = {"mode": "random", "poses": POSES}
    assert parse_waypoints(route, "file").notes == (
        "file: mode random: the poses are visited in the file's order",
    )
