"""Lesson 4: loops, and what goes wrong."""

from __future__ import annotations

import numpy as np
from matplotlib.axes import Axes
from numpy.typing import NDArray

from turtlebag.datasets.se2 import SE2, Array
from turtlebag.pipeline.course.contracts import LoopCheck
from turtlebag.pipeline.course.lesson import Case, Lesson, once
from turtlebag.pipeline.course.pose_graph import LOOP_SIGMA, graph
from turtlebag.pipeline.course.rooms import draw_map
from turtlebag.pipeline.slam.graph.constraints import Constraint, Kind
from turtlebag.pipeline.slam.graph.pose_graph import Gtsam

GOOD, FAIR = 0.1, 0.2
KEYS, DRIFT_M = 110, 0.7
ALIKE, SINGLE, TRUE = 3, 2, 10
"""Wrong loops that agree with each other, wrong ones that do not, and most right ones."""
PILLARS_M = 1.1
"""Distance of the pillars, by which places look alike."""


def make(rng: np.random.Generator) -> Case:
    """A drive with right and wrong loops, mixed; the truth is which are right."""
    truth, start, steps, right = graph(rng, KEYS, TRUE, DRIFT_M)
    shift = PILLARS_M * np.array([[1.0, 0.0], [-1.0, 0.0], [0.0, 1.0], [0.0, -1.0]])[rng.integers(4)]
    shifts = [shift] * ALIKE + [
        rng.uniform(0.6, 1.5) * np.array([np.cos(a), np.sin(a)]) for a in rng.uniform(-np.pi, np.pi, SINGLE)
    ]
    loops = [*right, *(wrong_loop(truth, right[int(rng.integers(len(right)))], xy, rng) for xy in shifts)]
    order = rng.permutation(len(loops))
    asked = {"T_map_keys": start, "steps": steps, "loops": [loops[k] for k in order]}
    return Case({}, (asked,), (order < len(right)).astype(float))


def wrong_loop(truth: SE2, right: Constraint, shift: Array, rng: np.random.Generator) -> Constraint:
    """Two keys beside those of a right loop, matched as if the second stood elsewhere."""
    i, j = (int(np.clip(k + rng.integers(-3, 4), 0, KEYS - 1)) for k in (right.i, right.j))
    elsewhere = SE2(truth.xyt[j] + [*shift, 0.0])
    T_i_j = (truth[i].inverse() @ elsewhere).xyt + LOOP_SIGMA * rng.standard_normal(3)
    return Constraint(i, j, T_i_j, np.diag(1.0 / LOOP_SIGMA**2), Kind.LOOP)


def solved(case: Case, accepted: Array) -> Array:
    """The path (n, 3) with these loops."""
    asked = case.questions[0]
    loops = [loop for loop, yes in zip(asked["loops"], accepted > 0.5, strict=True) if yes]
    return Gtsam().optimise(asked["T_map_keys"], [*asked["steps"], *loops]).xyt


def error(case: Case, answer: Array) -> float:
    """How far the loops accepted move the path from where the right ones put it, at most [m]."""
    return float(np.hypot(*(solved(case, answer) - solved(case, case.truth))[:, :2].T).max())


def words(case: Case, answer: Array) -> str:
    """How many of each kind are taken wrongly, and what that does."""
    accepted, right = answer > 0.5, case.truth > 0.5
    off = f"the path is {error(case, answer):.2f} m off"
    if not accepted.any():
        return f"no loop is accepted: the drift stays, {off}"
    if accepted.all():
        return f"all loops are accepted, also {(~right).sum()} of places that only look alike: {off}"
    said = []
    if wrong := first(accepted & ~right):
        k = case.questions[0]["loops"][wrong[0]]
        loops = "loops are" if len(wrong) > 1 else "loop is"
        said.append(f"{len(wrong)} wrong {loops} accepted, as that of keys {k.i} and {k.j}")
    if lost := first(right & ~accepted):
        said.append(f"{len(lost)} of {right.sum()} right loops are rejected")
    return f"{' and '.join(said)}: {off}"


def first(mask: NDArray[np.bool_]) -> list[int]:
    """Indices of what is true."""
    return [int(k) for k in np.flatnonzero(mask)]


def draw(axes: Axes, case: Case, result: Array | None, colour: str) -> None:
    """The map and the path with the loops that are accepted; wrong ones are red."""
    draw_map(axes)
    if result is None:
        return
    path = solved(case, result)
    for loop, yes, right in zip(case.questions[0]["loops"], result > 0.5, case.truth > 0.5, strict=True):
        if yes:
            axes.plot(*path[[loop.i, loop.j], :2].T, color="0.5" if right else "tab:red", linewidth=1.0)
    axes.plot(*path[:, :2].T, ".-", markersize=3, color=colour, label="path")


LESSON = Lesson(
    4, "Loops and what goes wrong", (LoopCheck,), "m", GOOD, FAIR, make, once, error, words, draw,
)  # fmt: skip
