"""Simulated time against wall-clock time: when the next tick is due, and the speed reached."""

from __future__ import annotations

import time
from collections import deque
from collections.abc import Callable
from dataclasses import dataclass

from turtlebag.datasets.durations import seconds
from turtlebag.pipeline.studio.inputs import Button, Speed

LATE_S = 0.25
"""A session that is farther behind its pace does not catch up."""
MEASURED_S, LEAST_S = 1.0, 0.1
"""The pace is measured over the last second, and at least over a tenth of one."""


@dataclass(frozen=True)
class Pace:
    """Simulated seconds per second: as measured, and as asked for (0: as fast as possible)."""

    factor: float
    asked: float
    paused: bool


class Pacer:
    """Says when the next tick is due; ticks are `period_s` of simulated time apart."""

    def __init__(self, period_s: float, clock: Callable[[], float] = time.monotonic) -> None:
        self._period_s, self._clock = period_s, clock
        self._asked, self._paused, self._single = 1.0, False, 0
        self._due = clock()
        self._ticks: deque[tuple[float, int]] = deque()

    def control(self, asked: Button | Speed) -> None:
        """Pause, resume, ask for a single tick, or change the speed."""
        if asked.do == "step":
            self._single += 1  # counts while paused only, and a pause begins with none
            return
        if isinstance(asked, Speed):
            self._asked = asked.factor
        else:
            self._paused, self._single = asked.do == "pause", 0
        self._due = self._clock()
        self._ticks.clear()

    def wait_s(self) -> float | None:
        """How long until the next tick is due; None while none will be."""
        if self._paused:
            return 0.0 if self._single else None
        return 0.0 if self._asked == 0.0 else max(self._due - self._clock(), 0.0)

    def take(self) -> bool:
        """Whether a tick is due; if so, it is taken as done, and the next one is due later."""
        if self.wait_s() != 0.0:
            return False
        if self._paused:
            self._single -= 1
        elif self._asked:
            self._due += self._period_s / self._asked
            now = self._clock()
            if now - self._due > LATE_S:
                self._due = now
        return True

    def count(self, stamp_ns: int) -> None:
        """A tick that led to this simulated time is over."""
        now = self._clock()
        self._ticks.append((now, stamp_ns))
        while now - self._ticks[0][0] > MEASURED_S and len(self._ticks) > 2:
            self._ticks.popleft()

    def pace(self, *, idle: bool) -> Pace:
        """The current pace; `idle` if time does not pass anyway."""
        factor = 0.0
        if not self._paused and not idle and len(self._ticks) > 1:
            (begun, first), (now, last) = self._ticks[0], self._ticks[-1]
            factor = seconds(last - first) / max(now - begun, LEAST_S)
        return Pace(round(factor, 2), self._asked, self._paused)
