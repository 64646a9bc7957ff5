"""The studio's server: pages and sockets in the event loop, the session in its own thread."""

from __future__ import annotations

import asyncio
import dataclasses
import logging
import math
import socket
import time
from collections import deque
from collections.abc import Callable, Sequence
from concurrent.futures import ThreadPoolExecutor
from contextlib import suppress
from functools import partial
from itertools import count
from pathlib import Path
from typing import TypeVar

from tornado.httpserver import HTTPServer
from tornado.web import Application
from tornado.websocket import WebSocketClosedError, WebSocketHandler

from turtlebag.datasets.durations import seconds
from turtlebag.datasets.errors import InputError
from turtlebag.pipeline.studio.access import Access, CheckedHandler, Page, Part, Rate, page_files
from turtlebag.pipeline.studio.inputs import (
    DRIVING,
    Button,
    Control,
    Drive,
    Input,
    Layers,
    Malformed,
    Plain,
    Speed,
    parse_message,
)
from turtlebag.pipeline.studio.pace import Pace, Pacer
from turtlebag.pipeline.studio.session import Session
from turtlebag.pipeline.studio.socket_messages import Frames, bye, hello
from turtlebag.pipeline.studio.view import View
from turtlebag.sim.robots import PERIOD_S

PAGE = Path(__file__).parent / "static"
HEARTBEAT_S = 0.5
"""Teleop stops the robot if the speed has not been repeated for this long."""
FRAME_S = 0.1
BUSY_S = 1.0
MOST_VIEWERS = 16
MESSAGES_A_SECOND = 60
HELD_BYTES = 256 * 1024
"""What the system keeps of frames for a client that is slow to read: beyond that, frames are dropped."""
GIANT_BYTES = 1024 * 1024
"""A message larger than this is not even read to its end."""
PING_S = 20.0
IDLE_S = 30.0
CLOSING_S = 1.0
"""So long the pages have to close in good order."""
LOOK_S, EXCUSE_EVERY = 0.05, 10
"""How often to look at the clock and whether the session is over, and after how many looks to tell what
keeps it."""
REFUSED, TRY_LATER = 1008, 1013
WATCHING = "You are watching. Take control to do that."
Result = TypeVar("Result")
log = logging.getLogger("turtlebag")


