"""Stage `grade`: a student's file in, a mark and its page out."""

from __future__ import annotations

from typing import Any

from turtlebag.datasets.outputs import Output
from turtlebag.pipeline.course.grade import Grade, grade
from turtlebag.pipeline.course.page import grade_page
from turtlebag.pipeline.stages.requests.courses import GradeRequest
from turtlebag.pipeline.terminal.messages import say


def grade_file(request: GradeRequest, out: Output) -> int:
    """Write the page of a mark; 0 passed, 1 not. InputError for a file or lesson that is not there."""
    graded = grade(request.source, request.lesson, request.salt)
    with out.staged() as folder:
        (folder / "index.html").write_text(grade_page(graded, request.source.name, folder / "figures"))
        out.finish(folder, "grade", {"source": request.source}, metrics=metrics_of(graded))
    verdict = "passed" if graded.passed else "not passed"
    say(f"lesson {graded.lesson.number}: {graded.mark} of 100, {verdict}; {graded.words}")
    return 0 if graded.passed else 1


def metrics_of(graded: Grade) -> dict[str, Any]:
    """metrics.json: the mark, and of each case its points and words."""
    cases = {
        one.name: {"points": one.points, "error": one.error, "words": one.words} for one in graded.outcomes
    }
    lesson = graded.lesson.number
    return {
        "lesson": lesson,
        "mark": graded.mark,
        "passed": graded.passed,
        "words": graded.words,
        "cases": cases,
    }
