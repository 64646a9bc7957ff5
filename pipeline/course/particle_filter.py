"""Lesson 6: the particle filter."""

from __future__ import annotations

import numpy as np
from matplotlib.axes import Axes
from scipy.ndimage import distance_transform_edt

from turtlebag.datasets.se2 import SE2, Array
from turtlebag.pipeline.course.contracts import ParticleFilter
from turtlebag.pipeline.course.lesson import Case, Lesson, once
from turtlebag.pipeline.course.rooms import CELL_M, draw_map, drive, noisy_steps, points, true_map

GOOD, FAIR = 0.08, 0.18
STEPS, LAST, EVERY = 30, 10, 6
"""Motions of a case, how many of the last are marked, and every how manieth beam is given."""


def make(rng: np.random.Generator) -> Case:
    """A drive with a start that is off."""
    path = drive(rng, STEPS)
    way, size = rng.uniform(-np.pi, np.pi), rng.uniform(0.22, 0.3)
    off = [size * np.cos(way), size * np.sin(way), rng.choice([-1.0, 1.0]) * rng.uniform(0.1, 0.2)]
    motions = noisy_steps(path, rng)
    grid = true_map()
    new = {
        "distance": np.round(distance_transform_edt(grid.cells != 100) * CELL_M, 3),
        "resolution": grid.resolution,
        "origin": grid.T_map_grid.xy,
        "start": path[0] + off,
        "seed": int(rng.integers(2**31)),
    }
    questions = tuple(
        {"motion": motion, "points": points(pose, rng)[::EVERY]}
        for motion, pose in zip(motions, path[1:], strict=True)
    )
    return Case(new, questions, path[1:])


def error(case: Case, answer: Array) -> float:
    """RMS distance over the last steps [m]."""
    return float(np.sqrt(np.mean(np.sum((answer - case.truth)[-LAST:, :2] ** 2, axis=1))))


def dead_reckoning(case: Case) -> Array:
    """Where the wheels alone say that it was, (steps, 3)."""
    pose, poses = SE2.from_array(case.new["start"]), []
    for asked in case.questions:
        pose = pose @ SE2.from_array(asked["motion"])
        poses.append(pose.xyt)
    return np.array(poses)


def words(case: Case, answer: Array) -> str:
    """Which mistake it looks like."""
    off = np.hypot(*(answer - case.truth)[:, :2].T)
    if np.allclose(answer, answer[0], atol=0.05):
        return "the estimate stands still: the particles are not moved by `motion`"
    if np.median(np.hypot(*(answer - dead_reckoning(case))[:, :2].T)) < 0.08:
        return "this follows the wheels alone: the scans do not change the weights, or nothing is resampled"
    if off[-LAST:].mean() > 1.5 * off[:LAST].mean():
        return f"the estimate diverges: {off[0]:.2f} m off at first, {off[-1]:.2f} m at the end"
    return f"{error(case, answer):.2f} m off over the last {LAST} steps"


def draw(axes: Axes, case: Case, result: Array | None, colour: str) -> None:
    """The map and the path."""
    draw_map(axes)
    if result is not None:
        axes.plot(*result[:, :2].T, ".-", markersize=3, color=colour, label="path")


LESSON = Lesson(
    6, "The particle filter", (ParticleFilter,), "m", GOOD, FAIR, make, once, error, words, draw,
)  # fmt: skip
