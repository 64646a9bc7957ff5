"""Timing of a lidar's sweeps, which start and end independently of the control steps."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Any, Generic, Protocol, TypeVar

import numpy as np

from turtlebag.datasets.se2 import Array, wrapped
from turtlebag.sim.robots import CONTROL_HZ, stamp_of


@dataclass(frozen=True, eq=False, slots=True)
class Turn:
    """A whole turn: its stamp, what was measured, and where the base truly was at the stamp, (3,)."""

    stamp_ns: int
    measured: Any
    pose_at_stamp: Array


class Head(Protocol):
    """A lidar that turns."""

    def turn(self) -> tuple[float, float]:
        """Begin a turn: its share of the nominal time, and how late it is stamped [s]."""
        ...

    def measure(self, poses: Array, begin: float, end: float) -> Any:
        """What is seen in a turn between two rows of base poses (k, 3) at equal steps, with fractions."""
        ...


Lidar = TypeVar("Lidar", bound=Head)


class Sweep(Generic[Lidar]):
    """A lidar and its current turn. Collects the poses of the control steps and measures whenever a turn is
    complete. The first turn begins `later` steps after step `first`, each further one where the last one
    ended. A lidar that is not `turning` takes all its beams at once, at a fixed interval of steps."""

    def __init__(
        self, lidar: Lidar, steps: int, first: int = 0, *, turning: bool = True, later: int = 0
    ) -> None:
        self.lidar, self._steps, self._turning = lidar, steps, turning
        self._later, first = later, first + later
        self._poses: list[Array] = []
        self._first = first
        self._carried = False
        self._begin_turn(float(first))

    def steps_before(self, step: int) -> int:
        """How many whole control steps of the turn under way were over at this one."""
        return max(step - self._first, 0) if self._turning else 0

    def add(self, step: int, pose: Array) -> Turn | None:
        """The base pose (3,) in the world at a control step; the turn that is complete by then, if one is."""
        if not self._turning:
            if step < self._first or (step - self._later) % self._steps:
                return None
            measured = self.lidar.measure(pose[None], 0.0, 0.0)
            return Turn(stamp_of(step), measured, pose)
        if step < self._first:
            return None
        self._poses.append(pose)
        if step < self._end:
            return None
        rows = np.array(self._poses)
        begin, late = self._begin - self._first, self._delay_s * CONTROL_HZ
        turn = None
        # Measured even when there will be no scan, so that what is drawn does not depend on it.
        measured = self.lidar.measure(rows, begin, self._end - self._first)
        if not self._carried:
            turn = Turn(stamp_of(self._begin + late), measured, _between(rows, begin + late))
        self._carried = False
        self._begin_turn(self._end)
        first = math.floor(self._begin)
        self._poses = self._poses[first - self._first :]
        self._first = first
        return turn

    def put_down(self, pose: Array) -> None:
        """The robot was carried to this pose: of the turn under way there is no scan."""
        self._poses = [pose.copy() for _ in self._poses]
        self._carried = True

    def _begin_turn(self, begin: float) -> None:
        share, self._delay_s = self.lidar.turn()
        self._begin = begin
        # No more than one turn ends within a control step.
        self._end = begin + max(self._steps * share, 1.0)


def _between(rows: Array, place: float) -> Array:
    """The pose at a row with a fraction: straight in position and the shorter way in yaw."""
    low = min(int(place), len(rows) - 1)
    if place == low:
        return np.asarray(rows[low])
    high = min(low + 1, len(rows) - 1)
    step = rows[high] - rows[low]
    step[2] = wrapped(step[2])
    between = rows[low] + (place - low) * step
    between[2] = wrapped(between[2])
    return np.asarray(between)
