"""Lesson 3: the pose graph, and the graphs of lesson 4."""

from __future__ import annotations

import dataclasses
from collections.abc import Sequence

import numpy as np
from matplotlib.axes import Axes

from turtlebag.datasets.se2 import SE2, Array, compose
from turtlebag.pipeline.course.lesson import Case, Lesson
from turtlebag.pipeline.course.process import Pupil
from turtlebag.pipeline.course.rooms import draw_map, drive
from turtlebag.pipeline.slam.graph.back_end import BackEnd
from turtlebag.pipeline.slam.graph.constraints import Constraint, Kind
from turtlebag.pipeline.slam.graph.cost import mahalanobis
from turtlebag.pipeline.slam.graph.pose_graph import Gtsam

GOOD, FAIR = 0.01, 0.1
KEYS, STEP_M, APART, DRIFT_M = 60, 0.2, 12, 0.25
NEAR_M, MOST_LOOPS, LEAST_LOOPS = 0.5, 12, 6
STEP_SIGMA = np.array([0.01, 0.005, 0.015])
LOOP_SIGMA = np.array([0.02, 0.02, 0.02])
"""Standard deviations of a constraint [m, m, rad]."""


def constraint(truth: SE2, i: int, j: int, kind: Kind, rng: np.random.Generator) -> Constraint:
    """A measurement of `T_i_j`, with noise. A step in four is four times as uncertain as the others."""
    sigma = LOOP_SIGMA if kind is Kind.LOOP else STEP_SIGMA * (4.0 if rng.random() < 0.25 else 1.0)
    T_i_j = (truth[i].inverse() @ truth[j]).xyt + sigma * rng.standard_normal(3)
    return Constraint(i, j, T_i_j, np.diag(1.0 / sigma**2), kind)


def chained(start: Array, steps: Sequence[Constraint]) -> SE2:
    """The poses (n,) by the steps alone."""
    poses = [start]
    for step in steps:
        poses.append(compose(poses[-1], step.T_i_j))
    return SE2(np.array(poses))


def graph(
    rng: np.random.Generator, keys: int, most: int, least_m: float
) -> tuple[SE2, SE2, list[Constraint], list[Constraint]]:
    """True poses, poses by the steps alone, steps and loops of a drive that comes back to places it knows.

    The steps alone end up `least_m` [m] off or more.
    """
    while True:
        truth = SE2(drive(rng, keys - 1, STEP_M))
        gap = np.hypot(*(truth.xy[:, None] - truth.xy).transpose(2, 0, 1))
        pairs = np.argwhere(np.triu(gap < NEAR_M, APART))
        if len(pairs) < LEAST_LOOPS:
            continue
        picked = pairs[np.sort(rng.permutation(len(pairs))[:most])]
        steps = [constraint(truth, k, k + 1, Kind.STEP, rng) for k in range(keys - 1)]
        start = chained(truth.xyt[0], steps)
        if np.hypot(*(start.xy - truth.xy).T).max() > least_m:
            return truth, start, steps, [constraint(truth, i, j, Kind.LOOP, rng) for i, j in picked.tolist()]


def make(rng: np.random.Generator) -> Case:
    """A graph of a drive; the truth is its optimum."""
    _, start, steps, loops = graph(rng, KEYS, MOST_LOOPS, DRIFT_M)
    constraints = [*steps, *loops]
    asked = {"T_map_keys": start, "constraints": constraints, "iterations": 30}
    return Case({}, (asked,), Gtsam().optimise(start, constraints).xyt)


def play(case: Case, pupil: Pupil) -> Array:
    """The poses (n, 3) of the student's back end."""
    pupil.new("BackEnd")
    return pupil.ask("optimise", case.truth.shape, **case.questions[0])


def error(case: Case, answer: Array) -> float:
    """Largest distance from the optimum [m]."""
    return float(np.hypot(*(answer - case.truth)[:, :2].T).max())


def words(case: Case, answer: Array) -> str:
    """Which mistake it looks like."""
    start, constraints = case.questions[0]["T_map_keys"], case.questions[0]["constraints"]
    if np.allclose(answer, start.xyt, atol=GOOD):
        return "the poses are still those of the start"
    if np.hypot(*(answer - start.xyt)[0, :2]) > GOOD:
        return "the first pose has moved; it must stay, or the whole graph can slide"
    alike = [dataclasses.replace(c, information=np.eye(3)) for c in constraints]
    if np.allclose(answer[:, :2], Gtsam().optimise(start, alike).xy, atol=GOOD):
        return "the information is not used: all constraints count the same"
    cost, least = (mahalanobis(SE2.from_array(poses), constraints).sum() for poses in (answer, case.truth))
    first = mahalanobis(start, constraints).sum()
    if cost > first:
        return f"the cost has grown from {first:.0f} to {cost:.0f}: is a sign or a Jacobian wrong?"
    return f"not at the minimum: the cost is {cost:.0f}, the least is {least:.0f}"


def draw(axes: Axes, case: Case, result: Array | None, colour: str) -> None:
    """The map, the poses and the loops between them."""
    draw_map(axes)
    if result is None:
        return
    for c in case.questions[0]["constraints"]:
        if c.kind is Kind.LOOP:
            axes.plot(*result[[c.i, c.j], :2].T, color="0.5", linewidth=0.8)
    axes.plot(*result[:, :2].T, ".-", markersize=3, color=colour, label="path")


LESSON = Lesson(
    3, "The pose graph", (BackEnd,), "m", GOOD, FAIR, make, play, error, words, draw,
    "the best fit",
)  # fmt: skip
