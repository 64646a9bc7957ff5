"""Views as binary messages: each client gets what has changed since its last one.

A message is the length of its header (uint32, little-endian), the header as JSON, padding to 4 bytes, and
the blobs, each at a multiple of 4 bytes from the first. The header says what they are.
"""

from __future__ import annotations

import json
import math
import struct
import time
import zlib
from collections.abc import Callable, Mapping, Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

from turtlebag.datasets.durations import seconds
from turtlebag.datasets.grid import OccupancyGrid
from turtlebag.datasets.outputs import plain
from turtlebag.datasets.se2 import SE2
from turtlebag.pipeline.studio.view import BagMarks, CostLayer, MapLayer, Scene, View
from turtlebag.pipeline.terminal.keyboard_teleop import STEP_V, STEP_W
from turtlebag.sim.robots import CONTROL_HZ

COLUMNS = {
    "scan": 2,
    "particles": 3,
    "plan": 2,
    "local": 2,
    "boxes": 4,
    "mover_segments": 4,
    "mover_circles": 3,
}
"""Blobs that are sent whole when they change: what one row holds."""
SHOWN_BY = {"mover_segments": "ghost", "mover_circles": "ghost"}
"""Layers that show blobs of another name."""
PATHS = {"odom_path": "odom_path", "slam_path": "slam_path", "true_path": "ghost"}
"""Blobs that grow at their end, and the layers that they are shown by."""
GRIDS = {"map": 255, "costmap": 0}
"""Blobs of cells, and the value of those that are not sent because a client takes it for granted."""
AS_THEY_ARE = (
    "owner", "task", "state", "recording", "mapping", "bags", "maps", "waypoint_files", "localised", "sure",
    "lost", "goal_index", "goal",
)  # fmt: skip
"""Fields of a view that have the same name in the header of a frame."""
GRID_BYTES_A_SECOND = 150_000
"""A grid that changes faster than this can carry is sent less often: the newest one, when its turn comes."""
QUICK = 1
"""zlib's fastest level; 384 x 384 cells take a millisecond, and higher levels save little."""


class Message:
    """A header and blobs, put together."""

    def __init__(self, kind: str, **header: Any) -> None:
        self.header: dict[str, Any] = {"kind": kind, **header, "blobs": []}
        self._parts: list[bytes] = []
        self.size = 0
        """Bytes of the blobs."""

    def add(self, name: str, values: NDArray, dtype: str = "f4", *, zipped: bool = False) -> None:
        """Add an array as `dtype`: f4, i4 or u1, little-endian; `zipped`: as raw deflate."""
        data = np.ascontiguousarray(values, dtype=f"<{dtype}").tobytes()
        blob = {"name": name, "dtype": dtype, "shape": list(values.shape), "at": self.size}
        if zipped:
            squeeze = zlib.compressobj(QUICK, zlib.DEFLATED, -zlib.MAX_WBITS)
            data = squeeze.compress(data) + squeeze.flush()
            blob |= {"zip": True, "size": len(data)}
        self.header["blobs"].append(blob)
        padding = -len(data) % 4
        self._parts += [data, bytes(padding)]
        self.size += len(data) + padding

    def encoded(self) -> bytes:
        """The message as bytes."""
        header = json.dumps(self.header, separators=(",", ":"), allow_nan=False).encode()
        return b"".join([struct.pack("<I", len(header)), header, bytes(-len(header) % 4), *self._parts])


def hello(scene: Scene, *, maps: tuple[str, ...], driver: bool) -> bytes:
    """The first message to a client, with everything constant. `driver`: whether it drives."""
    message = Message(
        "hello",
        world=scene.world,
        robot=scene.robot,
        seed=scene.seed,
        control_hz=CONTROL_HZ,
        limits={"max_v": scene.max_v, "max_w": scene.max_w},
        bounds=list(scene.bounds),
        maps=list(maps),
        step_v=STEP_V,
        step_w=STEP_W,
        driver=driver,
    )
    message.add("outline", scene.outline)
    message.add("world_segments", scene.world_segments.reshape(-1, 4))
    message.add("world_circles", scene.world_circles.reshape(-1, 3))
    return message.encoded()


def bye(reason: str, after: Sequence[str] = ()) -> bytes:
    """The last message, which says why it is the last, and what to do `after` the session."""
    return Message("bye", reason=reason, after=list(after)).encoded()


