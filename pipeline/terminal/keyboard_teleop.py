"""Keyboard teleop: keys to speeds, at the pace of a clock, and a line of what the robot does."""

from __future__ import annotations

import os
import select
import sys
import termios
import time
import tty
from collections.abc import Callable, Generator, Iterator
from contextlib import contextmanager, suppress
from typing import Literal

from turtlebag.datasets.types import Observation, Twist
from turtlebag.pipeline.terminal.keys import ARROWS, DOWN, LEFT, RIGHT, UP, Keys
from turtlebag.pipeline.terminal.messages import quiet
from turtlebag.sim.robots import Limits
from turtlebag.sim.simulator import CONTROL_HZ, Truth

STEP_V, STEP_W = 0.01, 0.1
RAMP = 0.5
"""TurtleBot3's own node moves its output to the target by this share of a key's step, ten times a second."""
STOPPING_STEPS = 30
VIEW_EVERY = 6

Style = Literal["keys", "turtlebot3"]

TABLES: dict[Style, str] = {
    "keys": (
        "  W forward, S back    0.01 m/s   X or space  stop\n"
        "  A left,    D right   0.1 rad/s  Q           end the recording\n"
        "  (arrow keys as W, S, A and D)"
    ),
    "turtlebot3": (
        "  w / x  linear  +/- 0.01 m/s     space or s  stop at once\n"
        "  a / d  angular +/- 0.1 rad/s    q           end the recording\n"
        "  (arrow keys as w, x, a and d; the speed follows by half a step, ten times a second)"
    ),
}


class KeyState:
    """Speeds that keys have asked for, within a robot's limits."""

    def __init__(self, limits: Limits, style: Style) -> None:
        self._limits, self._style = limits, style
        self._v = self._w = 0.0
        self._out_v = self._out_w = 0.0
        self.ended = False

    def press(self, key: str) -> None:
        """Take one key; unknown ones do nothing."""
        key = key.lower()
        back, stops = ("s", "x ") if self._style == "keys" else ("x", "s ")
        if key in ("q", "\x03", "\x04"):
            self.ended = True
        elif key in stops:
            self._v = self._w = self._out_v = self._out_w = 0.0
        else:
            v = {"w": STEP_V, UP: STEP_V, back: -STEP_V, DOWN: -STEP_V}.get(key, 0.0)
            w = {"a": STEP_W, LEFT: STEP_W, "d": -STEP_W, RIGHT: -STEP_W}.get(key, 0.0)
            # Whole steps, so that as many back lead to exactly zero.
            self._v = _clip(round((self._v + v) / STEP_V) * STEP_V if v else self._v, self._limits.max_v)
            self._w = _clip(round((self._w + w) / STEP_W) * STEP_W if w else self._w, self._limits.max_w)

    def tick(self) -> None:
        """A tenth of a second has passed: the TurtleBot3 style moves its output on."""
        self._out_v = _toward(self._out_v, self._v, RAMP * STEP_V)
        self._out_w = _toward(self._out_w, self._w, RAMP * STEP_W)

    @property
    def command(self) -> Twist:
        """What is sent to the robot now."""
        return Twist(self._v, self._w) if self._style == "keys" else Twist(self._out_v, self._out_w)


def _clip(value: float, limit: float) -> float:
    return max(-limit, min(limit, value))


def _toward(value: float, target: float, step: float) -> float:
    return max(min(target, value + step), value - step)


