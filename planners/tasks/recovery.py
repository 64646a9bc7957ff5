"""Recovery behaviours: a limited sequence of small manoeuvres, after which the goal is given up."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass
from typing import Literal, Protocol

import numpy as np
from pydantic import Field

from turtlebag.datasets.durations import LONGEST_S, Seconds, nanoseconds
from turtlebag.datasets.se2 import SE2, wrapped
from turtlebag.datasets.settings import Settings
from turtlebag.datasets.types import Twist

Kind = Literal["wait", "clear", "back_up", "rotate"]


# A smaller move [m] or turn [rad] does not count; after driving this far on [m], the sequence starts over.
MOVED_M, MOVED_RAD, PROGRESS_M = 0.06, 0.25, 0.5
ROTATE_W = 0.6
"""Turning speed [rad/s]."""


class Rung(Settings, allow_inf_nan=False):
    """One manoeuvre: seconds to wait, metres to back up, radians to turn; nothing for `clear`."""

    kind: Kind
    amount: float = Field(default=0.0, ge=-LONGEST_S, le=LONGEST_S)


class RecoveryConfig(Settings, allow_inf_nan=False):
    """The sequence of recovery behaviours and its limits; seconds and metres."""

    ladder: tuple[Rung, ...] = (
        Rung(kind="wait", amount=2.0),
        Rung(kind="clear"),
        Rung(kind="back_up", amount=0.15),
        Rung(kind="wait", amount=4.0),
        Rung(kind="rotate", amount=1.6),
        Rung(kind="back_up", amount=0.3),
        Rung(kind="wait", amount=8.0),
        Rung(kind="rotate", amount=1.6),
        Rung(kind="wait", amount=15.0),
    )
    """What is tried, in this order, from the beginning again after progress."""
    total: int = Field(default=20, ge=0, le=10_000)
    """Recoveries per goal, after which it is given up."""
    stuck_time: Seconds = Field(default=5.0, gt=0.0)
    """Time without motion after which the robot counts as stuck."""
    back_up_v: float = Field(default=0.08, ge=1e-3)
    """Speed of backing up [m/s]."""


class Manoeuvre(Protocol):
    """A manoeuvre under way."""

    name: str

    def command(self, now_ns: int, pose: SE2) -> Twist | None:
        """The command now; None when it is over."""
        ...


@dataclass
class Wait:
    """Stand still until a time."""

    until_ns: int
    name: str = "recover_wait"

    def command(self, now_ns: int, pose: SE2) -> Twist | None:
        """Wait for a while."""
        return Twist() if now_ns < self.until_ns else None


@dataclass
class Move:
    """Back up a distance or turn an angle, or as much of it as is possible before a time."""

    start: SE2
    twist: Twist
    amount: float
    until_ns: int
    name: str
    turned: float = 0.0
    """Turn since the start [rad], also beyond a half turn."""

    def __post_init__(self) -> None:
        self._yaw = self.start.yaw

    def command(self, now_ns: int, pose: SE2) -> Twist | None:
        """A constant twist until the amount is done."""
        self.turned, self._yaw = self.turned + wrapped(float(pose.yaw - self._yaw)), pose.yaw
        driven = float(np.linalg.norm(pose.xy - self.start.xy))
        done = driven if self.twist.v != 0.0 else abs(self.turned)
        return self.twist if done < self.amount and now_ns < self.until_ns else None


class Ladder:
    """Chooses the next manoeuvre, and when to give up."""

    def __init__(self, config: RecoveryConfig, clear: Callable[[], None]) -> None:
        self.config = config
        self._clear = clear
        self._rung = 0
        self.used = 0

    def rest(self) -> None:
        """There is progress again: the next trouble starts with the first manoeuvre."""
        self._rung = 0

    @property
    def climbed(self) -> bool:
        """Whether there has been no progress since a manoeuvre."""
        return self._rung > 0

    def climb(
        self, now_ns: int, pose: SE2, room: Callable[[Twist, float], float] = lambda twist, amount: 0.0
    ) -> Manoeuvre | None:
        """The next manoeuvre; None if there is none left.

        `room` gives the clearance after a twist over an amount [m or rad], -inf if the robot may not move so.
        Of backing up and driving on, and of turning either way, it takes the one that ends with more
        clearance, the first of the two if equal, and waits a little if neither is possible.
        """
        if self._rung >= len(self.config.ladder) or self.used >= self.config.total:
            return None
        rung = self.config.ladder[self._rung]
        self._rung += 1
        self.used += 1
        if rung.kind == "wait":
            return Wait(now_ns + nanoseconds(rung.amount))
        if rung.kind == "clear":
            self._clear()
            return Wait(now_ns + 300_000_000, "recover_clear")
        return self._move(rung, now_ns, pose, room)

    def _move(self, rung: Rung, now_ns: int, pose: SE2, room: Callable[[Twist, float], float]) -> Manoeuvre:
        if rung.kind == "back_up":
            speed, amount = self.config.back_up_v, rung.amount
            ways = {"recover_back_up": Twist(-speed, 0.0), "recover_go_on": Twist(speed, 0.0)}
        else:
            speed, amount = ROTATE_W, rung.amount
            first = speed if self.used % 2 else -speed
            ways = {"recover_rotate": Twist(0.0, first), "recover_rotate_back": Twist(0.0, -first)}
        limit = now_ns + nanoseconds(amount / speed + 1.0)
        rooms = {name: room(twist, amount) for name, twist in ways.items()}
        best = max(rooms, key=lambda name: rooms[name])
        if rooms[best] == -math.inf:
            return Wait(now_ns + 2 * 10**9)
        return Move(pose, ways[best], amount, limit, best)


class ProgressWatch:
    """Detects that a robot has not moved or turned enough for some seconds; reports it once, and starts
    again."""

    def __init__(self, stuck_s: float, moved_m: float = MOVED_M, turned_rad: float = MOVED_RAD) -> None:
        self._stuck_s, self._moved_m, self._turned_rad = stuck_s, moved_m, turned_rad
        self._pose: SE2 | None = None
        self._since_ns = 0

    def reset(self) -> None:
        """Forget the past."""
        self._pose = None

    def stuck(self, now_ns: int, pose: SE2) -> bool:
        """Whether neither position nor heading changed enough for too long."""
        stuck = False
        if self._pose is not None:
            moved = math.dist(pose.xy, self._pose.xy) > self._moved_m
            turned = abs(wrapped(float(pose.yaw - self._pose.yaw))) > self._turned_rad
            stuck = not (moved or turned)
            if stuck and now_ns - self._since_ns <= nanoseconds(self._stuck_s):
                return False
        self._pose, self._since_ns = pose, now_ns
        return stuck
