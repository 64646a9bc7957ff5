"""Plays a recording as lines of text: clock, pose, speeds, command, nearest reading."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from turtlebag.datasets.bags.reader import read_commands
from turtlebag.datasets.errors import if_there
from turtlebag.datasets.recordings import load_recording
from turtlebag.datasets.se2 import SE2
from turtlebag.datasets.types import Trajectory
from turtlebag.pipeline.terminal.keyboard_teleop import clock

_SPEED_WINDOW_NS = 200_000_000


@dataclass(frozen=True, slots=True)
class Frame:
    """What is shown at one instant: seconds since the start, and a line of facts."""

    time_s: float
    status: str


class Player:
    """A recording that can be shown at any instant."""

    def __init__(self, path: Path) -> None:
        self.recording = recording = load_recording(path)
        self._commands = if_there(read_commands, path)
        # Logs with stamps that go back keep their file order: time is the latest stamp so far.
        self._times = np.maximum.accumulate(recording.stamps_ns)
        self._odometry = recording.odometry
        if recording.odometry is None and recording.T_odom_base is not None:
            stamps = np.unique(self._times)
            newest = np.searchsorted(self._times, stamps, side="right") - 1
            self._odometry = Trajectory(stamps, recording.T_odom_base[newest])
        self.start_ns, self.end_ns = int(self._times[0]), int(self._times[-1])

    def frame(self, stamp_ns: int) -> Frame:
        """What there is to say at a stamp."""
        index = max(int(np.searchsorted(self._times, stamp_ns, side="right")) - 1, 0)
        x, y, yaw = self._pose(stamp_ns).xyt.tolist()
        seconds = (stamp_ns - self.start_ns) * 1e-9
        facts = [f"{seconds:8.2f} s of {(self.end_ns - self.start_ns) * 1e-9:.2f}"]
        if self._odometry is not None:
            v, w = self._speed(stamp_ns)
            facts.append(f"odom x {x:+.2f} y {y:+.2f} yaw {math.degrees(yaw):+4.0f} deg")
            facts.append(f"v {v:+.2f} m/s w {w:+.2f} rad/s")
        scan = self.recording.scan(index)
        nearest = np.min(scan.ranges, initial=np.inf, where=np.isfinite(scan.ranges))
        facts += [*self._command(stamp_ns), f"nearest {nearest:.2f} m"]
        return Frame(seconds, "  ".join(facts))

    def _pose(self, stamp_ns: int) -> SE2:
        """By the odometry; the origin without any."""
        return SE2.identity() if self._odometry is None else self._odometry.at(np.array([stamp_ns]))[0]

    def _speed(self, stamp_ns: int) -> tuple[float, float]:
        """Forward and yaw speed by the odometry of the last moments."""
        step = self._pose(stamp_ns - _SPEED_WINDOW_NS).inverse() @ self._pose(stamp_ns)
        dx, _, turn = (step.xyt / (_SPEED_WINDOW_NS * 1e-9)).tolist()
        return dx, turn

    def _command(self, stamp_ns: int) -> list[str]:
        if self._commands is None:
            return []
        stamps, v, w = self._commands
        index = int(np.searchsorted(stamps, stamp_ns, side="right")) - 1
        return [f"cmd {v[index]:+.2f} {w[index]:+.2f}"] if index >= 0 else []


def frames(player: Player, *, rate: float, every_s: float) -> Iterator[Frame]:
    """Frames each `every_s` seconds of wall time at `rate` times the recorded speed, and the last one."""
    step = max(round(every_s * rate * 1e9), 1)
    for stamp in range(player.start_ns, player.end_ns, step):
        yield player.frame(stamp)
    yield player.frame(player.end_ns)


def play(player: Player, show: Callable[[Frame], None], *, rate: float, every_s: float) -> None:
    """Show the frames when they are due; late ones are not waited for."""
    wait = clock(rate)
    for frame in frames(player, rate=rate, every_s=every_s):
        wait(frame.time_s)
        show(frame)