class Frames:
    """What one client has been sent so far. `layers` are those it wants, None for all."""

    def __init__(self, clock: Callable[[], float] = time.monotonic) -> None:
        self._clock, self._grids_due = clock, -math.inf
        self.layers: frozenset[str] | None = None
        self._sent: dict[str, Any] = {}
        self._paths: dict[str, tuple[int, int]] = {}
        self._grids: dict[str, tuple[int, dict[str, Any], NDArray[np.uint8]]] = {}
        """Version, place and cells of each grid that was sent."""
        self._event = 0

    def frame(self, view: View, told: Mapping[str, Any]) -> bytes:
        """The message that updates the client to `view`; `told` is added to its header unchanged."""
        message = Message("frame", **words(view), **told)
        self._news(message, view)
        for name, columns in COLUMNS.items():
            if self._changed(name, value := getattr(view, name)):
                message.add(name, np.zeros((0, columns)) if value is None else value)
        for name, layer in PATHS.items():
            if self._wanted(layer):
                self._path(message, name, view)
        if self._changed("graph", view.graph):
            nodes, edges = (np.zeros((0, 3)), np.zeros((0, 3))) if view.graph is None else view.graph
            message.add("graph_nodes", nodes)
            message.add("graph_edges", edges, "i4")
        if view.bag is not None:
            self._bag(message, view.bag)
        if self._changed("keepout", view.keepout):
            message.header["keepout_sizes"] = [len(outline) for outline in view.keepout]
            message.add("keepout", np.concatenate([np.zeros((0, 2)), *view.keepout]))
        self._changed_grids(message, view)
        return message.encoded()

    def _news(self, message: Message, view: View) -> None:
        """Events since the last frame, and the waypoints if others are edited since."""
        message.header["events"] = [
            [round(event.t, 3), event.text, event.level]
            for event in view.events
            if event.number > self._event
        ]
        self._event = view.events[-1].number if view.events else 0
        if self._is_new("waypoints", view.waypoints):
            message.header["waypoints"] = [list(stop) for stop in view.waypoints]

    def _path(self, message: Message, name: str, view: View) -> None:
        version, points = getattr(view, name)
        was, count = self._paths.get(name, (None, 0))
        if version != was or count > len(points):
            count = 0
        elif count == len(points):
            return
        message.header.setdefault("append", {})[name] = count
        message.add(name, points[count:].reshape(-1, 2))
        self._paths[name] = version, len(points)

    def _bag(self, message: Message, bag: BagMarks) -> None:
        """Where a bag that is played stands, and the selected loop."""
        loop = bag.loop
        said = None if loop is None else {"scan": loop.scan, "place": loop.place, "told": loop.told}
        message.header["bag"] = {
            "position": round(bag.position_s, 3),
            "duration": round(bag.duration_s, 3),
            "edits": [list(edit) for edit in bag.edits],
            "loop": said,
        }
        if self._is_new("loop", loop):
            empty = np.zeros((0, 2))
            message.add("loop_scan", empty if loop is None else loop.scan_points)
            message.add("loop_place", empty if loop is None else loop.place_points)
        if self._wanted("graph") and self._is_new("graph_keys", bag.keys):
            message.add("graph_keys", bag.keys, "i4")

    def _changed_grids(self, message: Message, view: View) -> None:
        now = self._clock()
        if now < self._grids_due:
            return
        before = message.size
        for name in GRIDS:
            if self._changed(name, getattr(view, name)):
                self._grid(message, name, getattr(view, name))
        self._grids_due = now + (message.size - before) / GRID_BYTES_A_SECOND

    def _grid(self, message: Message, name: str, layer: MapLayer | CostLayer | None) -> None:
        """The rectangle about the cells that changed; a grid of another size or place starts anew.

        No layer any more is a grid of one blank cell.
        """
        layer = layer or MapLayer(OccupancyGrid(np.full((1, 1), GRIDS[name], np.uint8).view(np.int8), 1.0))
        cells, origin = layer.cells, layer.origin.xyt.tolist()
        place = {"w": cells.shape[1], "h": cells.shape[0], "resolution": layer.resolution, "origin": origin}
        version, there, before = self._grids.get(name, (0, None, cells))
        if there != place:
            version, before = version + 1, np.full_like(cells, GRIDS[name])
        self._grids[name] = version, place, cells
        differs = before != cells
        rows, columns = np.flatnonzero(differs.any(axis=1)), np.flatnonzero(differs.any(axis=0))
        part = cells[rows[0] : rows[-1] + 1, columns[0] : columns[-1] + 1] if len(rows) else cells[:0]
        tiles = [[int(columns[0]), int(rows[0]), part.shape[1], part.shape[0]]] if len(rows) else []
        message.header.setdefault("grids", {})[name] = {"version": version, **place, "tiles": tiles}
        message.add(f"{name}_tiles", part.ravel(), "u1", zipped=True)

    def _wanted(self, layer: str) -> bool:
        return self.layers is None or layer in self.layers

    def _changed(self, name: str, value: object) -> bool:
        """Whether to send it: it is wanted, and not the object sent last. Then it counts as sent."""
        return self._wanted(SHOWN_BY.get(name, name)) and self._is_new(name, value)

    def _is_new(self, name: str, value: object) -> bool:
        known = self._sent.get(name)
        self._sent[name] = value
        return value is not known


def words(view: View) -> dict[str, Any]:
    """What of a view goes into the header of every frame."""
    return {
        "t": round(seconds(view.stamp_ns), 4),
        "cmd": view.command,
        "map": view.map_name,
        "pose": _xyt(view.T_map_base),
        "odom_pose": _xyt(view.T_odom_base),
        "true_pose": _xyt(view.T_world_base),
        "goals": [mark._asdict() for mark in view.goals],
        # JSON knows no infinity: it becomes null.
        "sectors": None if view.sectors is None else plain(view.sectors._asdict()),
        **{name: getattr(view, name) for name in AS_THEY_ARE},
    }


def _xyt(pose: SE2) -> list[float]:
    return [round(value, 4) for value in pose.xyt.tolist()]
