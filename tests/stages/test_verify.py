"""Verification finds every wrong number in a report, and nothing in a correct one."""

import json
import re
import shutil
from dataclasses import replace

import numpy as np
import pytest

from tests.helpers.report_fakes import fake_map, fake_record, fake_run, rehash, undrawn
from turtlebag.datasets.errors import InputError
from turtlebag.datasets.outputs import Output
from turtlebag.datasets.runlog import RunLog
from turtlebag.pipeline.cli.main import main
from turtlebag.pipeline.stages.recompute import same
from turtlebag.pipeline.stages.report import make_report
from turtlebag.pipeline.stages.verify import verify
from turtlebag.reports.g2o import read_g2o, read_loops


@pytest.fixture(scope="module")
def original(tmp_path_factory):
    base = tmp_path_factory.mktemp("verify")
    record = fake_record(base / "record")
    stages = [record, fake_map(base / "map", record), fake_run(base / "run", base / "map", missed=True)]
    with undrawn():
        make_report(stages, Output(base / "report"), animate=False)
    return base


def test_a_persons_file_in_the_folder_of_a_stage_is_named_once_it_changes(tmp_path):
    fake_map(tmp_path / "map", fake_record(tmp_path / "record"))
    note = tmp_path / "map/note.txt"
    note.write_text("the door was open\n")
    with undrawn():
        make_report([tmp_path / "record", tmp_path / "map"], Output(tmp_path / "report"), animate=False)
    assert verify(tmp_path / "report").problems == []
    note.write_text("it was shut\n")
    assert verify(tmp_path / "report").problems == ["room/map/note.txt: changed since the report was made"]


@pytest.fixture
def tree(original, tmp_path):
    shutil.copytree(original, tmp_path / "tree")
    # The copy must be found beside the report, not where it was made.
    manifest = tmp_path / "tree/report/manifest.json"
    manifest.write_text(manifest.read_text().replace(f'"path": "{original}', '"path": "/nowhere'))
    return tmp_path / "tree"


def edit_metrics(folder, change):
    path = folder / "metrics.json"
    metrics = json.loads(path.read_text())
    change(metrics)
    path.write_text(json.dumps(metrics, indent=2) + "\n")
    rehash(folder, "metrics.json")


def page_numbers(page):
    """(key, stored value, shown text) of each number on a page."""
    return re.findall(r'data-key="([^"]*)" data-value="([^"]*)">([^<]*)<', page.read_text())


@pytest.mark.slow
def test_an_honest_report_verifies(tree):
    found = verify(tree / "report", main)
    assert found.problems == []
    assert len(found.checks) > 40
    assert all(check.agrees for check in found.checks)
    assert "room/map:curious.value" in found.unchecked


@pytest.mark.slow
def test_every_number_on_the_page_has_a_key_that_is_checked_or_told(tree):
    found = verify(tree / "report", main)
    known = {check.key for check in found.checks} | set(found.unchecked)
    keys = [key for key, _, _ in page_numbers(tree / "report/index.html")]
    assert len(keys) > 30
    assert set(keys) <= known


LIES = [
    ("map", "room/map:ate_m.rmse", lambda m: m["ate_m"].update(rmse=0.001)),
    ("map", "room/map:ate_aligned_m.rmse", lambda m: m["ate_aligned_m"].update(rmse=0.0001)),
    ("map", "room/map:map.iou", lambda m: m["map"].update(iou=0.99)),
    ("run", "room/patrol:collisions.visible", lambda m: m["collisions"].update(visible=0)),
    ("run", "room/patrol:goals.2.error_m", lambda m: m["goals"][2].update(error_m=0.01)),
    ("run", "room/patrol:goals.1.x", lambda m: m["goals"][1].update(x=0.5)),
    ("run", "room/patrol:success", lambda m: m.update(success=True)),
    ("run", "room/patrol:true_success", lambda m: m.update(true_success=True)),
    ("run", "room/patrol:goals_reached", lambda m: m["goals"][1].update(status="reached")),
]


@pytest.mark.slow
def test_stages_that_lie_consistently_are_caught_by_their_data(tree):
    for stage, _, change in LIES:
        edit_metrics(tree / stage, change)
    shutil.rmtree(tree / "report")
    with undrawn():
        make_report([tree / "record", tree / "map", tree / "run"], Output(tree / "report"), animate=False)
    problems = verify(tree / "report", main).problems
    for _, key, _ in LIES:
        assert any(problem.startswith(f"{key}: reported") for problem in problems), key


