"""The studio's server: pages and sockets in the event loop, the session in its own thread."""

from __future__ import annotations

import asyncio
import dataclasses
import socket
from collections.abc import Callable, Sequence
from itertools import count
from pathlib import Path

from tornado.httpserver import HTTPServer
from tornado.ioloop import IOLoop
from tornado.web import Application
from tornado.websocket import WebSocketClosedError, WebSocketHandler

from turtlebag.datasets.errors import InputError
from turtlebag.pipeline.studio.access import Access, CheckedHandler, Page, Part, Rate, page_files
from turtlebag.pipeline.studio.inputs import Button, Control, Input, Layers, Malformed, Speed, parse_message
from turtlebag.pipeline.studio.pace import Pace
from turtlebag.pipeline.studio.session import Session
from turtlebag.pipeline.studio.session_thread import SessionThread
from turtlebag.pipeline.studio.socket_messages import Frames, bye, hello
from turtlebag.pipeline.studio.view import View

PAGE = Path(__file__).parent / "static"
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
"""How often to look whether the session is over, and after how many looks to tell what keeps it."""
REFUSED, TRY_LATER = 1008, 1013
WATCHING = "You are watching. Take control to do that."


class Studio:
    """A session, its viewers, and the one that drives. Lives in the event loop's thread."""

    def __init__(self, session: Session) -> None:
        self._scene = session.scene
        self._loop = IOLoop.current()
        self.thread = SessionThread(session, self._show)
        self._viewers: list[Viewer] = []
        self._driver: Viewer | None = None
        self._last: tuple[View, Pace] | None = None

    async def end(self, reason: str) -> None:
        """Stop the time, tell everybody why, and close; raises what went wrong in the session."""
        await asyncio.to_thread(self.thread.end)
        for viewer in list(self._viewers):
            viewer.part(1001, reason)
        patience = self._loop.time() + CLOSING_S
        while self._viewers and self._loop.time() < patience:
            await asyncio.sleep(0.02)
        for viewer in list(self._viewers):
            viewer.drop()
        if self.thread.failure is not None:
            raise self.thread.failure

    def join(self, viewer: Viewer) -> None:
        """A page was opened; it drives if no other does."""
        if len(self._viewers) >= MOST_VIEWERS:
            viewer.part(TRY_LATER, f"{MOST_VIEWERS} pages are already open: close one")
            return
        self._viewers.append(viewer)
        self._driver = self._driver or viewer
        maps = () if self._last is None else self._last[0].maps
        viewer.send(hello(self._scene, maps=maps, driver=self._driver is viewer))
        self.thread.want_view()

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
        elif isinstance(asked, Button | Speed):
            self.thread.control(asked)
        else:
            self.thread.ask(asked, lambda said: self._loop.add_callback(viewer.refuse, said))

    def _show(self, view: View, pace: Pace) -> None:
        """Called in the session's thread."""
        self._loop.add_callback(self._send, view, pace)

    def _send(self, view: View, pace: Pace) -> None:
        self._last = view, pace
        self._tell(None)
        if self._viewers:
            self.thread.want_view()

    def excuse(self) -> None:
        """Tell the viewers what the session is busy with, if it has not given a new view for a while."""
        if (busy := self.thread.busy) is not None:
            self._tell(busy)

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

    def part(self, code: int, reason: str) -> None:
        """Say why, and close."""
        self._parted = True
        self.send(bye(reason))
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
) -> None:
    """Run a session for those who open its page, until it ends or something is in `interrupted`.

    `ready` is called when the page can be opened, whose files are below the folder `page`; one that does not
    answer for `ping_s` is gone. Raises what went wrong in the session.
    """
    studio = Studio(session)
    limits = {"max_header_size": 16 * 1024, "max_body_size": 0}
    server = HTTPServer(application(studio, access, page, ping_s), idle_connection_timeout=IDLE_S, **limits)
    server.add_sockets(sockets)
    studio.thread.start()
    ready()
    for turn in count():
        if interrupted or not studio.thread.running:
            break
        if turn % EXCUSE_EVERY == 0:
            studio.excuse()
        await asyncio.sleep(LOOK_S)
    server.stop()
    try:
        await studio.end("the studio was stopped" if interrupted else "the session has ended")
    finally:
        await server.close_all_connections()
