"""Waypoint files: a list of poses, and keep-out areas; files of keep-out areas."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass
from importlib import resources
from pathlib import Path
from typing import Any

import numpy as np

from turtlebag.datasets.errors import InputError
from turtlebag.datasets.grid import OCCUPIED
from turtlebag.datasets.maps import load_map
from turtlebag.datasets.number_text import decimal
from turtlebag.datasets.se2 import SE2, Array
from turtlebag.datasets.yaml_files import parsed, read_documents, read_mapping
from turtlebag.planners.costmap import Area
from turtlebag.planners.tasks.waypoint_formats import are_poses, in_our_words, listed, wrong_frame

KEYS = {"waypoints", "keepout", "frame_id", "header"}
ROUTE_KEYS = {"poses", "keepout", "frame_id", "header", "mode"}
"""Of PoseArray, Path and the routes of AWS."""
MOST_WAIT_S = 3600.0
ENTRY_KEYS = ("x", "y", "yaw", "quaternion", "wait")


@dataclass(frozen=True, eq=False)
class Waypoint:
    """An entry: a pose in the map frame, or the reason why it is invalid. `written` holds the x, y, yaw found
    in the file, NaN where a number is missing. `wait` is the time to stay there [s]; None: that of the
    patrol's configuration."""

    T_map_goal: SE2 | None
    reason: str = ""
    written: tuple[float, float, float] = (math.nan, math.nan, math.nan)
    wait: float | None = None


@dataclass(frozen=True, eq=False)
class WaypointFile:
    """Waypoints in order, keep-out polygons (n, 2) in the map frame, and what to say of the file."""

    waypoints: tuple[Waypoint, ...]
    keepout: tuple[Array, ...] = ()
    notes: tuple[str, ...] = ()


def tutorial_patrol() -> WaypointFile:
    """The tutorial's eight waypoints."""
    text = resources.files("turtlebag.planners.tasks").joinpath("patrol.yaml").read_text()
    return parse_waypoints(parsed(text, where="patrol.yaml"), "patrol.yaml")


def load_waypoints(path: Path) -> WaypointFile:
    """Read a waypoints YAML; a bad entry becomes a Waypoint with a reason, a bad file an InputError."""
    where = f"--waypoints {path}"
    documents = read_documents(path, where=where)
    return parse_waypoints(documents[0] if len(documents) == 1 else documents, where)


def parse_waypoints(data: Any, where: str) -> WaypointFile:
    """The content of a waypoints file: a list of entries, or a mapping with `waypoints` and `keepout`; or
    what other programs write."""
    if not isinstance(data, Mapping) or are_poses(data):
        data = {"waypoints": data}
    key, known = ("poses", ROUTE_KEYS) if "poses" in data else ("waypoints", KEYS)
    entries = listed(data.get(key))
    if entries is None:
        raise InputError(f"{where}: expected a list of waypoints, or the key 'waypoints' with one")
    if unknown := sorted(str(key) for key in set(data) - known):
        raise InputError(f"{where}: unknown key {unknown[0]} (known: {', '.join(sorted(known))})")
    if not entries:
        raise InputError(f"{where}: contains no waypoints")
    if wrong := wrong_frame(data):
        raise InputError(f"{where}: {wrong}")
    mode = data.get("mode", "inorder")
    return WaypointFile(
        tuple(parse_waypoint(entry) for entry in entries),
        parse_polygons(data.get("keepout") or [], where),
        () if mode == "inorder" else (f"{where}: mode {mode}: the poses are visited in the file's order",),
    )


def parse_waypoint(entry: Any) -> Waypoint:
    """One entry: x, y and yaw or quaternion [x, y, z, w]; [x, y, yaw] is understood too, and the poses of
    other programs."""
    if isinstance(entry, (list, tuple)) and len(entry) in (2, 3):
        entry = dict(zip(("x", "y", "yaw"), entry, strict=False))
    if not isinstance(entry, Mapping):
        return Waypoint(None, "not an entry with x, y and yaw")
    entry = in_our_words(entry)
    if isinstance(entry, str):
        return Waypoint(None, entry)
    x, y = _number(entry.get("x")), _number(entry.get("y"))
    if unknown := sorted(str(key) for key in set(entry) - set(ENTRY_KEYS)):
        known = ", ".join(ENTRY_KEYS)
        return Waypoint(None, f"unknown key {unknown[0]} (known: {known})", (x, y, math.nan))
    if "quaternion" in entry:
        if "yaw" in entry:
            return Waypoint(None, "both yaw and quaternion are given", (x, y, math.nan))
        yaw, reason = _yaw_of(entry["quaternion"])
    else:
        yaw = _number(entry.get("yaw", 0.0))
        reason = "" if math.isfinite(yaw) else "yaw is not a finite number"
    written = (x, y, yaw)
    for name, value in (("x", x), ("y", y)):
        if name not in entry:
            return Waypoint(None, f"{name} is missing", written)
        if not math.isfinite(value):
            return Waypoint(None, f"{name} is not a finite number", written)
    wait = None if entry.get("wait") is None else _number(entry["wait"])
    if wait is not None and not 0.0 <= wait <= MOST_WAIT_S:
        reason = reason or f"wait must be 0 to {MOST_WAIT_S:g} s"
    if reason:
        return Waypoint(None, reason, written)
    return Waypoint(SE2.from_xyt(x, y, yaw), "", written, wait)


def _number(value: Any) -> float:
    if isinstance(value, bool):
        return math.nan
    try:
        return decimal(value) if isinstance(value, str) else float(value)
    except (TypeError, ValueError, OverflowError):
        return math.nan


def _yaw_of(value: Any) -> tuple[float, str]:
    """Yaw of a quaternion [x, y, z, w], normalised; the reason when it has none."""
    if not isinstance(value, (list, tuple)) or len(value) != 4:
        return math.nan, "invalid quaternion: expected [x, y, z, w]"
    quaternion = np.array([_number(part) for part in value])
    norm = math.hypot(*quaternion)
    if not math.isfinite(norm) or norm < 1e-9:
        return math.nan, "invalid quaternion: its norm is zero or not finite"
    x, y, z, w = (quaternion / norm).tolist()
    return math.atan2(2.0 * (w * z + x * y), 1.0 - 2.0 * (y * y + z * z)), ""


def load_keepout(path: Path) -> tuple[Area, ...]:
    """Keep-out areas of a YAML file: polygons under `keepout`, (n, 2) each in the map frame, or a map whose
    occupied cells they are, as the mask of Nav2's keepout filter."""
    data = read_mapping(path)
    if "image" not in data:
        return parse_polygons(data.get("keepout"), f"--keepout {path}")
    mask = load_map(path)
    if not (mask.cells == OCCUPIED).any():
        raise InputError(f"--keepout {path}: its image has no occupied cell, so it keeps out of nothing")
    return (mask,)


def parse_polygons(data: Any, where: str) -> tuple[Array, ...]:
    """Polygons of at least three finite corners; InputError names a bad one."""
    if not isinstance(data, list):
        raise InputError(f"{where}: keepout: expected a list of polygons")
    polygons = []
    for index, corners in enumerate(data, start=1):
        try:
            polygon = np.array(corners, dtype=np.float64)
        except (TypeError, ValueError, OverflowError):
            polygon = np.zeros(0)
        if polygon.ndim != 2 or polygon.shape[1] != 2 or len(polygon) < 3 or not np.isfinite(polygon).all():
            raise InputError(f"{where}: keepout {index}: expected three or more corners [x, y]")
        polygons.append(polygon)
    return tuple(polygons)