@pytest.mark.slow
def test_a_lie_of_the_maps_own_check_is_found_by_making_the_map_again(chain, tmp_path):
    for name in ("record", "map", "run", "report"):
        shutil.copytree(chain / name, tmp_path / name)
    # Nothing is left where it was made: all is found beside the report.
    manifest = tmp_path / "report/manifest.json"
    manifest.write_text(manifest.read_text().replace(f'"path": "{chain}', '"path": "/nowhere'))
    key = "room/map:self_check.revisits"
    for file in (tmp_path / "map/metrics.json", tmp_path / "report/metrics.json"):
        text = file.read_text()
        file.write_text(re.sub(r'"revisits": \d+', '"revisits": 7', text))
        assert file.read_text() != text
        rehash(file.parent, "metrics.json")
    found = verify(tmp_path / "report", main)
    assert [check.key for check in found.checks if not check.agrees] == [key]
    assert any(line.startswith(f"{key}: reported 7, ") for line in found.problems)
    assert found.unchecked == []
    assert not re.search(r"map\.pgm|map\.yaml|trajectory|graph", " ".join(found.notes))
    assert key in verify(tmp_path / "report").unchecked


@pytest.mark.slow
@pytest.mark.parametrize(("name", "tag"), [("room/map:ate_m.max", ""), ("room/map:ate_m.rmse", "<dd ")])
def test_a_number_changed_on_the_page_only_in_a_tile_or_elsewhere_is_named(tree, name, tag):
    page = tree / "report/index.html"
    key, value, text = next(item for item in page_numbers(page) if item[0] == name)
    marked, before = f'{tag}data-key="{key}" data-value="{value}">', page.read_text()
    page.write_text(before.replace(marked + text, marked + "0.01\u202fcm"))
    assert page.read_text() != before
    rehash(tree / "report", "index.html")
    assert any(name in problem for problem in verify(tree / "report", main).problems)


@pytest.mark.slow
@pytest.mark.parametrize(
    ("said", "lie"),
    [
        ("2 of 3</dd>", "3 of 3</dd>"),
        ("0 of 1 task succeeded</h1>", "1 of 1 task succeeded</h1>"),
        ("<dd>Heading: the angle", "<dd>Heading, not counted"),
        ("2 of 3 goals reached (1 timeout), 1 collision.", "3 of 3 goals reached, no collision."),
        ("2 edges; the", "3 edges; the"),
    ],
)
def test_a_tile_a_verdict_and_a_caption_changed_on_the_page_are_named(tree, said, lie):
    page = tree / "report/index.html"
    text = page.read_text()
    assert said in text
    page.write_text(text.replace(said, lie, 1))
    rehash(tree / "report", "index.html")
    (problem,) = verify(tree / "report", main).problems
    assert problem.startswith("index.html: says ")
    assert re.sub("<[^>]*>", "", said) in problem.partition("; computed ")[2]


@pytest.mark.slow
def test_a_number_changed_in_the_reports_metrics_only_is_named(tree):
    edit_metrics(tree / "report", lambda m: m["room"]["record"].update(distance_m=100.0))
    problems = verify(tree / "report", main).problems
    assert any(problem.startswith("room/record:distance_m") for problem in problems)


@pytest.mark.slow
def test_a_changed_data_file_is_named(tree):
    path = tree / "map/trajectory.tum"
    path.write_text(path.read_text().replace("0 0 0", "0 0 0 ", 1))
    assert "room/map/trajectory.tum: does not match its manifest" in verify(tree / "report", main).problems


@pytest.mark.slow
def test_a_truth_that_is_not_the_bags_is_named(tree):
    path = tree / "record/truth/trajectory.tum"
    lines = path.read_text().splitlines()
    stamp, x, *rest = lines[10].split()
    lines[10] = " ".join([stamp, str(float(x) + 0.05), *rest])
    path.write_text("\n".join(lines) + "\n")
    assert any("/ground_truth/odom" in problem for problem in verify(tree / "report", main).problems)


@pytest.mark.slow
def test_a_trajectory_of_another_time_is_named(tree):
    path = tree / "map/trajectory.tum"
    rows = [line.split() for line in path.read_text().splitlines()]
    path.write_text("".join(f"{float(row[0]) + 1e6:.9f} {' '.join(row[1:])}\n" for row in rows))
    rehash(tree / "map", "trajectory.tum")
    assert any(problem.startswith("room/map: ") for problem in verify(tree / "report", main).problems)


