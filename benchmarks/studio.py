"""What the studio costs: how late its frames are, how many bytes, how much a viewer slows it, its memory.

python -m benchmarks.studio [--minutes M] [--out DIR]

The server is a process of its own, the viewer this one, without a page. `late` is from when a view is asked
of the session to when the viewer has taken it in. Speeds are simulated seconds a second, as fast as it goes,
in turns with a viewer and without. With --minutes the robot then goes on patrol after patrol for so long, as
fast as it goes, and everything is recorded.

With TURTLEBAG_DATA, the map of ACES is sent as it grows, at the log's own pace.
"""

from __future__ import annotations

import asyncio
import dataclasses
import sys
import tempfile
import time
from collections.abc import Iterator
from contextlib import contextmanager
from multiprocessing.connection import Connection
from pathlib import Path
from typing import Any

import numpy as np
from tornado.websocket import WebSocketClientConnection

from benchmarks.runner import SPAWN, Row, held_mb, options, public_log, write
from docs.examples.studio_client import Client
from turtlebag.datasets.maps import save_map
from turtlebag.datasets.recordings import load_recording
from turtlebag.pipeline.slam.online.mapper import Mapper
from turtlebag.pipeline.studio.access import LOOPBACK, Access, listen, new_token
from turtlebag.pipeline.studio.pilot import DRAWN_EVERY_NS
from turtlebag.pipeline.studio.server import serve
from turtlebag.pipeline.studio.session import Session
from turtlebag.pipeline.studio.setup import StudioSetup
from turtlebag.pipeline.studio.socket_messages import Frames
from turtlebag.pipeline.studio.view import MapLayer, View
from turtlebag.sim.robots import load_robot
from turtlebag.sim.worlds import load_world

WORLD, ROBOT = "turtlebot3_world", "burger"
WATCHED_S, TURN_S, TURNS = 20.0, 10.0, 4
START = [-2.0, -0.5, 0.0]


class Stamped(Session):
    """Says in each view when it was asked for."""

    def view(self) -> View:
        at = time.monotonic()
        return dataclasses.replace(super().view(), state=repr(at))


class Viewer(Client):
    """A client that knows how late each message was [s], NaN where it tells no view."""

    def __init__(self, connection: WebSocketClientConnection) -> None:
        super().__init__(connection)
        self.lates: list[float] = []

    async def next(self, timeout_s: float = 20.0) -> bool:
        there = await super().next(timeout_s)
        if there:
            self.lates.append(self.arrivals[-1] - float(self.picture.head.get("state", "nan")))
        return there


def serve_here(world: str, map_path: Path | None, folder: Path, told: Connection) -> None:
    """What the other process does: a studio; its address is told."""
    sockets = listen(LOOPBACK, 0)
    access = Access(new_token(), LOOPBACK, sockets[0].getsockname()[1])
    with Stamped(StudioSetup(world, ROBOT, 1, map_path), folder, lambda line: None) as session:
        asyncio.run(serve(session, access, sockets, interrupted=[], ready=lambda: told.send(access.url)))


@contextmanager
def studio(world: str, map_path: Path | None) -> Iterator[tuple[str, int]]:
    """A running studio: its address and process."""
    told, theirs = SPAWN.Pipe(duplex=False)
    with tempfile.TemporaryDirectory() as folder:
        process: Any = SPAWN.Process(target=serve_here, args=(world, map_path, Path(folder), theirs))
        process.start()
        theirs.close()
        try:
            yield told.recv(), process.pid
        finally:
            process.terminate()
            process.join()


async def joined(url: str) -> Viewer:
    """A viewer that has seen a frame."""
    client = await Viewer.open(url)
    await client.until(lambda p: p.head, 120.0)
    return client


async def watched(client: Viewer, what: str, factor: float, seconds: float = WATCHED_S) -> Row:
    """A row: how the frames of some time at a speed arrived."""
    client.ask("speed", factor=factor)
    await client.until(lambda p: p.head["asked"] == factor)
    first, t = len(client.arrivals), client.picture.head["t"]
    await client.read_for(seconds)
    pace = (client.picture.head["t"] - t) / (client.arrivals[-1] - client.arrivals[first - 1])
    late, spent = 1e3 * np.array(client.lates[first:]), client.arrivals[-1] - client.arrivals[first]
    return {
        "what": what,
        "speed": "any" if factor == 0 else f"{factor:g}",
        "x_real_time": round(pace, 1),
        "frames/s": round(late.size / spent, 1),
        "late_median_ms": round(float(np.median(late)), 1),
        "late_p95_ms": round(float(np.quantile(late, 0.95)), 1),
        "kB/s": round(sum(client.sizes[first:]) / spent / 1e3, 1),
    }


async def on_patrol(url: str, laps: int) -> Viewer:
    """A viewer of a robot on its map and on patrol, as fast as it goes."""
    client = await joined(url)
    client.ask("pose_estimate", pose=START)
    client.ask("waypoints_load")
    await client.until(lambda p: p.waypoints, 120.0)
    go_round(client, laps)
    await client.until(lambda p: p.head["task"] == "patrol", 120.0)
    client.ask("speed", factor=0)
    return client


