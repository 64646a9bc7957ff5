"""Lesson 4 solved: pairwise consistency (Mangelson 2018)."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from turtlebag.datasets.se2 import SE2, Array
from turtlebag.pipeline.slam.graph.constraints import Constraint

GATE = 16.3
"""Chi squared of three degrees of freedom, passed by 99.9 % of the right pairs."""


class LoopCheck:
    """Keeps the largest set of loops that all agree with each other."""

    def accept(
        self, T_map_keys: SE2, steps: Sequence[Constraint], loops: Sequence[Constraint]
    ) -> NDArray[np.bool_]:
        """Whether to accept each loop, (n_loops,)."""
        self.poses, self.steps = T_map_keys, steps
        n = len(loops)
        agree = np.array([[a is b or self.agree(a, b) for b in loops] for a in loops])
        best: list[int] = []
        for first in range(n):
            chosen, left = [first], agree[first].copy()
            left[first] = False
            while left.any():
                k = int(np.argmax(np.where(left, (agree & left).sum(axis=1), -1)))
                chosen.append(k)
                left &= agree[k]
                left[k] = False
            best = max(best, chosen, key=len)
        return np.isin(np.arange(n), best)

    def agree(self, a: Constraint, b: Constraint) -> bool:
        """Whether the way round both loops ends where it begins, as far as the steps in it are certain."""
        i, j = self.between(a.i, b.i), self.between(a.j, b.j)
        T_a, T_b = SE2.from_array(a.T_i_j), SE2.from_array(b.T_i_j)
        e = (T_b.inverse() @ i.inverse() @ T_a @ j).xyt
        by_steps = self.seen_from(T_b.inverse(), self.spread(a.i, b.i)) + self.spread(a.j, b.j)
        by_loops = np.linalg.inv(a.information) + np.linalg.inv(b.information)
        return bool(e @ np.linalg.solve(by_steps + by_loops, e) < GATE)

    def between(self, i: int, j: int) -> SE2:
        """`T_i_j` by the steps."""
        return self.poses[i].inverse() @ self.poses[j]

    def spread(self, i: int, j: int) -> Array:
        """Covariance (3, 3) of that, in the frame of j."""
        i, j = min(i, j), max(i, j)
        total = np.zeros((3, 3))
        for step in self.steps[i:j]:
            total += self.seen_from(self.between(j, step.j), np.linalg.inv(step.information))
        return total

    def seen_from(self, T_a_b: SE2, covariance_b: NDArray[np.floating]) -> Array:
        """A covariance in frame b as one in frame a."""
        x, y, yaw = T_a_b.xyt
        adjoint = np.array([[np.cos(yaw), -np.sin(yaw), y], [np.sin(yaw), np.cos(yaw), -x], [0.0, 0.0, 1.0]])
        return np.asarray(adjoint @ covariance_b @ adjoint.T)
