"""What a lesson is: cases with a truth, an error in each, and words for what is wrong."""

from __future__ import annotations

import hashlib
from collections.abc import Callable, Iterator
from dataclasses import dataclass, field
from typing import Any, Literal

import numpy as np
from matplotlib.axes import Axes

from turtlebag.datasets.se2 import SE2, Array, wrap
from turtlebag.datasets.seeds import stream
from turtlebag.pipeline.course.process import Pupil

VISIBLE, HIDDEN = 2, 6
"""Cases of a lesson: those that everybody sees, and those of the teacher's salt."""
DRAWN = 12
"""Hidden cases are drawn until the solution solves enough of them, at most so many."""
FULL, HALF = 2, 1
STEP, PASSED = 10, 60
"""Marks come in steps of ten of a hundred."""


@dataclass(frozen=True, eq=False)
class Case:
    """A task: arguments of the class, the questions to ask it, and the truth, which stays here.

    In a lesson that drives, `truth` is what the drive must do, and `hidden` what it begins from.
    """

    new: dict[str, Any]
    questions: tuple[dict[str, Any], ...]
    truth: Array
    hidden: dict[str, Any] = field(default_factory=dict)


@dataclass(frozen=True)
class Lesson:
    """Classes to complete, and how they are marked.

    `make` a case of a random stream; `play` it by asking, which gives the result; `error` of a result
    [`unit`], full points up to `good`, half up to `fair`; `words` about a result that is not good; `draw` it.
    `beside` says what the result is shown with: the truth, or what the solution gives.
    """

    number: int
    title: str
    contracts: tuple[type, ...]
    unit: str
    good: float
    fair: float
    make: Callable[[np.random.Generator], Case]
    play: Callable[[Case, Pupil], Array]
    error: Callable[[Case, Array], float]
    words: Callable[[Case, Array], str]
    draw: Callable[[Axes, Case, Array | None, str], None]
    beside: Literal["true", "the best fit", "the solution"] = "true"

    @property
    def wanted(self) -> dict[str, list[str]]:
        """The classes that a file must have, and their methods."""
        return {
            one.__name__: [name for name in vars(one) if name[0] != "_" and callable(getattr(one, name))]
            for one in self.contracts
        }

    def visible(self) -> list[Case]:
        """The cases that everybody sees."""
        return [self.make(stream(k, f"lesson{self.number}-visible")) for k in range(VISIBLE)]

    def hidden(self, salt: str) -> Iterator[Case]:
        """The cases of a salt, one after another."""
        seed = int.from_bytes(hashlib.sha256(salt.encode()).digest()[:6])
        return (self.make(stream(seed + k, f"lesson{self.number}-hidden")) for k in range(DRAWN))

    def points(self, error: float) -> int:
        """Of an error: 2, 1 or 0."""
        return FULL if error <= self.good else HALF if error <= self.fair else 0


def mark_of(points: list[int]) -> int:
    """Of 100, in steps of ten, rounded down."""
    return STEP * (100 * sum(points) // (FULL * len(points)) // STEP)


def once(case: Case, pupil: Pupil) -> Array:
    """Make the object of a case and ask its questions: the answers, stacked, or the only one."""
    ((name, (method, *_)),) = pupil.wanted.items()
    pupil.new(name, **case.new)
    if len(case.questions) == 1:
        return pupil.ask(method, case.truth.shape, **case.questions[0])
    return np.stack([pupil.ask(method, case.truth.shape[1:], **asked) for asked in case.questions])


def pose_error(a: Array, b: Array) -> float:
    """Distance of two poses (3,), a radian counted as a metre."""
    return float(np.hypot(*(a[:2] - b[:2])) + np.abs(wrap(a[2] - b[2])))


def pose_words(answer: Array, truth: Array, near: float, guess: Array | None = None) -> str:
    """What was probably done: which usual mistake turns the truth into this answer."""
    T = SE2.from_array(truth)
    x, y, yaw = truth
    usual = {
        "this is the inverse: T_b_a in place of T_a_b": T.inverse().xyt,
        "the yaw has the wrong sign": np.array([x, y, -yaw]),
        "x and y are exchanged": np.array([y, x, yaw]),
    }
    if guess is not None:
        step = (SE2.from_array(guess).inverse() @ T).xyt
        usual = {
            "this is the guess, unchanged": guess,
            "the correction is not added to the guess": step,
        } | usual
    if (
        abs(yaw) > 1e-3
        and abs(answer[2] - np.degrees(yaw)) < 0.1 * abs(np.degrees(yaw))
        and abs(answer[2]) > 1.0
    ):
        return "the yaw is in degrees; it must be in radians"
    for words, wrong in usual.items():
        if pose_error(answer, wrong) <= near < pose_error(truth, wrong):
            return words
    off_xy, off_yaw = float(np.hypot(*(answer[:2] - truth[:2]))), float(abs(wrap(answer[2] - yaw)))
    if off_xy <= near < off_yaw:
        return f"the position is right, the yaw is off by {off_yaw:.2f} rad"
    if off_yaw <= near < off_xy:
        return f"the yaw is right, the position is off by {off_xy:.2f} m"
    return f"off by {off_xy:.2f} m and {off_yaw:.2f} rad"
