"""Lesson 2: scan matching."""

from __future__ import annotations

import numpy as np
from matplotlib.axes import Axes

from turtlebag.datasets.se2 import SE2, Array
from turtlebag.pipeline.course.contracts import ScanMatcher
from turtlebag.pipeline.course.lesson import Case, Lesson, once, pose_error, pose_words
from turtlebag.pipeline.course.rooms import free_pose, points, room_at

GOOD, FAIR = 0.04, 0.12


def make(rng: np.random.Generator) -> Case:
    """Two scans some 0.3 m apart, and a guess that is wrong by more than what counts as fair."""
    T_world_a = SE2.from_array(free_pose(rng))
    while True:
        turn = rng.choice([-1.0, 1.0]) * rng.uniform(0.2, 0.5)
        T_a_b = SE2.from_xyt(rng.uniform(0.1, 0.4), rng.uniform(-0.2, 0.2), turn)
        if room_at((T_world_a @ T_a_b).xy) > 0.25:
            break
    way, size = rng.uniform(-np.pi, np.pi), rng.uniform(0.12, 0.25)
    off = [size * np.cos(way), size * np.sin(way), rng.choice([-1.0, 1.0]) * rng.uniform(0.1, 0.2)]
    asked = {
        "points_a": points(T_world_a.xyt, rng),
        "points_b": points((T_world_a @ T_a_b).xyt, rng),
        "guess": T_a_b.xyt + off,
    }
    return Case({}, (asked,), T_a_b.xyt)


def words(case: Case, answer: Array) -> str:
    """Which mistake it looks like."""
    return pose_words(answer, case.truth, FAIR, case.questions[0]["guess"])


def draw(axes: Axes, case: Case, result: Array | None, colour: str) -> None:
    """Scan a, and scan b where the result puts it."""
    asked = case.questions[0]
    axes.plot(*asked["points_a"].T, ".", markersize=4, color="0.6", label="scan a")
    if result is not None:
        placed = SE2.from_array(result) @ asked["points_b"]
        axes.plot(*placed.T, ".", markersize=2, color=colour, label="scan b")


LESSON = Lesson(
    2, "Scan matching", (ScanMatcher,), "m + rad", GOOD, FAIR,
    make, once, lambda case, answer: pose_error(answer, case.truth), words, draw,
)  # fmt: skip
