"""Marks for a student's file: every case played with it and, first, with the solution."""

from __future__ import annotations

from dataclasses import dataclass
from functools import partial
from importlib.resources import files
from pathlib import Path

from turtlebag.datasets.errors import InputError
from turtlebag.datasets.se2 import Array
from turtlebag.pipeline.course import particle_filter, scan_matching
from turtlebag.pipeline.course.lesson import FULL, PASSED, Case, Lesson, mark_of
from turtlebag.pipeline.course.process import FIRST_CPU_S, Ended, Fault, Pupil, cpu_limit

LESSONS = {one.LESSON.number: one.LESSON for one in (scan_matching, particle_filter)}


@dataclass(frozen=True, eq=False)
class Outcome:
    """What came of one case; without an `answer` there is no `error` either."""

    case: Case
    name: str
    points: int
    words: str
    error: float | None = None
    answer: Array | None = None


@dataclass(frozen=True, eq=False)
class Grade:
    """The mark of a file, of 100; `words` say in a line what is wrong, or that nothing is."""

    lesson: Lesson
    mark: int
    words: str
    outcomes: list[Outcome]
    printed: str = ""
    cpu_s: float = 0.0

    @property
    def passed(self) -> bool:
        """Whether the mark is enough."""
        return self.mark >= PASSED


def lesson_of(number: int) -> Lesson:
    """The lesson of that number; InputError for one that is not there."""
    if number not in LESSONS:
        raise InputError(
            f"--lesson {number}: no such lesson (there are {', '.join(map(str, sorted(LESSONS)))})"
        )
    return LESSONS[number]


def grade(source: Path, number: int, salt: str = "") -> Grade:
    """The mark of a file. InputError for a file or lesson that is not there.

    The solution comes first: it must have full marks, and its CPU time sets the limit.
    """
    lesson = lesson_of(number)
    if not source.is_file():
        raise InputError(f"{source}: no such file")
    cases = [(f"visible {k + 1}", case) for k, case in enumerate(lesson.visible())]
    cases += [(f"hidden {k + 1}", case) for k, case in enumerate(lesson.hidden(salt))]
    solution = marked(solution_of(number), lesson, cases, FIRST_CPU_S)
    if solution.mark < 100:
        raise RuntimeError(f"the solution of lesson {number} has mark {solution.mark}: {solution.words}")
    return marked(source, lesson, cases, cpu_limit(solution.cpu_s))


def solution_of(number: int) -> Path:
    """The file that solves a lesson."""
    return Path(str(files("turtlebag.pipeline.course.solutions") / f"lesson{number}.py"))


def marked(source: Path, lesson: Lesson, cases: list[tuple[str, Case]], limit_s: int) -> Grade:
    """The mark of a file in these cases; 0 for one that cannot be asked to the end."""
    outcomes: list[Outcome] = []
    ended = ""
    with Pupil(source, lesson.name, lesson.method, limit_s) as pupil:
        try:
            pupil.begin()
            for name, case in cases:
                outcomes.append(_outcome(pupil, lesson, name, case))
        except Ended as fault:
            ended = str(fault)
    if ended := ended or pupil.overflow:
        lost = [Outcome(case, name, 0, ended) for name, case in cases]
        return Grade(lesson, 0, ended, lost, pupil.printed, pupil.cpu_s)
    wrong = [one for one in outcomes if one.points < FULL]
    words = f"{wrong[0].name}: {wrong[0].words}" if wrong else "all cases are right"
    mark = mark_of([one.points for one in outcomes])
    return Grade(lesson, mark, words, outcomes, pupil.printed, pupil.cpu_s)


def _outcome(pupil: Pupil, lesson: Lesson, name: str, case: Case) -> Outcome:
    try:
        pupil.new(case.new)
        answer = lesson.play(case, partial(pupil.ask))
    except Ended:
        raise
    except Fault as fault:
        return Outcome(case, name, 0, str(fault))
    error = lesson.error(case, answer)
    points = lesson.points(error)
    return Outcome(
        case, name, points, "right" if points == FULL else lesson.words(case, answer), error, answer
    )
