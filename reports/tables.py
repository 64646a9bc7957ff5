"""A report's numbers as files for papers and spreadsheets: CSV and LaTeX."""

from __future__ import annotations

import csv
from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import Any

from turtlebag.reports.content import Chapter, Part
from turtlebag.reports.metric_specs import GOAL_NUMBERS
from turtlebag.reports.numbers import UNITS
from turtlebag.reports.stage_titles import slug
from turtlebag.reports.system_comparison import SystemComparison

LATEX = {"&": r"\&", "%": r"\%", "_": r"\_", "#": r"\#", "$": r"\$", "{": r"\{", "}": r"\}"}
LATEX |= {"~": r"\textasciitilde{}", "^": r"\textasciicircum{}", "<": "$<$", ">": "$>$", "|": "$|$"}
# After a line's end LaTeX would take these for arguments of the end.
LATEX |= {"[": "{[}", "*": "{*}"}
SYMBOLS = {
    "\u202f": r"\,",
    "\u2212": r"$-$",
    "\u2013": "--",
    "°": r"$^\circ$",
    "²": "$^2$",
    "\u2248": r"$\approx$",
}


def write_tables(chapters: Sequence[Chapter], folder: Path) -> None:
    """`numbers.csv` with every number in SI units, and one `.tex` table for each stage and goal list."""
    folder.mkdir(parents=True, exist_ok=True)
    with (folder / "numbers.csv").open("w", newline="") as file:
        writer = csv.writer(file, lineterminator="\n")
        writer.writerow(["world", "stage", "number", "value", "unit", "shown", "meaning"])
        for chapter in chapters:
            for part in chapter.parts:
                writer.writerows([chapter.name, part.stage.label, *row] for row in _rows(part))
            if chapter.systems is not None:
                writer.writerows([chapter.name, "systems", *row] for row in _system_rows(chapter.systems))
    for chapter in chapters:
        _write_systems(chapter, folder)
        for part in chapter.parts:
            name = f"{slug(chapter.name)}-{slug(part.stage.label)}"
            rows = [(number.spec.label, number.text) for number in part.numbers]
            if rows:
                (folder / f"{name}.tex").write_text(latex_table(("number", "value"), rows, "lr"))
            if part.goals:
                head = ("\\#", "goal", "reported", "truth", *(spec.label for spec in GOAL_NUMBERS))
                goals = [
                    (
                        str(goal["number"]),
                        goal["pose"],
                        goal["status"],
                        goal["truth"],
                        *(text for _, _, text in goal["numbers"]),
                    )
                    for goal in part.goals
                ]
                (folder / f"{name}-goals.tex").write_text(latex_table(head, goals, "rlllrrr"))


def _write_systems(chapter: Chapter, folder: Path) -> None:
    """A table with a column for each system."""
    if chapter.systems is None:
        return
    found = [
        (row.spec.label, *(cell.text for cell in row.cells))
        for _, _, rows in chapter.systems.sections
        for row in rows
    ]
    head = ("number", *(latex(name) for name in chapter.systems.names))
    columns = "l" + "r" * len(chapter.systems.names)
    (folder / f"{slug(chapter.name)}-systems.tex").write_text(latex_table(head, found, columns))


def _system_rows(comparison: SystemComparison) -> Iterator[list[Any]]:
    """Path in the metrics, value, its unit, as shown and meaning of each number of each system."""
    for _, _, rows in comparison.sections:
        for row in rows:
            for cell in row.cells:
                if cell.value is not None:
                    path, unit = cell.key.partition(":")[2], UNITS[row.spec.unit].stored
                    yield [path, cell.value, unit, cell.text, row.spec.meaning]


def _rows(part: Part) -> Iterator[list[Any]]:
    """Path in the metrics, value, its unit, as shown and meaning of each number of a part, goals last."""
    for number in part.numbers:
        spec = number.spec
        yield [spec.path, number.value, UNITS[spec.unit].stored, number.text, spec.meaning]
    for goal in part.goals:
        place = goal["number"] - 1
        for spec, value, text in goal["numbers"]:
            meaning = f"{spec.meaning} Goal {goal['number']}, {goal['status']}."
            yield [f"goals.{place}.{spec.path}", value, UNITS[spec.unit].stored, text, meaning]


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