class Studio:
    """A session against the wall clock, its viewers, and the one that drives.

    It lives in the event loop's thread. Only the session computes in another, one thing at a time: no locks
    are needed, and the event loop answers meanwhile.
    """

    def __init__(self, session: Session) -> None:
        self._session = session
        self._computer = ThreadPoolExecutor(1, "session")
        self._pacer = Pacer(PERIOD_S)
        self._inputs: deque[tuple[Viewer, Button | Speed | Input]] = deque()
        self._asked = asyncio.Event()
        self._over = False
        self._doing = "", time.monotonic()
        """What the session does, and since when."""
        self._drive: Drive | None = None
        self._driven = 0.0
        """When a page last asked for that speed."""
        self._viewers: list[Viewer] = []
        self._driver: Viewer | None = None
        self._last: tuple[View, Pace] | None = None
        self._view_due = 0.0

    async def run(self) -> None:
        """Let the simulated time pass until the session ends; raises what goes wrong in it."""
        session = self._session
        try:
            while not (self._over or session.ended):
                await self._apply_inputs()
                if self._drive is not None and time.monotonic() - self._driven > HEARTBEAT_S:
                    await self._apply(Plain(do="stop"), log.warning)
                if session.idle:
                    self._pacer.take()  # a step at the end of a bag is not kept for later
                elif self._pacer.wait_s() == 0.0:
                    await self._compute("tick", self._advance)
                if self._viewers and time.monotonic() >= self._view_due:
                    self._view_due = max(self._view_due + FRAME_S, time.monotonic())
                    await self._show()
                await self._rest()
            await self._show()
        finally:
            self._computer.shutdown(wait=False)

    async def _compute(self, doing: str, function: Callable[[], Result]) -> Result:
        """What a function of the session returns; `doing` is told to the viewers if it takes long."""
        self._doing = doing, time.monotonic()
        try:
            return await asyncio.get_running_loop().run_in_executor(self._computer, function)
        finally:
            self._doing = "", time.monotonic()

    async def _apply_inputs(self) -> None:
        """All that is asked for by now. The same speed again only renews the heartbeat."""
        self._asked.clear()
        while self._inputs and not self._over:
            viewer, asked = self._inputs.popleft()
            if isinstance(asked, Button | Speed):
                self._pacer.control(asked)
            elif asked != self._drive:
                await self._apply(asked, viewer.refuse)

    async def _apply(self, entry: Input, refused: Callable[[str], None]) -> None:
        """Every input reaches the session here; those it refuses are not recorded."""
        try:
            done = await self._compute(entry.do, partial(self._session.apply, entry))
        except InputError as error:
            log.debug("refused: %s", error)
            refused(str(error))
            return
        log.debug("%.3f s: %s", seconds(self._session.stamp_ns), done)
        if entry.do in (*DRIVING, "reset", "end"):
            self._drive = entry if isinstance(entry, Drive) else None

    def _advance(self) -> None:
        """In the session's thread: the ticks that are due by now, until there is something else to do."""
        until = min(time.monotonic() + LOOK_S, self._view_due if self._viewers else math.inf)
        while not self._session.idle and self._pacer.take():
            self._session.tick()
            self._pacer.count(self._session.stamp_ns)
            if self._over or self._session.ended or self._inputs or time.monotonic() > until:
                return

    async def _rest(self) -> None:
        """Until the next tick is due, something is asked for, or it is time to look at the clock again."""
        wait_s = None if self._session.idle else self._pacer.wait_s()
        if wait_s != 0.0:
            with suppress(TimeoutError):
                await asyncio.wait_for(self._asked.wait(), LOOK_S if wait_s is None else min(wait_s, LOOK_S))

    async def _show(self) -> None:
        view = await self._compute("", self._session.view)
        self._last = view, self._pacer.pace(idle=self._session.idle)
        self._tell(None)

    def stop(self) -> None:
        """Let `run` end after what is being computed."""
        self._over = True
        self._session.interrupt()
        self._asked.set()

    async def part(self, reason: str, after: Sequence[str]) -> None:
        """Tell everybody why the session is over and what to do next, and close."""
        for viewer in list(self._viewers):
            viewer.part(1001, reason, after)
        patience = time.monotonic() + CLOSING_S
        while self._viewers and time.monotonic() < patience:
            await asyncio.sleep(0.02)
        for viewer in list(self._viewers):
            viewer.drop()

    def join(self, viewer: Viewer) -> None:
        """A page was opened; it drives if no other does."""
        if len(self._viewers) >= MOST_VIEWERS:
            viewer.part(TRY_LATER, f"{MOST_VIEWERS} pages are already open: close one")
            return
        self._viewers.append(viewer)
        self._driver = self._driver or viewer
        maps = () if self._last is None else self._last[0].maps
        viewer.send(hello(self._session.scene, maps=maps, driver=self._driver is viewer))

    def leave(self, viewer: Viewer) -> None:
        """A page was closed. If it drove, no page drives until one takes control."""
        if viewer in self._viewers:
            self._viewers.remove(viewer)
        if viewer is self._driver:
            self._driver = None

    def take(self, viewer: Viewer, asked: Control | Input) -> None:
        """A message of a viewer: anyone may choose layers; everything else is for the driving page."""
        if isinstance(asked, Layers):
            viewer.frames.layers = frozenset(asked.layers)
        elif asked.do == "take_control":
            self._driver = viewer
        elif viewer is not self._driver:
            viewer.error = WATCHING
        else:
            if isinstance(asked, Drive):
                self._driven = time.monotonic()
            self._inputs.append((viewer, asked))
            self._asked.set()

    def excuse(self) -> None:
        """Tell the viewers what has kept the session for a while: `tick`, or the `do` of an input."""
        doing, since = self._doing
        if doing and time.monotonic() - since > BUSY_S:
            self._tell(doing)

    def _tell(self, busy: str | None) -> None:
        if self._last is not None:
            view, pace = self._last
            for viewer in list(self._viewers):
                viewer.show(view, pace, driver=viewer is self._driver, busy=busy)


