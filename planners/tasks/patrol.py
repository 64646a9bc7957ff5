"""Patrols: goals one after another, with waits, timeouts, pauses and laps, and the outcome of each goal."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Literal

from pydantic import Field

from turtlebag.datasets.durations import Seconds, nanoseconds, seconds
from turtlebag.datasets.se2 import SE2
from turtlebag.datasets.settings import Settings
from turtlebag.planners.tasks.waypoints import Waypoint

Status = Literal["reached", "timeout", "unreachable", "rejected", "collided"]


class SequenceConfig(Settings, allow_inf_nan=False):
    """Simulated seconds; the defaults are the tutorial's patrol."""

    initial_wait: Seconds = 3.0
    """Before the first goal."""
    timeout: Seconds = Field(default=60.0, gt=0.0)
    """For each goal, from the moment it is set."""
    pause: Seconds = 1.0
    """After each reached goal without its own wait."""
    laps: int = Field(default=1, ge=1, le=1000)
    """How often the waypoints are visited."""
    closed: bool = False
    """Whether a lap returns to its first waypoint."""
    retry_missed: bool = False
    """Whether missed goals are tried once more after the last lap."""


@dataclass(frozen=True, eq=False)
class GoalOutcome:
    """The outcome of a goal; it was pursued from `started_ns` to `ended_ns`."""

    index: int
    waypoint: Waypoint
    status: Status
    reason: str
    started_ns: int
    ended_ns: int

    @property
    def time_s(self) -> float:
        """How long the goal was pursued [s]."""
        return seconds(self.ended_ns - self.started_ns)


class GoalSequence:
    """Decides which goal is pursued now. `update` is called once a tick."""

    def __init__(self, waypoints: Sequence[Waypoint], config: SequenceConfig) -> None:
        self.config = config
        self._lap, lap = tuple(waypoints), list(waypoints)
        if config.closed and len(lap) > 1:
            self._queue = [lap[0], *([*lap[1:], lap[0]] * config.laps)]
        else:
            self._queue = lap * config.laps
        self.index = -1
        self.outcomes: list[GoalOutcome] = []
        self._retried = False
        self._resume_ns: int | None = None
        self._started_ns = 0
        self._postponed_ns = 0
        self._active = False

    @property
    def finished(self) -> bool:
        """Whether every goal has its outcome."""
        return not self._active and self.index + 1 >= len(self._queue)

    @property
    def total(self) -> int:
        """The number of goals, including laps and second tries."""
        return len(self._queue)

    @property
    def lap(self) -> tuple[Waypoint, ...]:
        """The waypoints as they were given."""
        return self._lap

    @property
    def waypoint(self) -> Waypoint:
        """The entry of the goal that was set last."""
        return self._queue[self.index]

    @property
    def goal(self) -> SE2 | None:
        """The goal pursued now; None while waiting."""
        return self._queue[self.index].T_map_goal if self._active else None

    def update(self, now_ns: int, trouble: str = "") -> SE2 | None:
        """The goal to pursue at this instant; times out the active one, starts the next when due.

        `trouble` is added to the reason of a timeout.
        """
        if self._resume_ns is None:
            self._resume_ns = now_ns + nanoseconds(self.config.initial_wait)
        if self._active and now_ns - self._started_ns - self._postponed_ns >= nanoseconds(
            self.config.timeout
        ):
            late = f"not reached within {self.config.timeout:g} s"
            self.close("timeout", f"{late}: {trouble}" if trouble else late, now_ns)
        while (
            not self._active
            and now_ns >= self._resume_ns + self._postponed_ns
            and self.index + 1 < len(self._queue)
        ):
            self.index += 1
            self._started_ns, self._postponed_ns = now_ns, 0
            self._active = True
            waypoint = self._queue[self.index]
            if waypoint.T_map_goal is None:
                self.close("rejected", waypoint.reason, now_ns)
        return self.goal

    def postpone(self, span_ns: int) -> None:
        """The goal could not be pursued for a while: its time, or the wait before it, is extended."""
        if self._resume_ns is not None:
            self._postponed_ns += span_ns

    def close(self, status: Status, reason: str, now_ns: int) -> None:
        """Record the outcome of the active goal; a pause follows one that was reached."""
        waypoint = self._queue[self.index]
        self.outcomes.append(GoalOutcome(self.index, waypoint, status, reason, self._started_ns, now_ns))
        self._active, self._postponed_ns = False, 0
        pause = 0.0
        if status == "reached":
            pause = self.config.pause if waypoint.wait is None else waypoint.wait
        self._resume_ns = now_ns + nanoseconds(pause)
        last = self.index + 1 == len(self._queue)
        if last and self.config.retry_missed and not self._retried:
            self._retried = True
            self._queue += [o.waypoint for o in self.outcomes if o.status in ("timeout", "unreachable")]

    def close_all(self, status: Status, reason: str, now_ns: int) -> None:
        """End the current goal and all later ones with this status; bad entries stay `rejected`."""
        if self._active:
            self.close(status, reason, now_ns)
        while self.index + 1 < len(self._queue):
            self.index += 1
            waypoint = self._queue[self.index]
            bad = waypoint.T_map_goal is None
            self.outcomes.append(
                GoalOutcome(
                    self.index,
                    waypoint,
                    "rejected" if bad else status,
                    waypoint.reason or reason,
                    now_ns,
                    now_ns,
                )
            )
