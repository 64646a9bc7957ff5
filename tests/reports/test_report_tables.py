"""Tables for papers, figures for papers, and the index over many outputs."""

import csv
import json
import re
import shutil
import subprocess

import pytest

from tests.helpers.report_fakes import fake_map, fake_record, fake_run, undrawn
from turtlebag.datasets.outputs import Output
from turtlebag.pipeline.cli.main import main
from turtlebag.pipeline.stages.report import make_index, make_report
from turtlebag.reports.index import COLUMNS, index_lines, shown_outputs, used_columns
from turtlebag.reports.kinds import stage_metrics
from turtlebag.reports.metric_specs import SPECS
from turtlebag.reports.numbers import shown
from turtlebag.reports.stages import load_stage
from turtlebag.reports.tables import latex, latex_table


@pytest.fixture(scope="module")
def base(tmp_path_factory):
    base = tmp_path_factory.mktemp("outputs")
    record = fake_record(base / "record")
    fake_map(base / "maps/good", record)
    fake_run(base / "runs/good", base / "maps/good")
    fake_run(base / "runs/missed", base / "maps/good", missed=True)
    return base


@pytest.fixture(scope="module")
def report(base, tmp_path_factory):
    out = tmp_path_factory.mktemp("report") / "out"
    make_report([base / "maps/good"], Output(out), animate=False, paper=True)
    return out


@pytest.mark.slow
def test_the_csv_holds_every_number_in_si_units(report):
    with (report / "tables/numbers.csv").open() as file:
        rows = {row["number"]: row for row in csv.DictReader(file)}
    metrics = json.loads((report / "metrics.json").read_text())["record"]["map"]
    assert float(rows["ate_m.rmse"]["value"]) == metrics["ate_m"]["rmse"]
    assert int(rows["loops.accepted"]["value"]) == 5


@pytest.mark.slow
def test_the_csv_holds_the_goals_and_says_the_unit_of_every_value(base, tmp_path):
    with undrawn():
        make_report([base / "runs/missed"], Output(tmp_path / "out"), animate=False)
    with (tmp_path / "out/tables/numbers.csv").open() as file:
        rows = {row["number"]: row for row in csv.DictReader(file)}
    goals = json.loads((base / "runs/missed/metrics.json").read_text())["goals"]
    assert float(rows["goals.1.error_m"]["value"]) == goals[1]["error_m"]
    assert (rows["goals.1.error_m"]["unit"], rows["goals.2.error_rad"]["unit"]) == ("m", "rad")
    assert rows["goals.1.time_s"]["meaning"].endswith("Goal 2, timeout.")
    assert (rows["min_clearance_m"]["unit"], rows["goals_reached"]["unit"]) == ("m", "1")


@pytest.mark.slow
def test_the_latex_table_has_a_row_for_each_number(report):
    (path,) = (report / "tables").glob("*.tex")
    assert len(table_rows(path.read_text())) == len(list(csv.reader((report / "tables/numbers.csv").open())))


# All that may stand in a cell besides letters, digits and plain punctuation.
MARKUP = re.compile(
    r"\{[\[*]\}|\\(?:[&%_#${},]|textasciitilde\{\}|textasciicircum\{\})|\$(?:-|<|>|\||\^\\circ|\^2|\\approx)\$|--"
)


def table_rows(text):
    """Cells of each row of a tabular; fails on anything LaTeX would trip over or misprint."""
    assert text.isascii()
    *lines, end = text.splitlines()
    columns = re.fullmatch(r"\\begin\{tabular\}\{([lr]+)\}", lines[0])[1]
    assert end == r"\end{tabular}"
    assert [lines[1], lines[3], lines[-1]] == [r"\toprule", r"\midrule", r"\bottomrule"]
    rows = []
    for line in (lines[2], *lines[4:-1]):
        assert line.endswith(r" \\")
        cells = line.removesuffix(r" \\").split(" & ")
        assert len(cells) == len(columns)
        for cell in cells:
            assert re.fullmatch(r"[A-Za-z0-9 .,:;()'/+=@!?\]-]*", MARKUP.sub("", cell)), cell
        rows.append(cells)
    return rows


@pytest.fixture(scope="module")
def tables(report, base, tmp_path_factory):
    """Every kind of table, every label, every unit, and texts that nobody foresaw."""
    out = tmp_path_factory.mktemp("tables")
    with undrawn():
        make_report([base / "runs/missed"], Output(out / "run"), animate=False)
    values = {"count": 3, "yes": True}
    for kind, specs in SPECS.items():
        rows = [(spec.label, shown(values.get(spec.unit, -0.123), spec.unit)) for spec in specs]
        (out / f"{kind}.tex").write_text(latex_table(("number", "value"), rows, "lr"))
    odd = "".join(map(chr, range(32, 127))).replace('"', "").replace("`", "")
    (out / "odd.tex").write_text(latex_table((r"\#", "odd"), [("1", odd), ("2", shown(None, "m"))], "rl"))
    return [*report.glob("tables/*.tex"), *out.rglob("*.tex")]