class Viewer(CheckedHandler, WebSocketHandler):
    """The socket of one page."""

    studio: Studio

    def initialize(self, studio: Studio) -> None:
        """Called by tornado for each connection."""
        self.studio, self.frames = studio, Frames()
        self.error: str | None = None
        self._rate = Rate(MESSAGES_A_SECOND)
        self._written: asyncio.Future[None] | None = None
        self._parted = False

    def check_origin(self, origin: str) -> bool:
        """Checked before: see `prepare`."""
        return True

    def open(self) -> None:
        """The page listens."""
        self.set_nodelay(True)
        assert self.ws_connection is not None
        assert self.ws_connection.stream is not None
        self._stream = self.ws_connection.stream  # tornado forgets it on closing
        self._stream.socket.setsockopt(socket.SOL_SOCKET, socket.SO_SNDBUF, HELD_BYTES)
        self.studio.join(self)

    def on_message(self, message: str | bytes) -> None:
        """Handle a message; clients that send too many or invalid ones are disconnected."""
        if self._parted:
            return
        try:
            if self._rate.exceeded():
                raise Malformed(f"at most {MESSAGES_A_SECOND} messages a second")
            self.studio.take(self, parse_message(message))
        except Malformed as error:
            self.part(REFUSED, str(error))
        except InputError as error:
            self.error = str(error)

    def on_close(self) -> None:
        """The page is gone."""
        self.studio.leave(self)

    def show(self, view: View, pace: Pace, *, driver: bool, busy: str | None) -> None:
        """Send what is new in a view; dropped while the frame before is still under way."""
        if self._parted or (self._written is not None and not self._written.done()):
            return
        told = {**dataclasses.asdict(pace), "driver": driver, "busy": busy, "error": self.error}
        self.send(self.frames.frame(view, told))
        self.error = None

    def refuse(self, said: str) -> None:
        """The session has refused what this page asked for last."""
        self.error = said

    def part(self, code: int, reason: str, after: Sequence[str] = ()) -> None:
        """Say why and what to do next, and close."""
        self._parted = True
        self.send(bye(reason, after))
        self.close(code, reason[:120])

    def drop(self) -> None:
        """Close without waiting for a page that does not listen."""
        self._stream.close()

    def send(self, message: bytes) -> None:
        """Hand a message to the system; `_written` is done when it has all of it."""
        try:
            self._written = self.write_message(message, binary=True)
        except WebSocketClosedError:
            return
        # A page that closes meanwhile is no error.
        self._written.add_done_callback(lambda written: written.cancelled() or written.exception())


def application(studio: Studio, access: Access, page: Path, ping_s: float) -> Application:
    """The page, its parts and the socket; everything else is not found, by the same rules."""
    return Application(
        [("/", Page), ("/socket", Viewer, {"studio": studio}), (r"/(.+)", Part)],
        default_handler_class=CheckedHandler,
        access=access,
        files=page_files(page),
        log_function=lambda handler: None,
        websocket_max_message_size=GIANT_BYTES,
        websocket_ping_interval=ping_s,
        websocket_ping_timeout=ping_s,
    )


async def serve(
    session: Session,
    access: Access,
    sockets: Sequence[socket.socket],
    *,
    interrupted: Sequence[int],
    ready: Callable[[], None],
    page: Path = PAGE,
    ping_s: float = PING_S,
    after: Callable[[], Sequence[str]] = tuple,
) -> None:
    """Run a session for those who open its page, until it ends or something is in `interrupted`.

    `ready` is called when the page can be opened, whose files are below the folder `page`; one that does not
    answer for `ping_s` is gone. `after` gives the lines that the pages show at the end: where
    the files are, and what to do with them. Raises what went wrong in the session.
    """
    studio = Studio(session)
    limits = {"max_header_size": 16 * 1024, "max_body_size": 0}
    server = HTTPServer(application(studio, access, page, ping_s), idle_connection_timeout=IDLE_S, **limits)
    server.add_sockets(sockets)
    running = asyncio.create_task(studio.run())
    ready()
    for turn in count():
        if interrupted or running.done():
            break
        if turn % EXCUSE_EVERY == 0:
            studio.excuse()
        await asyncio.sleep(LOOK_S)
    server.stop()
    studio.stop()
    try:
        await asyncio.wait([running])
        await studio.part("the studio was stopped" if interrupted else "the session has ended", after())
        running.result()
    finally:
        await server.close_all_connections()
