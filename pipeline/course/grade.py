"""Marks for a student's file: each case is played with the solution first."""

from __future__ import annotations

from dataclasses import dataclass
from importlib import import_module
from importlib.resources import files
from pathlib import Path

from turtlebag.datasets.errors import InputError
from turtlebag.datasets.se2 import Array
from turtlebag.pipeline.course.lesson import FULL, HIDDEN, PASSED, Case, Lesson, mark_of
from turtlebag.pipeline.course.process import Ended, Fault, Pupil, cpu_limit

LESSONS = {
    1: "wheel_odometry",
    2: "scan_matching",
    3: "pose_graph",
    4: "loop_closures",
    5: "grids",
    6: "particle_filter",
    7: "patrol",
    8: "avoidance",
}
"""Numbers of the lessons, and the modules that have them as LESSON. Only some need Bullet."""


@dataclass(frozen=True, eq=False)
class Outcome:
    """What came of one case; without an `answer` there is no `error` either."""

    case: Case
    name: str
    points: int
    words: str
    error: float | None = None
    answer: Array | None = None

    @property
    def solved(self) -> bool:
        """Whether it has full points."""
        return self.points == FULL


@dataclass(frozen=True, eq=False)
class Grade:
    """The mark of a file, of 100; `words` say in a line what is wrong, or that nothing is."""

    lesson: Lesson
    mark: int
    words: str
    outcomes: list[Outcome]
    solution: list[Outcome]
    printed: str = ""
    cpu_s: float = 0.0

    @property
    def passed(self) -> bool:
        """Whether the mark is enough."""
        return self.mark >= PASSED


def lesson_of(number: int) -> Lesson:
    """The lesson of that number; InputError for one that is not there."""
    if number not in LESSONS:
        raise InputError(f"--lesson {number}: no such lesson (there are {', '.join(map(str, LESSONS))})")
    lesson: Lesson = import_module(f"turtlebag.pipeline.course.{LESSONS[number]}").LESSON
    return lesson


def grade(source: Path, number: int, salt: str = "") -> Grade:
    """The mark of a file. InputError for a file or lesson that is not there."""
    lesson = lesson_of(number)
    if not source.is_file():
        raise InputError(f"{source}: no such file")
    solution, limit_s = solved_cases(lesson, salt)
    return marked(source, lesson, solution, limit_s)


def solution_of(number: int) -> Path:
    """The file that solves a lesson."""
    return Path(str(files("turtlebag.pipeline.course.solutions") / f"lesson{number}.py"))


def solved_cases(lesson: Lesson, salt: str) -> tuple[list[Outcome], int]:
    """The cases of a mark, each solved by the solution, and ten times the CPU seconds that it took.

    A hidden case that the solution does not solve is not set: the next one takes its place. InputError where
    the solution cannot run at all, as where a package is missing.
    """
    with Pupil(solution_of(lesson.number), lesson.wanted) as pupil:
        try:
            pupil.begin()
            visible = [
                outcome_of(pupil, lesson, f"visible {k + 1}", c) for k, c in enumerate(lesson.visible())
            ]
            hidden: list[Outcome] = []
            for case in lesson.hidden(salt):
                one = outcome_of(pupil, lesson, f"hidden {len(hidden) + 1}", case)
                hidden += [one] * one.solved
                if len(hidden) == HIDDEN:
                    break
        except Ended as fault:
            raise InputError(f"lesson {lesson.number} cannot be marked here; its solution: {fault}") from None
    return [one for one in visible + hidden if one.solved], cpu_limit(pupil.cpu_s)


def marked(source: Path, lesson: Lesson, solution: list[Outcome], limit_s: int) -> Grade:
    """The mark of a file in the cases of the solution; 0 for one that cannot be asked to the end."""
    outcomes: list[Outcome] = []
    ended = ""
    with Pupil(source, lesson.wanted, limit_s) as pupil:
        try:
            pupil.begin()
            outcomes += (outcome_of(pupil, lesson, one.name, one.case) for one in solution)
        except Ended as fault:
            ended = str(fault)
    if ended := ended or pupil.overflow:
        lost = [Outcome(one.case, one.name, 0, ended) for one in solution]
        return Grade(lesson, 0, ended, lost, solution, pupil.printed, pupil.cpu_s)
    wrong = [one for one in outcomes if not one.solved]
    words = f"{wrong[0].name}: {wrong[0].words}" if wrong else "all cases are right"
    mark = mark_of([one.points for one in outcomes])
    return Grade(lesson, mark, words, outcomes, solution, pupil.printed, pupil.cpu_s)


def outcome_of(pupil: Pupil, lesson: Lesson, name: str, case: Case) -> Outcome:
    """Play one case. Ended when the process is gone."""
    try:
        answer = lesson.play(case, pupil)
    except Ended:
        raise
    except Fault as fault:
        return Outcome(case, name, 0, str(fault))
    error = lesson.error(case, answer)
    points = lesson.points(error)
    words = "right" if points == FULL else lesson.words(case, answer)
    return Outcome(case, name, points, words, error, answer)
