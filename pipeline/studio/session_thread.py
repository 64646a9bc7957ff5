"""Runs a session against the wall clock, in its own thread.

The session belongs to that thread: all requests go through one queue, and the answers are immutable
views. So no locks are needed, and the event loop answers while the session computes.
"""

from __future__ import annotations

import logging
import queue
import threading
import time
from collections.abc import Callable

from turtlebag.datasets.durations import seconds
from turtlebag.datasets.errors import InputError
from turtlebag.pipeline.studio.inputs import DRIVING, Button, Drive, Input, Plain, Speed
from turtlebag.pipeline.studio.pace import Pace, Pacer
from turtlebag.pipeline.studio.session import Session
from turtlebag.pipeline.studio.view import View
from turtlebag.sim.robots import PERIOD_S

HEARTBEAT_S = 0.5
"""Teleop stops the robot if the speed has not been repeated for this long."""
FRAME_S = 0.1
IDLE_S = 0.05
"""How long the thread waits at most before it looks at the clock again."""
BUSY_S = 1.0
log = logging.getLogger("turtlebag")


Refused = Callable[[str], None]


class SessionThread:
    """The thread. `show` is called in it with each view that `want_view` asked for."""

    def __init__(self, session: Session, show: Callable[[View, Pace], None]) -> None:
        self._session, self._show = session, show
        self._todo: queue.SimpleQueue[Callable[[], None]] = queue.SimpleQueue()
        self._thread = threading.Thread(target=self._run, name="session")
        self._wanted = threading.Event()
        self._over = False
        self._pacer = Pacer(PERIOD_S)
        self._view_due = 0.0
        self._drive: Drive | None = None
        self._driven = 0.0
        self._doing = "", time.monotonic()
        """What is being done, and since when; one object, as the event loop reads it at any moment."""
        self.failure: BaseException | None = None
        """What ended the thread, if not its `end`."""

    def start(self) -> None:
        """Let the simulated time pass."""
        self._thread.start()

    @property
    def running(self) -> bool:
        """Whether it does; not, once the session has ended or failed."""
        return self._thread.is_alive()

    @property
    def busy(self) -> str | None:
        """What has kept the session for a second, `tick` or the `do` of an input; None for nothing."""
        doing, since = self._doing
        return (doing or None) if time.monotonic() - since > BUSY_S else None

    def end(self) -> None:
        """Stop after the tick that is being computed; returns when the session is the caller's again."""
        self._over = True
        self._session.interrupt()
        self._todo.put(lambda: None)
        self._thread.join()

    # What follows is called by the event loop.

    def ask(self, entry: Input, refused: Refused) -> None:
        """Have an input applied before the next tick; `refused` is called in the thread with the reason."""
        at = time.monotonic()
        self._todo.put(lambda: self._take(entry, at, refused))

    def control(self, asked: Button | Speed) -> None:
        """Pause, resume, ask for a single tick, or change the speed."""
        self._todo.put(lambda: self._pacer.control(asked))

    def want_view(self) -> None:
        """Have the next view shown that is due; until then, none is made."""
        self._wanted.set()

    # What follows runs in the thread.

    def _run(self) -> None:
        try:
            while not self._over and not self._session.ended:
                self._do_what_is_asked()
                self._stop_unless_driven()
                if not self._over and self._pacer.take() and not self._session.idle:
                    self._begin("tick")
                    self._session.tick()
                    self._pacer.count(self._session.stamp_ns)
                self._begin("")
                self._show_if_wanted()
            self._show(self._session.view(), self._pacer.pace(idle=self._session.idle))
        except BaseException as error:
            self.failure = error

    def _begin(self, doing: str) -> None:
        self._doing = doing, time.monotonic()

    def _do_what_is_asked(self) -> None:
        """All that is in the queue; when the next tick is not due, wait for it there."""
        wait = self._wait_s()
        while True:
            try:
                action = self._todo.get(timeout=wait) if wait > 0.0 else self._todo.get_nowait()
            except queue.Empty:
                return
            if self._over:
                return
            action()
            wait = 0.0

    def _wait_s(self) -> float:
        wait = None if self._session.idle else self._pacer.wait_s()
        return IDLE_S if wait is None else min(wait, IDLE_S)

    def _take(self, entry: Input, at: float, refused: Refused) -> None:
        """An input of the page. The same speed again only renews the heartbeat."""
        if isinstance(entry, Drive):
            self._driven = at
            if entry == self._drive:
                return
        self._apply(entry, refused)

    def _apply(self, entry: Input, refused: Refused) -> None:
        """Every input reaches the session here; those it refuses are not recorded."""
        self._begin(entry.do)
        try:
            done = self._session.apply(entry)
        except InputError as error:
            log.debug("refused: %s", error)
            refused(str(error))
            return
        log.debug("%.3f s: %s", seconds(self._session.stamp_ns), done)
        if entry.do in (*DRIVING, "reset", "end"):
            self._drive = entry if isinstance(entry, Drive) else None

    def _stop_unless_driven(self) -> None:
        if self._drive is not None and time.monotonic() - self._driven > HEARTBEAT_S:
            self._apply(Plain(do="stop"), log.warning)

    def _show_if_wanted(self) -> None:
        now = time.monotonic()
        if self._wanted.is_set() and now >= self._view_due:
            self._wanted.clear()
            self._view_due = max(self._view_due + FRAME_S, now)
            self._show(self._session.view(), self._pacer.pace(idle=self._session.idle))
