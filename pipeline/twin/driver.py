"""The drive of a bag once more: its commands, held on its path."""

from __future__ import annotations

import math
from collections.abc import Generator
from dataclasses import dataclass

import numpy as np

from turtlebag.datasets.durations import seconds
from turtlebag.datasets.se2 import SE2, Array, wrapped
from turtlebag.datasets.types import Stamps, Trajectory, Twist
from turtlebag.sim.simulator import Truth

# How fast the distance ahead [1/s], aside [1/m2] and in yaw [1/s] is made up for (Kanayama et al. 1990).
AHEAD, ASIDE, TURNED = 1.0, 6.0, 2.0
# Time over which the path says how fast it is driven [ns].
SPEED_NS = 400_000_000


@dataclass(frozen=True, eq=False)
class Drive:
    """A path in the world by its own stamps, and its commands: stamps (n,), v and w, if there are any."""

    path: Trajectory
    commands: tuple[Stamps, Array, Array] | None = None

    @staticmethod
    def of(path: Trajectory, commands: tuple[Stamps, Array, Array] | None) -> Drive:
        """Of a path whose stamps may go back, and commands by a clock of their own, which count if they fall
        into the drive."""
        order = np.argsort(path.stamps_ns, kind="stable")
        order = order[np.diff(path.stamps_ns[order], prepend=path.stamps_ns[order[0]] - 1) > 0]
        path = Trajectory(path.stamps_ns[order], path.poses[order])
        if commands is not None:
            stamps = commands[0]
            inside = (stamps >= path.stamps_ns[0]) & (stamps <= path.stamps_ns[-1])
            by_time = np.argsort(stamps, kind="stable")
            commands = (stamps[by_time], commands[1][by_time], commands[2][by_time]) if inside.any() else None
        return Drive(path, commands)

    def later(self, number: int) -> Drive:
        """The drive from one of its poses on."""
        return Drive(Trajectory(self.path.stamps_ns[number:], self.path.poses[number:]), self.commands)

    def driver(self) -> Generator[Twist, Truth, None]:
        """The driver of a simulator that starts at the first pose: yields commands, and is sent the truth."""
        start, end = int(self.path.stamps_ns[0]), int(self.path.stamps_ns[-1])
        begun = None
        truth = yield Twist()
        while True:
            begun = truth.stamp_ns if begun is None else begun
            now = start + truth.stamp_ns - begun
            if now > end:
                return
            truth = yield self._command(now, truth.T_world_base)

    def _command(self, now: int, T_world_base: SE2) -> Twist:
        """What was driven then, and what brings the robot back to where it was driven."""
        v, w = self._driven(now)
        x, y, yaw = (T_world_base.inverse() @ self.path.at(np.array([now]))[0]).xyt.tolist()
        yaw = wrapped(yaw)
        return Twist(v * math.cos(yaw) + AHEAD * x, w + TURNED * yaw + ASIDE * v * y)

    def _driven(self, now: int) -> tuple[float, float]:
        """Speeds then: as commanded, else as the path has them."""
        if self.commands is not None:
            stamps, v, w = self.commands
            last = int(np.searchsorted(stamps, now, side="right")) - 1
            return (float(v[last]), float(w[last])) if last >= 0 else (0.0, 0.0)
        ends = np.clip([now - SPEED_NS // 2, now + SPEED_NS // 2], *self.path.stamps_ns[[0, -1]])
        before, after = self.path.at(ends)[0], self.path.at(ends)[1]
        step, dt = (before.inverse() @ after).xyt, seconds(int(ends[1] - ends[0]))
        return (float(step[0]) / dt, float(step[2]) / dt) if dt > 0.0 else (0.0, 0.0)
