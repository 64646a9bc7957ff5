"""Tables for papers, figures for papers, and the index over many outputs."""

import csv
import json

import pytest
from report_fakes import fake_map, fake_record, fake_run

from pipeline.cli import main
from pipeline.report import make_index, make_report
from reports.index import index_lines, used_columns
from reports.numbers import DISPLAY, SI
from reports.tables import latex, latex_table


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
    make_report([base / "maps/good"], out, animate=False, paper=True)
    return out


def test_the_csv_holds_every_number_in_si_units(report):
    with (report / "tables/numbers.csv").open() as file:
        rows = {row["number"]: row for row in csv.DictReader(file)}
    metrics = json.loads((report / "metrics.json").read_text())["record"]["map"]
    assert float(rows["ate_m.rmse"]["value"]) == metrics["ate_m"]["rmse"]
    assert int(rows["loops.accepted"]["value"]) == 5


def test_the_csv_holds_the_goals_and_says_the_unit_of_every_value(base, tmp_path):
    make_report([base / "runs/missed"], tmp_path / "out", animate=False)
    with (tmp_path / "out/tables/numbers.csv").open() as file:
        rows = {row["number"]: row for row in csv.DictReader(file)}
    goals = json.loads((base / "runs/missed/metrics.json").read_text())["goals"]
    assert float(rows["goals.1.error_m"]["value"]) == goals[1]["error_m"]
    assert (rows["goals.1.error_m"]["unit"], rows["goals.2.error_rad"]["unit"]) == ("m", "rad")
    assert rows["goals.1.time_s"]["meaning"].endswith("Goal 2, timeout.")
    assert (rows["min_clearance_m"]["unit"], rows["goals_reached"]["unit"]) == ("m", "1")
    assert set(SI) == set(DISPLAY)


def test_the_latex_table_has_a_row_for_each_number(report):
    (path,) = (report / "tables").glob("*.tex")
    text = path.read_text()
    assert text.count(r"\\") == 1 + len(list(csv.reader((report / "tables/numbers.csv").open()))) - 1
    assert r"\%" in text
    assert "%" not in text.replace(r"\%", "")


def test_latex_is_escaped_and_has_symbols():
    assert latex("a_b & 5\u202f% \u22123°") == r"a\_b \& 5\,\% $-$3$^\circ$"
    assert latex_table(("x",), [("1",)], "r").splitlines()[0] == r"\begin{tabular}{r}"


def test_paper_figures_are_pdf_and_svg_without_a_date(report):
    names = {path.suffix for path in (report / "figures").iterdir()}
    assert names == {".png", ".pdf", ".svg"}
    for path in (report / "figures").glob("*.pdf"):
        data = path.read_bytes()
        assert data.startswith(b"%PDF")
        assert b"CreationDate" not in data
    for path in (report / "figures").glob("*.svg"):
        assert "<svg" in path.read_text()


def test_the_index_has_a_line_for_each_output(base):
    lines = index_lines([base])
    assert [line.stage for line in lines] == ["map", "record", "patrol", "patrol"]
    results = {line.name.partition("/")[2]: (line.mood, line.result) for line in lines}
    assert results["runs/good"] == ("good", "3 of 3 goals")
    assert results["runs/missed"] == ("bad", "2 of 3 goals, 1 collision")
    values = dict(zip([line.name for line in lines], [line.values[0] for line in lines], strict=True))
    assert any(text.endswith("cm") and float(value) < 0.02 for text, value in values.values() if text)


def test_the_index_gives_a_map_the_world_and_robot_of_its_recording_and_hides_empty_columns(base):
    lines = index_lines([base])
    assert {(line.world, line.robot, line.seed) for line in lines if line.stage in ("map", "record")} == {
        ("room", "burger", "1")
    }
    heads = [head for _, head, _ in used_columns(lines)]
    assert "relations error" not in heads
    assert heads[:2] == ["trajectory error (ATE)", "wall cells within one cell"]
    assert [line.result for line in lines if line.stage == "record"] == ["150 scans"]


def test_the_same_output_below_two_roots_has_one_line(base):
    assert len(index_lines([base, base / "runs"])) == len(index_lines([base]))


def test_the_index_is_a_sortable_page_without_machine_paths(base, tmp_path, capsys):
    page = make_index([base], tmp_path / "out").read_text()
    assert page.count("<tr>") == 5
    assert 'class="sortable"' in page
    assert str(base) not in page
    assert main(["report", "--index", str(base), "--out", str(tmp_path / "again")]) == 0
    assert capsys.readouterr().out.strip().endswith("index.html")
    assert main(["report", "--index", str(base / "gone"), "--out", str(tmp_path / "no")]) == 2
