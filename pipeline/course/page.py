"""The page of a mark: the student's result beside the true one."""

from __future__ import annotations

from pathlib import Path

from matplotlib.figure import Figure

from turtlebag.pipeline.course.grade import Grade, Outcome
from turtlebag.pipeline.course.lesson import FULL, Lesson
from turtlebag.reports.figures import style
from turtlebag.reports.figures.album import Album
from turtlebag.reports.page import fill


def grade_page(graded: Grade, source: str, figures: Path) -> str:
    """The page as HTML text. Drawn are the first visible case and the worst hidden one."""
    album = Album(figures)
    pairs = list(zip(graded.outcomes, graded.solution, strict=True))
    hidden = [pair for pair in pairs if pair[0].name.startswith("hidden")] or pairs
    shown = {pair[0].name: pair for pair in (pairs[0], min(hidden, key=lambda pair: pair[0].points))}
    for one, solved in shown.values():
        caption = f"{one.points} of {FULL} points: {one.words}."
        name = one.name.replace(" ", "-")
        album.add(name, one.name.capitalize(), caption, beside, graded.lesson, one, solved)
    return fill("grade.html.j2", graded=graded, source=source, full=FULL, pictures=album.pictures)


def beside(lesson: Lesson, outcome: Outcome, solved: Outcome) -> Figure:
    """Yours on the left, the truth on the right, to one scale."""
    figure = style.new_figure(2.6)
    yours, other = figure.subplots(1, 2, sharex=True, sharey=True)
    lesson.draw(yours, outcome.case, outcome.answer, style.series_colour(1))
    yours.set_title("yours" if outcome.answer is not None else "yours: no answer")
    right = solved.answer if lesson.beside == "the solution" else outcome.case.truth
    lesson.draw(other, outcome.case, right, style.series_colour(0))
    other.set_title(lesson.beside)
    for axes in (yours, other):
        axes.set_aspect("equal")
        axes.set_xlabel("x [m]")
    yours.set_ylabel("y [m]")
    return figure
