"""Obstacle avoidance without a map: three sectors of the scan, three distance tiers (the tutorial's rule)."""

from __future__ import annotations

import math
import re
from collections.abc import Iterable
from dataclasses import dataclass
from functools import lru_cache
from typing import Literal

import numpy as np
from numpy.typing import NDArray

from turtlebag.datasets.se2 import wrap
from turtlebag.datasets.settings import Settings
from turtlebag.datasets.types import LidarSpec, Scan, Twist

# The tutorial's numbers: something nearer ahead stops or slows the robot; speeds [m/s, rad/s].
STOP_M, SLOW_M = 0.5, 1.0
CRUISE_V, SLOW_V, SLOW_W, TURN_W = 0.2, 0.1, 0.3, 0.5
# Sectors reach so far to both sides of left, front and right; nearer returns are none.
SECTOR_DEG, LEAST_RANGE_M = 30.0, 0.01


class AvoidConfig(Settings):
    """Obstacle avoidance."""

    mode: Literal["guarded", "tutorial"] = "guarded"
    """`tutorial` is the exact rule; `guarded` the same with the robot's footprint."""


@dataclass(frozen=True)
class Sectors:
    """Least valid range to the left, in front and to the right [m]; +inf where there is none."""

    left: float
    front: float
    right: float


def nearest(sectors: Iterable[Sectors]) -> Sectors:
    """What several lidars see together."""
    rows = [(one.left, one.front, one.right) for one in sectors]
    return Sectors(*(min(column) for column in zip(*rows, strict=True)))


@dataclass(frozen=True)
class Decision:
    """What to do, and in a word why."""

    action: str
    command: Twist


def read_sectors(scan: Scan, yaw: float = 0.0) -> Sectors:
    """Front -30..30 degrees (it straddles 0), left 60..120, right 240..300, ends included.

    `yaw` [rad] is the direction of the lidar's beam angle 0 on the robot. NaN, +inf and anything under 0.01 m
    (so -inf too) are ignored.
    """
    ranges = scan.ranges.astype(np.float64)
    ranges = np.where(np.isfinite(ranges) & (ranges >= LEAST_RANGE_M), ranges, np.inf)
    return Sectors(*(float(ranges[beams].min(initial=math.inf)) for beams in beams_of(scan.lidar, yaw)))


@lru_cache(maxsize=8)
def beams_of(lidar: LidarSpec, yaw: float) -> tuple[NDArray[np.int64], ...]:
    """The beams of the three sectors: left, front and right."""
    off = [np.abs(wrap(lidar.angles + yaw - centre)) for centre in (math.pi / 2.0, 0.0, -math.pi / 2.0)]
    return tuple(np.flatnonzero(np.round(np.degrees(one), 3) <= SECTOR_DEG) for one in off)


def tutorial_rule(sectors: Sectors) -> Decision:
    """Stop and turn, slow down and veer, or drive straight; a tie between the sides goes right."""
    side, sign = ("left", 1.0) if sectors.left > sectors.right else ("right", -1.0)
    if sectors.front < STOP_M:
        return Decision(f"stop, turn {side}", Twist(0.0, sign * TURN_W))
    if sectors.front <= SLOW_M:
        return Decision(f"slow, veer {side}", Twist(SLOW_V, sign * SLOW_W))
    return Decision("straight", Twist(CRUISE_V, 0.0))


@lru_cache(maxsize=64)
def in_words(state: str) -> str:
    """A state of the run log as people read it: `stop, turn left`."""
    return re.sub(r"^(stop|slow) ", r"\1, ", state.replace("_", " "))


def decision_line(t_s: float, sectors: Sectors, decision: Decision) -> str:
    """The line printed for a decision."""
    return (
        f"{t_s:8.1f} s  left {sectors.left:5.2f}  front {sectors.front:5.2f}  "
        f"right {sectors.right:5.2f}  {decision.action}"
    )