def keyboard_driver(
    state: KeyState, read_keys: Callable[[], str], wait: Callable[[float], None]
) -> Generator[Twist, Truth, None]:
    """A driver for record_drive: reads keys at each control step until the end key; then stops.

    `read_keys` returns the keys typed since the last call; `wait` gets the time of the step [s] and returns
    when it is due. The truth, which the driver is sent, is not used.
    """
    yield Twist()
    step = 0
    while not state.ended:
        wait(step / CONTROL_HZ)
        for key in read_keys():
            state.press(key)
        if step % (CONTROL_HZ // 10) == 0:
            state.tick()
        step += 1
        yield Twist() if state.ended else state.command
    for _ in range(STOPPING_STEPS):
        yield Twist()


class OverrideKeys:
    """Teleop overrides by keyboard (see `navigation.teleop_override`): any driving key begins one."""

    TABLE = TABLES["keys"].replace("end the recording", "hand back") + "\n  (every key but Q overrides)"

    def __init__(
        self,
        limits: Limits,
        read_keys: Callable[[], str],
        wait: Callable[[float], None],
        write: Callable[[str], None],
    ) -> None:
        self._limits, self._read_keys, self._wait, self._write = limits, read_keys, wait, write
        self._keys: KeyState | None = None
        self._step = 0

    def asked(self, stamp_ns: int) -> Twist | None:
        """What the keys ask for at this tick; None while navigation drives."""
        self._wait(self._step / CONTROL_HZ)
        for key in self._read_keys().lower():
            if key in "q\n\r\x04":
                self._keys = None
            elif key in "wasdx " + ARROWS:
                self._keys = self._keys or KeyState(self._limits, "keys")
                self._keys.press(key)
        wanted = None if self._keys is None else self._keys.command
        if self._step % VIEW_EVERY == 0:
            whose = "navigation" if wanted is None else f"teleop {wanted.v:+.2f} m/s {wanted.w:+.1f} rad/s"
            self._write(f"{stamp_ns * 1e-9:7.1f} s  cmd_vel: {whose}")
        self._step += 1
        return wanted


class StatusLine:
    """Writes the time, the command and where the robot is by odometry alone, a few times a second."""

    def __init__(self, state: KeyState, write: Callable[[str], None]) -> None:
        self._state, self._write = state, write
        self._count = 0

    def __call__(self, observation: Observation) -> None:
        """Take an observation."""
        if self._count % VIEW_EVERY == 0:
            wanted, odometry = self._state.command, observation.odometry
            x, y, _ = odometry.T_odom_base.xyt.tolist()
            self._write(
                f"{observation.stamp_ns * 1e-9:7.1f} s  command {wanted.v:+.2f} m/s {wanted.w:+.1f} rad/s  "
                f"at {x:+.2f}, {y:+.2f}  odometry {odometry.twist.v:+.2f} m/s {odometry.twist.w:+.2f} rad/s"
            )
        self._count += 1


@contextmanager
def keys_of(stream: int) -> Iterator[Callable[[], str]]:
    """A function that gives the keys typed on a terminal since its last call, without waiting for Enter.

    The terminal is as before afterwards, whatever happens. From a pipe or file it gives one key at
    each call. Where no more can come, it gives the end key.
    """
    keys = Keys()
    if not os.isatty(stream):
        yield lambda: _typed(stream, 1, keys)
        return
    before = termios.tcgetattr(stream)
    tty.setcbreak(stream)
    try:
        yield lambda: _typed(stream, 64, keys)
    finally:
        with suppress(termios.error):  # of a terminal that was closed
            termios.tcsetattr(stream, termios.TCSADRAIN, before)


def _typed(stream: int, most: int, keys: Keys) -> str:
    """The keys of up to `most` bytes that wait there; the end key where no more can come."""
    if not select.select([stream], [], [], 0.0)[0]:
        return ""
    try:
        typed = os.read(stream, most)
    except OSError:  # the terminal was closed
        typed = b""
    return keys.of(typed.decode(errors="ignore")) if typed else "q"


def clock(speed: float) -> Callable[[float], None]:
    """A function that waits until a time [s] since now, at `speed` times real time."""
    begun = time.monotonic()

    def wait(time_s: float) -> None:
        left = begun + time_s / speed - time.monotonic()
        if left > 0.0:
            time.sleep(left)

    return wait


def show(text: str) -> None:
    """Write to the terminal (stderr), at once; nothing when -q was given."""
    if not quiet():
        sys.stderr.write(text)
        sys.stderr.flush()
