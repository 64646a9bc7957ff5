"""Teleop override: cmd_vel has one owner at a time, and keyboard or script has priority over the task.

As with twist_mux, an override needs no permission, and the task keeps sensing and localising
meanwhile. As with Nav2's collision monitor behind the mux, commands are
still stopped short of what the lidar sees, unless that is switched off.
"""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import Annotated, Protocol

import yaml
from pydantic import Field, model_validator

from turtlebag.datasets.durations import LONGEST_S, nanoseconds
from turtlebag.datasets.errors import InputError
from turtlebag.datasets.settings import Settings
from turtlebag.datasets.types import Twist
from turtlebag.datasets.yaml_files import checked, read_yaml

Speed = Annotated[float, Field(ge=-100.0, le=100.0)]


class Interval(Settings, allow_inf_nan=False):
    """A teleop command from `begin` until just before `end` [s, m/s, rad/s]."""

    begin: float = Field(ge=0.0)
    end: float = Field(le=LONGEST_S)
    v: Speed = 0.0
    w: Speed = 0.0

    @model_validator(mode="after")
    def _lasts(self) -> Interval:
        if not self.end > self.begin:
            raise ValueError(f"an interval must end after it begins: {self.begin:g} to {self.end:g}")
        return self


class TeleopOverrideConfig(Settings, allow_inf_nan=False):
    """Teleop override."""

    monitor: bool = True
    """Whether the collision monitor also limits teleop commands; without it a person can push obstacles."""
    speed: float = Field(default=1.0, ge=0.01, le=100.0)
    """Simulation speed with a keyboard, relative to real time."""
    script: tuple[Interval, ...] = ()
    """Overrides by script; intervals without a gap between them count as one."""

    @model_validator(mode="after")
    def _in_order(self) -> TeleopOverrideConfig:
        for one, other in zip(self.script, self.script[1:], strict=False):
            if other.begin < one.end:
                raise ValueError(f"intervals overlap or are out of order at {other.begin:g} s")
        return self


class Source(Protocol):
    """The source of teleop commands."""

    def asked(self, stamp_ns: int) -> Twist | None:
        """The teleop command at this tick; None without an override."""
        ...


class Script:
    """Overrides by script. Stamps are compared in whole nanoseconds."""

    def __init__(self, script: tuple[Interval, ...]) -> None:
        self._spans = [(nanoseconds(i.begin), nanoseconds(i.end), Twist(i.v, i.w)) for i in script]

    def asked(self, stamp_ns: int) -> Twist | None:
        """The command of the interval that holds the stamp."""
        while self._spans and stamp_ns >= self._spans[0][1]:
            self._spans.pop(0)
        return self._spans[0][2] if self._spans and stamp_ns >= self._spans[0][0] else None


def load_script(path: Path) -> tuple[Interval, ...]:
    """The intervals of a file of overrides (a YAML list of them); InputError names what is wrong."""
    where = f"--teleop-override {path}"
    data = read_yaml(path, where=where)
    if not isinstance(data, list):
        raise InputError(f"{where}: expected a list of intervals with begin, end, v and w")
    return checked(TeleopOverrideConfig, {"script": data}, where=where).script


def script_text(script: Sequence[Interval]) -> str:
    """Intervals as the file of them."""
    return yaml.safe_dump([interval.model_dump() for interval in script], sort_keys=False)