def go_round(client: Viewer, laps: int) -> None:
    """Ask for a patrol of the waypoints that are loaded."""
    stops = [{"pose": [x, y, yaw]} for x, y, yaw, *_ in client.picture.waypoints]
    client.ask("patrol", waypoints=stops, laps=laps)


async def patrol(url: str) -> tuple[list[Row], Row]:
    """Rows of a patrol that is watched, and its speed with and without a viewer."""
    client = await on_patrol(url, 1000)
    await client.read_for(5.0)  # what is compiled at first use
    rows = [await watched(client, "patrol in the arena", factor) for factor in (1.0, 0.0)]
    speeds: dict[bool, list[float]] = {True: [], False: []}
    for turn in range(2 * TURNS):
        looking = turn % 2 == 0
        t, at = client.picture.head["t"], time.monotonic()
        if looking:
            await client.read_for(TURN_S)
        else:
            client.close()
            await asyncio.sleep(TURN_S)
            client = await joined(url)
        speeds[looking].append((client.picture.head["t"] - t) / (time.monotonic() - at))
    with_one, without = np.median(speeds[True]), np.median(speeds[False])
    assert client.picture.head["task"] == "patrol", client.picture.events[-3:]
    client.close()
    return rows, {
        "with a viewer": round(float(with_one), 2),
        "without": round(float(without), 2),
        "share_%": round(100.0 * float(with_one / without)),
    }


async def exploring(url: str) -> Row:
    """A row of a map that grows while the robot explores the house."""
    client = await joined(url)
    client.ask("explore")
    await client.until(lambda p: "map" in p.grids, 120.0)
    return await watched(client, "exploring the house", 1.0, 3 * WATCHED_S)


async def memory(url: str, pid: int, minutes: float) -> list[Row]:
    """Memory of the server, ten times within some minutes of patrol as fast as it goes, with a viewer."""
    client, rows = await on_patrol(url, 1), []
    client.ask("record", name="all")
    begin = time.monotonic()
    for part in range(11):
        while time.monotonic() < begin + 6.0 * part * minutes:
            await client.read_for(0.3)
            if not client.picture.head["task"]:
                go_round(client, 1)
        head = client.picture.head
        told = {"wall_min": round(0.1 * part * minutes, 2), "simulated_min": round(head["t"] / 60)}
        rows.append(told | {"mb": round(held_mb(pid))})
        print(rows[-1], file=sys.stderr, flush=True)
    client.close()
    return rows


def aces(log: Path) -> Row:
    """A row of the frames that bring a log's map to a client as it grows, without a socket."""
    recording = load_recording(log)
    assert recording.T_odom_base is not None
    with tempfile.TemporaryDirectory() as folder:
        setup = StudioSetup("empty", ROBOT, 1)
        with Session(setup, Path(folder), lambda line: None) as session:
            view = session.view()
    mapper, drawn_ns = Mapper(recording.lidar, recording.T_base_lidar), int(recording.stamps_ns[0])
    frames, sizes, spent = Frames(lambda: 1e-9 * drawn_ns), [], []
    for k, stamp_ns in enumerate(recording.stamps_ns.tolist()):
        mapper.add(recording.scan(k), recording.T_odom_base[k])
        if stamp_ns - drawn_ns < DRAWN_EVERY_NS:
            continue
        drawn_ns = stamp_ns
        now = dataclasses.replace(view, map=MapLayer(mapper.map()))
        start = time.process_time()
        sizes.append(len(frames.frame(now, {})))
        spent.append(time.process_time() - start)
    every = 1e-9 * DRAWN_EVERY_NS
    return {
        "log": log.name,
        "kB/s": round(sum(sizes) / recording.duration() / 1e3, 1),
        "kB/s_most": round(max(sizes) / every / 1e3, 1),
        "ms_median": round(1e3 * float(np.median(spent)), 1),
        "ms_most": round(1e3 * max(spent), 1),
    }


def main() -> None:
    parser = options(__doc__)
    parser.add_argument("--minutes", type=float, default=0.0)
    args = parser.parse_args()
    with tempfile.TemporaryDirectory() as folder:
        map_path = Path(folder) / "map.yaml"
        save_map(load_world(WORLD).rasterize(load_robot(ROBOT).lidar_height), Path(folder))
        with studio(WORLD, map_path) as (url, _):
            rows, speeds = asyncio.run(patrol(url))
        with studio("turtlebot3_house", None) as (url, _):
            rows.append(asyncio.run(exploring(url)))
        write(args.out, "studio", rows)
        if log := public_log("aces"):
            write(args.out, "studio_aces", [aces(log)])
        write(args.out, "studio_viewer", [speeds])
        if args.minutes:
            with studio(WORLD, map_path) as (url, pid):
                write(args.out, "studio_memory", asyncio.run(memory(url, pid, args.minutes)))


if __name__ == "__main__":
    main()
