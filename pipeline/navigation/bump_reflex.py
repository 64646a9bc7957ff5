"""Gets the robot off an obstacle that the lidar cannot see, once the memory of obstacles has noticed it."""

from __future__ import annotations

import math

from turtlebag.datasets.se2 import SE2
from turtlebag.datasets.types import Twist
from turtlebag.pipeline.navigation.obstacle_memory import ObstacleMemory
from turtlebag.pipeline.navigation.sensing import DeskewedScan
from turtlebag.planners.tasks.recovery import Move
from turtlebag.planners.tasks.sector_rule import SLOW_V, TURN_W

# Backing off from it: how far, for how long at most, and how long with turning away. With a second more than
# either takes for the times, the worst of 12 drives touches 31 times for 17.
BACK_OFF_M, BACK_OFF_NS, ESCAPE_NS = 0.25, 4 * 10**9, 10 * 10**9


class Escape:
    """Back off, then turn an angle [rad], or as much of both as a few seconds allow."""

    def __init__(self, now_ns: int, start: SE2, distance: float, angle: float) -> None:
        self._until_ns, self._angle = now_ns + ESCAPE_NS, angle
        back = Twist(math.copysign(SLOW_V, distance), 0.0)
        self._move = Move(start, back, abs(distance), now_ns + BACK_OFF_NS, "back off")

    def command(self, now_ns: int, T_odom_base: SE2) -> Twist | None:
        """The twist of this tick; None when it is over."""
        twist = self._move.command(now_ns, T_odom_base)
        if twist is None and self._move.twist.v:
            turn = Twist(0.0, math.copysign(TURN_W, self._angle))
            self._move = Move(T_odom_base, turn, abs(self._angle), self._until_ns, "turn away")
            twist = self._move.command(now_ns, T_odom_base)
        return twist


class BumpReflex:
    """Backs off from what stops the wheels."""

    def __init__(self, memory: ObstacleMemory) -> None:
        self.escape: Escape | None = None
        """The way out of where it is, while it is on it."""
        self._memory = memory

    def triggered(
        self, sweep: DeskewedScan, T_odom_base: SE2, last: Twist, turn: float, T_frame_odom: SE2
    ) -> bool:
        """Whether a new sweep shows a bump; an escape begins then: back, and away by `turn` [rad]."""
        if self.escape is not None or not self._memory.bumped(sweep, T_odom_base, last.v, T_frame_odom):
            return False
        back = BACK_OFF_M if last.v < 0.0 else -BACK_OFF_M
        self.escape = Escape(sweep.stamp_ns, T_odom_base, back, turn)
        return True

    def command(self, now_ns: int, T_odom_base: SE2) -> Twist | None:
        """The command of the escape; None when there is none, or when it is over."""
        command = None if self.escape is None else self.escape.command(now_ns, T_odom_base)
        if self.escape is not None and command is None:
            self.interrupt()
        return command

    def interrupt(self) -> None:
        """The escape is over, and wheels are watched anew; bumps are remembered."""
        self.escape = None
        self._memory.begin_again()
