"""Loop closure while the robot drives: one alignment at a time, with iSAM2 as back end."""

from __future__ import annotations

from collections import deque
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from turtlebag.datasets.se2 import SE2, Array, compose
from turtlebag.pipeline.slam.graph.constraints import Constraint, Loop
from turtlebag.pipeline.slam.graph.drift import read_at, sigma_m
from turtlebag.pipeline.slam.graph.isam2 import GrowingGraph, without
from turtlebag.pipeline.slam.loops.by_distance import LoopClosing, LoopConfig, LoopFinder, step_lengths
from turtlebag.pipeline.slam.scans.clouds import Clouds, KeyScans

# At most this many keys wait for their loops; each takes up to five scans, by which the graph lags behind.
WAITING = 8


class GrowingLoops(LoopFinder):
    """`LoopFinder` of key scans that come one by one; `poses` (n, 3) are those of all of them."""

    def __init__(self, clouds: Clouds, pose: Array, config: LoopConfig) -> None:
        first = np.zeros(1, np.int64)
        super().__init__(KeyScans(clouds, first), SE2(pose[None]), [], LoopClosing(config), first)
        self.sigma_m: float | None = None
        """Standard deviation of the newest key searched, as seen from the first one [m]."""
        self._graph = GrowingGraph()
        self._since_query = 0
        self.waiting: deque[int] = deque()
        """Keys that wait for their loops, in order."""
        self._candidates: deque[tuple[int, float, float]] | None = None
        self.found: Loop | None = None
        """The loop to be closed next."""

    def add_key(self, scans: KeyScans, T_last_key: Array, steps: list[Constraint]) -> None:
        """Append a key, seen from the last one (3,), and the constraint between the two, as if they were keys
        0 and 1; `scans` are those of all keys."""
        n = len(self.poses)
        steps = [replace(c, i=n - 1, j=n) for c in steps]
        self.scans, self.part = scans, np.zeros(len(scans.keys), dtype=np.int64)
        self.poses = np.vstack([self.poses, compose(self.poses[-1], T_last_key)])
        self.path = np.append(self.path, self.path[-1] + step_lengths(self.poses[-2:]))
        self.steps += steps
        self._since_query += 1
        if self.config.enabled and self._since_query >= self.config.every and len(self.waiting) < WAITING:
            self._since_query = 0
            self.waiting.append(n)

    def work(self) -> bool:
        """Do one of these: search the places where the first waiting key may have been before, align it with
        one of them, or close the loop found. Returns whether the poses moved."""
        if self.found is not None:
            self._close(self.found)
            return True
        if not self.waiting:
            return False
        i = self.waiting[0]
        if self._candidates is None:
            self._judge_drift()
            self.sigma_m = self._sigma(i)
            self._candidates = deque(self.candidates(i))
        elif self._candidates:
            loop = self._match(i, *self._candidates.popleft())
            if loop.accepted:
                self.found = loop
                self._candidates.clear()
        if not self._candidates:
            self.waiting.popleft()
            self._candidates = None
        return False

    def needed(self) -> NDArray[np.bool_]:
        """Which keys (n,) must stay: the first, and those that wait for their loops."""
        needed = np.zeros(len(self.poses), dtype=bool)
        needed[[0, *self.waiting]] = True
        if self.found is not None:
            needed[[self.found.i, self.found.j]] = True
        return needed

    def _sigma(self, i: int) -> float:
        return float(sigma_m(read_at(self.ways(0, np.array([i]))[0], self.poses[i])))

    def _close(self, loop: Loop) -> None:
        constraint = self.config.constraint(loop)
        self.loops.append(constraint)
        new = [c for c in self.steps if c.j >= len(self._graph)]
        self.poses = self._graph.update(self.poses, [*new, constraint])
        self.found = None

    def keep(self, stays: NDArray[np.bool_], scans: KeyScans) -> None:
        """Keep only these keys (n,), among them those `needed`; constraints on the others move to their
        neighbours. `scans` are those of the keys that stay."""
        number = np.cumsum(stays) - 1
        self.steps = without(self.steps, stays, self.poses)
        self.loops = without(self.loops, stays, self.poses)
        self.scans, self.part = scans, self.part[stays]
        self.poses, self.path = self.poses[stays], self.path[stays]
        self.waiting = deque(int(number[i]) for i in self.waiting)
        self._candidates = None
        if self.found is not None:
            self.found = replace(self.found, i=int(number[self.found.i]), j=int(number[self.found.j]))
        self._graph = GrowingGraph()
        self.poses = self._graph.update(self.poses, [*self.steps, *self.loops])
