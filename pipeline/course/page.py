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
    lesson = graded.lesson
    hidden = [one for one in graded.outcomes if one.name.startswith("hidden")]
    for one in (graded.outcomes[0], min(hidden, key=lambda one: one.points)):
        caption = f"{one.points} of {FULL} points: {one.words}."
        album.add(one.name.replace(" ", "-"), one.name.capitalize(), caption, beside, lesson, one)
    return fill("grade.html.j2", graded=graded, source=source, full=FULL, pictures=album.pictures)


def beside(lesson: Lesson, outcome: Outcome) -> Figure:
    """Yours on the left, the truth on the right, to one scale."""
    figure = style.new_figure(3.3)
    yours, true = figure.subplots(1, 2, sharex=True, sharey=True)
    lesson.draw(yours, outcome.case, outcome.answer, style.series_colour(1))
    yours.set_title("yours" if outcome.answer is not None else "yours: no answer")
    lesson.draw(true, outcome.case, outcome.case.truth, style.series_colour(0))
    true.set_title("true")
    for axes in (yours, true):
        axes.set_aspect("equal")
        axes.set_xlabel("x [m]")
    yours.set_ylabel("y [m]")
    return figure
