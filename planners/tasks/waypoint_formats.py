"""Waypoints as other programs write them, in our words.

Nav2's panel in RViz numbers its waypoints (`waypoint0: {pose: [x, y, z], orientation: [w, x, y, z]}`), ROS
messages are nested (PoseStamped in `ros2 topic echo`, PoseArray, Path, the routes of AWS' worlds), and people
name their places.
"""

from __future__ import annotations

import re
from collections.abc import Mapping
from typing import Any

POSE_KEYS = {"pose", "position"}
LABELS = {"name", "location_name", "id", "description", "metadata", "z", "covariance"}
"""Keys of an entry that say nothing of where to go on a plane."""
FRAMES = (None, "", "map", "/map")
NUMBERED = re.compile(r"(\D*)(\d+)")


def listed(data: Any) -> list[Any] | None:
    """The entries of a file: a list of them, the one that it is, or named ones; None for anything else.

    Names that end in numbers are put in the order of the numbers, others stay in the file's.
    """
    if isinstance(data, list):
        return data
    if not isinstance(data, Mapping):
        return None
    if POSE_KEYS & set(data):
        return [data]
    matches = [NUMBERED.fullmatch(str(name)) for name in data]
    numbers = [match[2].lstrip("0") for match in matches if match is not None]
    if len(numbers) == len(data) and len({match[1] for match in matches if match is not None}) == 1:
        ordered = sorted(zip(numbers, data.values(), strict=True), key=lambda pair: (len(pair[0]), pair[0]))
        return [entry for _, entry in ordered]
    return list(data.values())


def are_poses(data: Mapping[Any, Any]) -> bool:
    """Whether a mapping is a pose, or has nothing but poses by their names."""
    entries = [data] if POSE_KEYS & set(data) else list(data.values())
    return bool(entries) and all(isinstance(entry, Mapping) and POSE_KEYS & set(entry) for entry in entries)


def wrong_frame(data: Mapping[Any, Any]) -> str:
    """What is wrong with the frame that a message names; empty when it is the map's, or none is named."""
    header = data.get("header")
    named = data.get("frame_id", header.get("frame_id") if isinstance(header, Mapping) else None)
    return "" if named in FRAMES else f"its frame is {named}, not map"


def in_our_words(entry: Mapping[Any, Any]) -> Mapping[Any, Any] | str:
    """An entry with the keys x, y, yaw or quaternion [x, y, z, w], and what else it has; a text that says why
    it is not understood."""
    if wrong := wrong_frame(entry):
        return wrong
    entry = {key: value for key, value in entry.items() if key not in LABELS | {"header", "frame_id"}}
    for _ in range(2):  # PoseWithCovarianceStamped has a pose in its pose
        if isinstance(entry.get("pose"), Mapping):
            rest = {key: value for key, value in entry.items() if key != "pose"}
            entry = {key: value for key, value in {**entry["pose"], **rest}.items() if key not in LABELS}
    if "pose" in entry:
        return _of_nav2(entry)
    if "position" in entry:
        return _of_message(entry)
    if "theta" in entry and "yaw" not in entry:
        entry["yaw"] = entry.pop("theta")
    parts = ("qx", "qy", "qz", "qw")
    if all(part in entry for part in parts):
        entry["quaternion"] = [entry.pop(part) for part in parts]
    return entry


def _of_nav2(entry: dict[Any, Any]) -> Mapping[Any, Any] | str:
    place, turn = entry.pop("pose"), entry.pop("orientation", None)
    if not isinstance(place, list) or len(place) != 3:
        return "pose: expected [x, y, z], or position and orientation"
    if not isinstance(turn, list) or len(turn) != 4:
        return "orientation: expected [w, x, y, z], as Nav2's panel writes it"
    return {**entry, "x": place[0], "y": place[1], "quaternion": [*turn[1:], turn[0]]}


def _of_message(entry: dict[Any, Any]) -> Mapping[Any, Any] | str:
    place, turn = entry.pop("position"), entry.pop("orientation", None)
    if isinstance(place, list) and len(place) in (2, 3):
        place = dict(zip("xyz", place, strict=False))
    if isinstance(turn, Mapping) and not set(turn) ^ set("xyzw"):
        turn = [turn[axis] for axis in "xyzw"]
    if not isinstance(place, Mapping) or set(place) - set("xyz"):
        return "position: expected x, y and z"
    found = {**entry, **{axis: place[axis] for axis in "xy" if axis in place}}
    if turn is None:
        return found
    if isinstance(turn, Mapping) and set(turn) == {"yaw"}:
        return {**found, "yaw": turn["yaw"]}
    if isinstance(turn, list):
        return {**found, "quaternion": turn}
    return "orientation: expected x, y, z and w"