@pytest.mark.slow
def test_the_latex_tables_are_balanced_even_and_escaped(tables):
    assert len(tables) >= 9
    for path in tables:
        assert len(table_rows(path.read_text())) > 1
    for bad in (r"a & b & c \\", r"50% & 1 \\", r"a_b & 1 \\", r"3° & 1 \\", r"a & 1", r"$x$ & 1 \\"):
        with pytest.raises(AssertionError):
            table_rows(latex_table(("x", "y"), [("1", "2")], "lr").replace(r"1 & 2 \\", bad))


@pytest.mark.slow
@pytest.mark.skipif(shutil.which("pdflatex") is None, reason="needs pdflatex (texlive-latex-recommended)")
def test_latex_sets_the_tables(tables, tmp_path):
    inputs = "\\par\n".join(rf"\input{{{path}}}" for path in tables)
    (tmp_path / "all.tex").write_text(
        rf"\documentclass{{article}}\usepackage{{booktabs}}\begin{{document}}\tiny {inputs}\end{{document}}"
    )
    command = ["pdflatex", "-interaction=nonstopmode", "-halt-on-error", "all.tex"]
    done = subprocess.run(
        command, cwd=tmp_path, capture_output=True, text=True, errors="replace", check=False
    )
    assert done.returncode == 0, done.stdout[-1000:]
    assert "Missing character" not in (tmp_path / "all.log").read_text(errors="replace")
    assert (tmp_path / "all.pdf").read_bytes().startswith(b"%PDF")


def test_latex_is_escaped_and_has_symbols():
    assert latex("a_b & 5\u202f% \u22123°") == r"a\_b \& 5\,\% $-$3$^\circ$"
    assert latex_table(("x",), [("1",)], "r").splitlines()[0] == r"\begin{tabular}{r}"


@pytest.mark.slow
def test_paper_figures_are_pdf_and_svg_without_a_date(report):
    names = {path.suffix for path in (report / "figures").iterdir()}
    assert names == {".png", ".pdf", ".svg"}
    for path in (report / "figures").glob("*.pdf"):
        data = path.read_bytes()
        assert data.startswith(b"%PDF")
        assert b"CreationDate" not in data
    for path in (report / "figures").glob("*.svg"):
        assert "<svg" in path.read_text()


@pytest.mark.slow
def test_the_index_has_a_line_for_each_output(base):
    lines = index_lines(shown_outputs([base]))
    assert [line.stage for line in lines] == ["map", "record", "patrol", "patrol"]
    results = {line.name.partition("/")[2]: (line.mood, line.result) for line in lines}
    assert results["runs/good"] == ("good", "3 of 3 goals")
    assert results["runs/missed"] == ("bad", "2 of 3 goals, 1 collision")
    values = dict(zip([line.name for line in lines], [line.values[0] for line in lines], strict=True))
    assert any(text.endswith("cm") and float(value) < 0.02 for text, value in values.values() if text)


@pytest.mark.slow
def test_the_index_gives_a_map_the_world_and_robot_of_its_recording_and_hides_empty_columns(base):
    lines = index_lines(shown_outputs([base]))
    assert {(line.world, line.robot, line.seed) for line in lines if line.stage in ("map", "record")} == {
        ("room", "burger", "1")
    }
    heads = [head for _, head, _ in used_columns(lines)]
    assert "relations error" not in heads
    assert heads[:2] == ["trajectory error (ATE)", "wall cells within one cell"]
    (recorded,) = (line for line in lines if line.stage == "record")
    assert recorded.result == "150 scans"
    # The same number as in the recording's report: the bag's path, not the one from scan to scan.
    distance = stage_metrics(load_stage(base / "record"))["distance_m"]
    assert recorded.values[[head for head, *_ in COLUMNS].index("distance")] == (
        shown(distance, "m"),
        repr(distance),
    )


def test_the_same_output_below_two_roots_has_one_line(base):
    assert len(index_lines(shown_outputs([base, base / "runs"]))) == len(index_lines(shown_outputs([base])))


def test_the_index_is_a_sortable_page_without_machine_paths(base, tmp_path, capsys):
    page = make_index([base], Output(tmp_path / "out")).read_text()
    assert page.count("<tr>") == 5
    assert 'class="sortable"' in page
    assert str(base) not in page
    assert main(["report", "--index", str(base), "--out", str(tmp_path / "again")]) == 0
    assert capsys.readouterr().out.strip().endswith("index.html")
    assert main(["report", "--index", str(base / "gone"), "--out", str(tmp_path / "no")]) == 2
