"""Fault injection: delayed and lost commands and scans, silent sensors, slipping wheels, kidnapping."""

from __future__ import annotations

import itertools
from collections import deque
from collections.abc import Iterable
from typing import Annotated, Any

import numpy as np
from pydantic import Field, field_validator

from turtlebag.datasets.se2 import SE2
from turtlebag.datasets.settings import Finite, NonNegative, Settings
from turtlebag.datasets.types import Imu, Scan, Twist
from turtlebag.sim.robots import CONTROL_HZ

Spans = Annotated[
    tuple[tuple[NonNegative, NonNegative], ...], Field(max_length=1000, description="[start, end] for each")
]
Share = Annotated[float, Field(ge=0.0, le=0.95)]


class FaultConfig(Settings):
    """Delays, and spans in seconds since the start. No faults by default."""

    command_delay: Annotated[float, Field(ge=0.0, le=600.0)] = 0.0
    """From a command until it reaches the motors."""
    scan_delay: Annotated[float, Field(ge=0.0, le=600.0)] = 0.0
    """From the end of a sweep to its delivery; its stamp stays correct."""
    scan_loss: Annotated[float, Field(ge=0.0, le=1.0)] = 0.0
    """Share of whole scans that never arrive."""
    scan_silent: Spans = ()
    """Spans in which no scan is taken."""
    imu_silent: Spans = ()
    slip: Annotated[
        tuple[tuple[NonNegative, NonNegative, Share, Share], ...],
        Field(max_length=1000, description="[start, end, left share, right share] for each"),
    ] = ()
    """Start, end, and the shares of the left and right wheel's rotation lost to slip."""
    kidnap: Annotated[
        tuple[tuple[NonNegative, Finite, Finite, Finite], ...],
        Field(max_length=1000, description="[seconds, x, y, yaw] for each"),
    ] = ()
    """Time, and the true x, y, yaw where the robot is put down; the odometry does not notice."""

    @field_validator("scan_silent", "imu_silent", "slip")
    @classmethod
    def _in_order(cls, spans: tuple[tuple[float, ...], ...]) -> tuple[tuple[float, ...], ...]:
        if any(span[1] < span[0] for span in spans):
            raise ValueError("a span must end after it starts")
        return spans

    @field_validator("kidnap")
    @classmethod
    def _one_after_the_other(cls, kidnaps: tuple[tuple[float, ...], ...]) -> tuple[tuple[float, ...], ...]:
        if any(b[0] <= a[0] for a, b in itertools.pairwise(kidnaps)):
            raise ValueError("kidnaps must be in order of time")
        return kidnaps


class Faults:
    """Applies the faults between robot and driver, from control step `first` on."""

    def __init__(self, config: FaultConfig, rng: np.random.Generator, first: int = 0) -> None:
        self._config, self._rng = config, rng
        self._commands = deque([Twist()] * round(config.command_delay * CONTROL_HZ))
        self._scan_steps = round(config.scan_delay * CONTROL_HZ)
        self._scans: deque[tuple[int, Scan, SE2]] = deque()
        self._kidnaps = deque(kidnap for kidnap in config.kidnap if kidnap[0] * CONTROL_HZ >= first)
        self._angles: tuple[float, float] | None = None
        self._in_vain = [0.0, 0.0]

    def command(self, twist: Twist) -> Twist:
        """The command that reaches the motors in this step."""
        self._commands.append(twist)
        return self._commands.popleft()

    def kidnapped(self, step: int) -> SE2 | None:
        """Where the robot is put down in this step, if it is."""
        if not self._kidnaps or step < self._kidnaps[0][0] * CONTROL_HZ:
            return None
        _, x, y, yaw = self._kidnaps.popleft()
        return SE2.from_xyt(x, y, yaw)

    def grip(self, step: int, left: float, right: float) -> tuple[float, float]:
        """Wheel speeds [rad/s] as far as they move the robot."""
        shares = self._slip(step)
        return left * (1.0 - shares[0]), right * (1.0 - shares[1])

    def encoders(
        self, step: int, left: float, right: float, left_speed: float, right_speed: float
    ) -> tuple[float, float, float, float]:
        """Angles and speeds that the encoders see, from those that moved the robot."""
        if not self._config.slip:
            return left, right, left_speed, right_speed
        last = self._angles or (left, right)
        self._angles = (left, right)
        scale = [1.0 / (1.0 - share) for share in self._slip(step)]
        for wheel, (now, before) in enumerate(zip((left, right), last, strict=True)):
            self._in_vain[wheel] += (scale[wheel] - 1.0) * (now - before)
        a, b = self._in_vain
        return left + a, right + b, left_speed * scale[0], right_speed * scale[1]

    def _slip(self, step: int) -> tuple[float, float]:
        """Shares of each wheel's turning that move nothing in the control step that ends as `step`."""
        for start, end, left, right in self._config.slip:
            if start <= step / CONTROL_HZ < end:
                return left, right
        return 0.0, 0.0

    def scan(self, step: int, taken: Iterable[tuple[Scan, SE2]]) -> tuple[Scan, SE2] | None:
        """The scan that arrives in this step, if any, with the true pose at its stamp; `taken` are those that
        ended in it. One arrives at a time: that of another lidar comes with the next step."""
        for scan, T_world_base in taken:
            if not self._lost(scan):
                self._scans.append((step + self._scan_steps, scan, T_world_base))
        if self._scans and self._scans[0][0] <= step:
            _, arrived, pose = self._scans.popleft()
            return arrived, pose
        return None

    def imu(self, samples: tuple[Imu, ...]) -> tuple[Imu, ...]:
        """The samples that are not swallowed."""
        spans = self._config.imu_silent
        return tuple(s for s in samples if not _within(s.stamp_ns, spans)) if spans else samples

    def _lost(self, scan: Scan) -> bool:
        if self._config.scan_loss > 0.0 and self._rng.random() < self._config.scan_loss:
            return True
        return _within(scan.stamp_ns, self._config.scan_silent)


def _within(stamp_ns: int, spans: Any) -> bool:
    return any(start <= stamp_ns * 1e-9 < end for start, end in spans)
