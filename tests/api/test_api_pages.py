"""The page on Python and the notebooks run as written, with shorter drives."""

import json
import re
import sys
import types
from pathlib import Path

import matplotlib
import pytest

matplotlib.use("agg")
import matplotlib.pyplot as plt

pytestmark = pytest.mark.slow

DOCS = Path(__file__).parents[2] / "docs"
NOTEBOOKS = sorted((DOCS / "notebooks").glob("*.ipynb"))
SHORT = """\
name: short
v: 0.2
w: 0.8
steps:
  - {drive: 0.4}
  - {turn_deg: 90}
  - {drive: 0.4}
"""
DRIVE = {'"tour"': '"short.yaml"'}
PATROL = {"tb.Patrol()": "tb.Patrol([(-1.7, -0.5, 0.0)])"}
STILL = {"tb.report(bag, m, run, ": "tb.report(bag, animate=False, "}
SHORTER = {
    "tour": DRIVE | PATROL | STILL,
    "front_end": DRIVE | {'["turtlebot3_world", "maze:7", "office:3"]': '["maze:7"]'},
}
"""What is put in the place of what takes long, by notebook."""


def shown():
    """What `pyplot.show` does here."""
    plt.gcf().canvas.draw()
    plt.close("all")


@pytest.fixture
def module(tmp_path, monkeypatch):
    """A module to run code in, from an empty folder, as a notebook's own."""
    monkeypatch.chdir(tmp_path)
    monkeypatch.setattr(plt, "show", shown)
    (tmp_path / "short.yaml").write_text(SHORT)
    made = types.ModuleType("notebook")
    monkeypatch.setitem(sys.modules, "notebook", made)
    return made


def run(blocks, module, where, shorter):
    """The blocks one after another, each thing in `shorter` replaced at least once."""
    text = "\n".join(blocks)
    for long in shorter:
        assert long in text, long
    for number, block in enumerate(blocks, start=1):
        for long, short in shorter.items():
            block = block.replace(long, short)
        exec(compile(block, f"{where}, block {number}", "exec"), module.__dict__)


def test_the_page_runs_as_written(module, tmp_path, capsys):
    blocks = re.findall(r"^```python\n(.*?)^```", (DOCS / "api.md").read_text(), re.M | re.S)
    assert len(blocks) > 6
    run(blocks, module, "api.md", DRIVE | PATROL | STILL)
    assert sorted(path.name for path in tmp_path.iterdir()) == ["map", "report", "short.yaml"]
    assert (tmp_path / "report" / "index.html").is_file()
    said = capsys.readouterr().out.replace("\u202f", " ")
    promised = re.findall(r"print\(.*\)  # (.*)", "\n".join(blocks))
    assert len(promised) > 2
    for line in promised:  # numbers are those of a longer drive
        pattern = re.escape(line).replace(re.escape("..."), ".*")
        assert re.search(re.sub(r"\d+(\\\.\d+)?", r"[\\d.]+", pattern), said), line
    assert module.run.success
    assert module.path.shape[1] == 3


@pytest.mark.parametrize("notebook", NOTEBOOKS, ids=lambda path: path.stem)
def test_the_notebooks_run_and_show_what_they_end_with(notebook, module):
    cells = [cell for cell in json.loads(notebook.read_text())["cells"] if cell["cell_type"] == "code"]
    blocks = ["".join(cell["source"]) for cell in cells]
    run(blocks, module, notebook.name, SHORTER[notebook.stem])
    for name in ("bag", "m", "run", "maps"):
        made = getattr(module, name, None)
        for result in made.values() if isinstance(made, dict) else [made] if made is not None else []:
            assert "<svg" in result._repr_html_()


@pytest.mark.parametrize("notebook", NOTEBOOKS, ids=lambda path: path.stem)
def test_the_notebooks_carry_what_they_show_and_say_how_long_they_take(notebook):
    text = json.loads(notebook.read_text())
    cells = [cell for cell in text["cells"] if cell["cell_type"] == "code"]
    assert [cell["execution_count"] for cell in cells] == [*range(1, len(cells) + 1)]
    for cell in cells:
        shows = cell["outputs"]
        assert all(show["output_type"] != "error" for show in shows)
        last = "".join(cell["source"]).splitlines()[-1]
        if last == "plt.show()" or re.fullmatch(r'[\w.]+(\[".*"\])?|tb\.report\(.*\)', last):
            assert any({"image/png", "text/html"} & set(show.get("data", ())) for show in shows), last
    assert re.search(r"takes about .* minute", "".join(text["cells"][0]["source"]))


def test_each_notebook_has_its_shorter_drives():
    assert {path.stem for path in NOTEBOOKS} == set(SHORTER)
