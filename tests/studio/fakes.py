"""A session that simulates next to nothing, and a server of it in a thread."""

import asyncio
import threading
import time

import numpy as np

from docs.examples.studio_client import Client
from turtlebag.datasets.errors import InputError
from turtlebag.datasets.grid import OccupancyGrid
from turtlebag.datasets.se2 import SE2
from turtlebag.pipeline.studio.access import LOOPBACK, Access, listen, new_token
from turtlebag.pipeline.studio.inputs import Drive
from turtlebag.pipeline.studio.server import serve
from turtlebag.pipeline.studio.view import Event, MapLayer, Path, Scene, View

PERIOD_NS = 33_333_333
SCENE = Scene(
    world="fake",
    robot="burger",
    seed=3,
    max_v=0.22,
    max_w=2.84,
    bounds=(-1.0, -2.0, 3.0, 4.0),
    outline=np.array([[0.1, 0.1], [-0.1, 0.1], [-0.1, -0.1], [0.1, -0.1]]),
    world_segments=np.array([[0.0, 0.0, 1.0, 1.0]]),
    world_circles=np.zeros((0, 3)),
)


def view(**given):
    """A view of nothing much, but for what is given."""
    nothing = Path(0, np.zeros((0, 2)))
    return View(
        **dict.fromkeys(
            (
                "recording",
                "map_name",
                "sure",
                "lost",
                "goal",
                "sectors",
                "scan",
                "particles",
            )
        )
        | dict.fromkeys(("plan", "local", "graph", "map", "costmap"))
        | dict.fromkeys(("T_map_base", "T_odom_base", "T_world_base"), SE2.identity())
        | dict.fromkeys(("odom_path", "slam_path", "true_path"), nothing)
        | dict.fromkeys(("maps", "goals", "events", "keepout"), ())
        | {"waypoint_files": ("",)}
        | dict.fromkeys(("mapping", "localised"), False)
        | {"stamp_ns": 0, "owner": "navigation", "command": (0.0, 0.0), "task": "", "state": ""}
        | {"goal_index": -1, "boxes": np.zeros((0, 4))}
        | {"mover_segments": np.zeros((0, 4)), "mover_circles": np.zeros((0, 3))}
        | given
    )


class FakeSession:
    """Goes at the speed that is asked for, without any simulator; goals are refused."""

    scene = SCENE
    idle = False

    def __init__(self, tick_s=0.0, cells=None):
        self.stamp_ns, self.ended = 0, False
        self.applied, self.threads = [], set()
        self._tick_s, self._drive = tick_s, Drive()
        self._map = None if cells is None else MapLayer(OccupancyGrid(cells, 0.05))
        self._points, self._events = [(0.0, 0.0)], []
        self.broken, self.save_s = None, 0.0

    def apply(self, entry):
        self.threads.add(threading.get_ident())
        if entry.do == "goal":
            raise InputError("goal: there is no map to plan on")
        if entry.do == "map_save":
            time.sleep(self.save_s)
        self.applied.append((self.stamp_ns, entry))
        self._drive = entry if isinstance(entry, Drive) else Drive() if entry.do == "stop" else self._drive
        self.ended = entry.do == "end"
        self._events.append(Event(len(self._events) + 1, self.stamp_ns * 1e-9, entry.do, "info"))
        return entry.do

    def interrupt(self):
        pass

    def tick(self):
        if self.broken is not None:
            raise self.broken
        end = time.thread_time() + self._tick_s  # what a busy machine takes away is no part of it
        while time.thread_time() < end:
            pass
        self.stamp_ns += PERIOD_NS
        x, y = self._points[-1]
        self._points.append((x + self._drive.v * PERIOD_NS * 1e-9, y))

    def view(self):
        self.threads.add(threading.get_ident())
        points = np.array(self._points)
        return view(
            stamp_ns=self.stamp_ns,
            owner="teleop" if self._drive.v else "navigation",
            command=(self._drive.v, self._drive.w),
            T_map_base=SE2.from_xyt(*points[-1].tolist(), 0.0),
            slam_path=Path(0, points),
            events=tuple(self._events),
            map=self._map,
        )


class Served:
    """A server of a session, in a thread; leaving the block stops it as Ctrl-C does."""

    def __init__(self, session, host=LOOPBACK, **how):
        self.session, self.failure = session, None
        sockets = listen(host, 0)
        self.access = Access(new_token(), host, sockets[0].getsockname()[1])
        self._interrupted, ready = [], threading.Event()

        def run():
            try:
                asyncio.run(
                    serve(
                        session, self.access, sockets, interrupted=self._interrupted, ready=ready.set, **how
                    )
                )
            except BaseException as error:
                self.failure = error

        self.thread = threading.Thread(target=run)
        self.thread.start()
        assert ready.wait(10.0)

    @property
    def url(self):
        return self.access.url

    @property
    def place(self):
        return f"http://{LOOPBACK}:{self.access.port}"

    def stop(self):
        self._interrupted.append(2)
        self.thread.join(20.0)
        assert not self.thread.is_alive()

    def __enter__(self):
        return self

    def __exit__(self, *_):
        self.stop()


OPENED = []


async def connect(url, **headers):
    """A client that `run` closes in the end."""
    OPENED.append(await Client.open(url, **headers))
    return OPENED[-1]


def run(coroutine, most_s=30.0):
    """What a coroutine returns, if it does in time."""

    async def closing():
        try:
            return await asyncio.wait_for(coroutine, most_s)
        finally:
            while OPENED:
                OPENED.pop().close()
            await asyncio.sleep(0.05)

    return asyncio.run(closing())


def answers(served):
    """Whether the server still does what it is for."""

    async def watch():
        client = await connect(served.url)
        await client.until(lambda p: p.head)
        client.close()

    run(watch())
    return True
