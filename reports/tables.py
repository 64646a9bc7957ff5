"""A report's numbers as files for papers and spreadsheets: CSV and LaTeX."""

from __future__ import annotations

import csv
from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import Any

from turtlebag.reports.content import Chapter
from turtlebag.reports.metric_specs import GOAL_NUMBERS, MetricSpec
from turtlebag.reports.numbers import UNITS, shown
from turtlebag.reports.stage_titles import slug

LATEX = {"&": r"\&", "%": r"\%", "_": r"\_", "#": r"\#", "$": r"\$", "{": r"\{", "}": r"\}"}
LATEX |= {"~": r"\textasciitilde{}", "^": r"\textasciicircum{}", "<": "$<$", ">": "$>$", "|": "$|$"}
# After a line's end LaTeX would take these for arguments of the end.
LATEX |= {"[": "{[}", "*": "{*}"}
SYMBOLS = {"\u202f": r"\,", "\u2212": r"$-$", "\u2013": "--"}
SYMBOLS |= {"°": r"$^\circ$", "²": "$^2$"}


def write_tables(chapters: Sequence[Chapter], folder: Path) -> None:
    """`numbers.csv` with every number in SI units, and one `.tex` table for each stage, goal list and
    comparison of systems."""
    folder.mkdir(parents=True, exist_ok=True)
    with (folder / "numbers.csv").open("w", newline="") as file:
        writer = csv.writer(file, lineterminator="\n")
        writer.writerow(["world", "stage", "number", "value", "unit", "shown", "meaning"])
        for chapter in chapters:
            writer.writerows(_rows(chapter))
            for name, head, rows, columns in _tables(chapter):
                (folder / f"{slug(chapter.name)}-{name}.tex").write_text(latex_table(head, rows, columns))


def _rows(chapter: Chapter) -> Iterator[list[Any]]:
    """Every number of a world as a line of the file; in a stage its goals' last."""

    def row(stage: str, path: str, spec: MetricSpec, value: Any, more: str = "") -> list[Any]:
        unit = UNITS[spec.unit].stored
        return [chapter.name, stage, path, value, unit, shown(value, spec.unit), spec.meaning + more]

    for part in chapter.parts:
        label = part.stage.label
        for number in part.numbers:
            yield row(label, number.spec.path, number.spec, number.value)
        for goal in part.goals:
            place, more = goal["number"] - 1, f" Goal {goal['number']}, {goal['status']}."
            for spec, value, _ in goal["numbers"]:
                yield row(label, f"goals.{place}.{spec.path}", spec, value, more)
    if chapter.systems is not None:
        for line in chapter.systems.rows:
            for name, value in zip(chapter.systems.names, line.values, strict=True):
                if value is not None:
                    yield row("systems", f"systems.{name}.{line.spec.path}", line.spec, value)


def _tables(chapter: Chapter) -> Iterator[tuple[str, Sequence[str], list[Sequence[str]], str]]:
    """Name, head, rows and LaTeX's columns of each table of a world."""
    for part in chapter.parts:
        name, numbers = slug(part.stage.label), part.numbers
        if numbers:
            yield name, ("number", "value"), [(one.spec.label, one.text) for one in numbers], "lr"
        if part.goals:
            head = ("\\#", "goal", "reported", "truth", *(spec.label for spec in GOAL_NUMBERS))
            goals: list[Sequence[str]] = [
                [str(goal["number"]), goal["pose"], goal["status"], goal["truth"]]
                + [text for _, _, text in goal["numbers"]]
                for goal in part.goals
            ]
            yield f"{name}-goals", head, goals, "rlllrrr"
    if chapter.systems is not None:
        names = [latex(name) for name in chapter.systems.names]
        lines: list[Sequence[str]] = [(row.spec.label, *row.texts) for row in chapter.systems.rows]
        yield "systems", ["number", *names], lines, "l" + "r" * len(names)


def latex_table(head: Sequence[str], rows: Sequence[Sequence[str]], columns: str) -> str:
    """A booktabs tabular; cells are escaped, the head is taken as it is."""
    body = [" & ".join(latex(cell) for cell in row) + r" \\" for row in rows]
    lines = [rf"\begin{{tabular}}{{{columns}}}", r"\toprule", " & ".join(head) + r" \\", r"\midrule"]
    return "\n".join([*lines, *body, r"\bottomrule", r"\end{tabular}"]) + "\n"


def latex(text: str) -> str:
    """A text with LaTeX's special characters escaped."""
    escaped = "".join(LATEX.get(character, character) for character in text.replace("\\", "/"))
    for character, symbol in SYMBOLS.items():
        escaped = escaped.replace(character, symbol)
    return escaped
