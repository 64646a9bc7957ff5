"""Faults on purpose: commands and scans that come late, scans that are lost, sensors that go silent."""

from __future__ import annotations

from collections import deque
from typing import Annotated, Any

import numpy as np
from pydantic import BaseModel, ConfigDict, Field, field_validator

from datasets.se2 import SE2
from datasets.types import Imu, Scan, Twist

NonNegative = Annotated[float, Field(ge=0.0, allow_inf_nan=False)]
Spans = tuple[tuple[NonNegative, NonNegative], ...]


class FaultConfig(BaseModel):
    """Delays and spans in seconds since the start. By default nothing goes wrong."""

    model_config = ConfigDict(extra="forbid", frozen=True)
    command_delay: NonNegative = 0.0
    """From a command to the motors hearing it."""
    scan_delay: NonNegative = 0.0
    """From the end of a sweep to its delivery; its stamp stays true."""
    scan_loss: Annotated[float, Field(ge=0.0, le=1.0)] = 0.0
    """Share of whole scans that never arrive."""
    scan_silent: Spans = ()
    """Spans in which no scan is taken."""
    imu_silent: Spans = ()

    @field_validator("scan_silent", "imu_silent")
    @classmethod
    def _in_order(cls, spans: Spans) -> Spans:
        if any(end < start for start, end in spans):
            raise ValueError("a span must end after it starts")
        return spans


class Faults:
    """Stands between the robot and whoever drives it."""

    def __init__(self, config: FaultConfig, rng: np.random.Generator, control_hz: int) -> None:
        self._config, self._rng = config, rng
        self._commands = deque([Twist()] * round(config.command_delay * control_hz))
        self._scan_steps = round(config.scan_delay * control_hz)
        self._scans: deque[tuple[int, Scan, SE2]] = deque()

    def command(self, twist: Twist) -> Twist:
        """The command that reaches the motors in this step."""
        self._commands.append(twist)
        return self._commands.popleft()

    def scan(self, step: int, scan: Scan | None, T_world_base: SE2) -> tuple[Scan | None, SE2]:
        """The scan that arrives in this step, if any, with the true pose at its stamp."""
        if scan is not None and not self._lost(scan):
            self._scans.append((step + self._scan_steps, scan, T_world_base))
        if self._scans and self._scans[0][0] <= step:
            _, arrived, pose = self._scans.popleft()
            return arrived, pose
        return None, T_world_base

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