@pytest.mark.slow
def test_the_command_names_what_differs_and_exits_1(tree, capsys):
    assert main(["verify", str(tree / "report")]) == 0
    edit_metrics(tree / "map", lambda m: m["ate_m"].update(rmse=0.001))
    assert main(["verify", str(tree / "report")]) == 1
    assert "DIFFERS room/map:ate_m.rmse" in capsys.readouterr().out


@pytest.mark.slow
def test_one_number_can_be_asked_for(tree, capsys):
    assert main(["verify", str(tree / "report"), "--only", "room/map:scans"]) == 0
    assert capsys.readouterr().out.splitlines()[0] == "same    room/map:scans  150"
    assert main(["verify", str(tree / "report"), "--only", "room/map:nothing"]) == 2


@pytest.mark.slow
def test_a_folder_may_have_the_name_of_the_verb_that_made_it(tree, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    poses = ["--start=-1.5,-0.5,0", "--goal", "1.5,0.5,0"]
    assert main(["plan", "--map", str(tree / "map"), *poses, "--out", "plan", "-q"]) == 0
    make_report([tmp_path / "plan"], Output(tmp_path / "report"), animate=False)
    found = verify(tmp_path / "report", main)
    assert found.problems == []
    assert "map/plan:length_m" in {check.key for check in found.checks}


def test_a_report_of_an_earlier_version_is_to_be_made_again(tree, capsys):
    path = tree / "report/manifest.json"
    manifest = json.loads(path.read_text())
    manifest["inputs"]["rival:other/trajectory"] = {"path": "poses.tum", "sha256": {"": "0"}}
    path.write_text(json.dumps(manifest))
    assert main(["verify", str(tree / "report")]) == 2
    assert capsys.readouterr().err.endswith("is a report of an earlier version; make it again\n")


@pytest.mark.slow
def test_what_is_no_report_is_refused(tree, tmp_path, capsys):
    for folder in (tree / "map", tmp_path, tree / "gone"):
        assert main(["verify", str(folder)]) == 2
        assert capsys.readouterr().err.count("\n") == 1
    assert main(["verify", str(tree / "gone")]) == 2
    assert capsys.readouterr().err.endswith("gone: no such folder (expected a report)\n")


def test_numbers_agree_up_to_the_rounding_of_files():
    assert same(0.5, 0.5 + 1e-7)
    assert not same(0.5, 0.5001)
    assert not same(1, None)
    assert not same(True, 2)


def test_a_graph_is_read_in_the_order_of_its_keys(tmp_path):
    path = tmp_path / "graph.g2o"
    path.write_text("VERTEX_SE2 7 0 1 0.5\nVERTEX_SE2 0 3 0 0\nEDGE_SE2 0 7 1 0 0 1 0 0 1 0 1\n")
    graph = read_g2o(path)
    assert graph.T_map_keys.xyt.tolist() == [[3.0, 0.0, 0.0], [0.0, 1.0, 0.5]]
    assert graph.edges == 1


@pytest.mark.parametrize("text", ["", "VERTEX_SE2 0 0", "VERTEX_SE2 0 0 0 0\nEDGE_SE2 0 5 1 0 0 1 0 0 1 0 1"])
def test_a_damaged_graph_is_bad_input(text, tmp_path):
    (tmp_path / "graph.g2o").write_text(text)
    with pytest.raises(InputError):
        read_g2o(tmp_path / "graph.g2o")


def test_loops_are_read_from_their_record(tmp_path):
    loop = {"i": 5, "j": 1, "residual_m": 0.01, "verdict": "accepted", "score": 0.9}
    (tmp_path / "graph.json").write_text(json.dumps({"loops": [loop, {**loop, "verdict": "low score"}]}))
    record = read_loops(tmp_path / "graph.json")
    assert record.accepted.tolist() == [True, False]
    assert record.residual_m.tolist() == [0.01, 0.01]
    (tmp_path / "graph.json").write_text('{"loops": [{"i": 5}]}')
    with pytest.raises(InputError):
        read_loops(tmp_path / "graph.json")


@pytest.mark.slow
def test_a_clearance_the_true_map_does_not_leave_is_named(tree):
    log = RunLog.load(tree / "run/runlog.csv")
    replace(log, clearance_m=np.full(len(log), 5.0)).save(tree / "run/runlog.csv")
    rehash(tree / "run", "runlog.csv")
    edit_metrics(tree / "run", lambda m: m.update(min_clearance_m=5.0))
    edit_metrics(tree / "report", lambda m: m["room"]["patrol"].update(min_clearance_m=5.0))
    problems = verify(tree / "report", main).problems
    assert any("room/patrol:min_clearance_m: reported 5.000, but the true map" in text for text in problems)
