"""The notebooks of the course show what they end with, and begin from a class that is not yet a solution."""

import json
from pathlib import Path

import pytest

from turtlebag.pipeline.course.grade import LESSONS, lesson_of

FOLDER = Path(__file__).parents[2] / "docs/course"
NOTEBOOKS = {int(path.stem[0]): path for path in FOLDER.glob("*.ipynb")}


def code_of(number):
    cells = json.loads(NOTEBOOKS[number].read_text())["cells"]
    return [cell for cell in cells if cell["cell_type"] == "code"]


def test_each_lesson_has_its_notebook_and_its_row():
    assert set(NOTEBOOKS) == set(LESSONS)
    page = (FOLDER / "README.md").read_text()
    for number, path in NOTEBOOKS.items():
        classes = ", ".join(f"`{name}`" for name in lesson_of(number).wanted)
        assert f"| {number} | [{lesson_of(number).title}]({path.name}) | {classes}:" in page


@pytest.mark.parametrize("number", sorted(NOTEBOOKS))
def test_a_notebook_has_a_picture_first_and_no_errors(number):
    cells = code_of(number)
    assert [cell["execution_count"] for cell in cells] == [*range(1, len(cells) + 1)]
    assert any("image/png" in shown.get("data", ()) for shown in cells[0]["outputs"])
    assert all(shown["output_type"] != "error" for cell in cells for shown in cell["outputs"])
