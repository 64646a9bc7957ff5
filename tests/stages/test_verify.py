"""Verification finds whatever was changed in a report or below it, and nothing in an honest one."""

import json
import re
import shutil
from pathlib import Path

import pytest

from tests.helpers.report_fakes import fake_map, fake_record, rehash, undrawn
from turtlebag.datasets.errors import InputError
from turtlebag.datasets.outputs import Output
from turtlebag.pipeline.cli.main import main
from turtlebag.pipeline.stages.command_line import recorded
from turtlebag.pipeline.stages.record import record_drive, scene_of
from turtlebag.pipeline.stages.requests.drives import KeyboardRequest
from turtlebag.pipeline.stages.requests.maps import LocaliseRequest, MapRequest
from turtlebag.pipeline.stages.requests.pages import ReportRequest
from turtlebag.pipeline.stages.run import run
from turtlebag.pipeline.stages.verify import Check, verify
from turtlebag.reports.g2o import read_g2o, read_loops
from turtlebag.sim.script_driver import Twist

pytestmark = pytest.mark.slow
STAGES = ("record", "map", "run")


@pytest.fixture
def tree(chain, tmp_path):
    """An honest report and its stages, moved together: nothing is left where it was made."""
    for name in (*STAGES, "report"):
        shutil.copytree(chain / name, tmp_path / name)
    manifest = tmp_path / "report/manifest.json"
    manifest.write_text(manifest.read_text().replace(f'"path": "{chain}', '"path": "/nowhere'))
    return tmp_path


def found_in(tree, **options):
    with undrawn():
        return verify(tree / "report", **options)


def reported_again(tree, *stages):
    """What a forger does last: a report of what he has changed."""
    shutil.rmtree(tree / "report", ignore_errors=True)
    with undrawn():
        asked = ReportRequest(folders=tuple(tree / name for name in stages or STAGES), animate=False)
        assert run(asked, Output(tree / "report")) == 0


def edit_json(path, change):
    data = json.loads(path.read_text())
    change(data)
    path.write_text(json.dumps(data, indent=2) + "\n")


def test_an_honest_report_verifies(tree):
    found = found_in(tree)
    assert (found.problems, found.not_run, found.unchecked, found.elsewhere) == ([], [], [], [])
    assert len(found.checks) > 50
    assert all(check.agrees for check in found.checks)
    known = {check.key for check in found.checks}
    keys = re.findall(r'data-key="([^"]*)" data-value', (tree / "report/index.html").read_text())
    assert len(keys) > 30
    assert set(keys) <= known


def test_a_localisation_and_a_plan_are_made_again_too(tree, chain):
    shutil.copytree(chain / "plan", tree / "plan")
    asked = LocaliseRequest(source=tree / "record", map=tree / "map", initial_pose="0,0,0", seed=2)
    assert run(asked, Output(tree / "localise")) == 0
    reported_again(tree, "record", "map", "localise", "plan")
    found = found_in(tree)
    assert (found.problems, found.not_run) == ([], [])
    assert any(check.key.endswith("/plan:length_m") for check in found.checks)


def in_metrics(stage, change):
    def forge(tree):
        edit_json(tree / stage / "metrics.json", change)
        rehash(tree / stage, "metrics.json")

    return forge


def in_manifest(stage, change):
    return lambda tree: edit_json(tree / stage / "manifest.json", change)


def in_config(tree):
    path = tree / "run/config.yaml"
    text = path.read_text()
    path.write_text(text.replace("sensors: realistic", "sensors: clean"))
    assert path.read_text() != text
    rehash(tree / "run", "config.yaml")


def a_command_that_cannot_run(tree):
    """After which everything may be forged."""
    edit_json(tree / "map/manifest.json", lambda m: m.update(command=["turtlebag", "mpa", "x"]))
    in_metrics("map", lambda m: m["ate_m"].update(rmse=0.0))(tree)


def another_recording(tree):
    """A copy that its own manifest does not list, with one file less of what the map's says it read."""
    shutil.copytree(tree / "record/bag", tree / "other/bag")
    edit_json(tree / "map/manifest.json", lambda m: m["request"].update(source=str(tree / "other")))


# Forgeries that are told apart stand in one report: the stages of each are made again once.
FORGED = {
    "words, numbers and settings": {
        "room/map:self_check.verdict: reported doubtful, computed good": in_metrics(
            "map", lambda m: m["self_check"].update(verdict="doubtful")
        ),
        "room/map:self_check.reasons.0: reported all is well, not made again": in_metrics(
            "map", lambda m: m["self_check"].update(reasons=["all is well"])
        ),
        "room/map:ate_m.rmse: reported 0.0001, computed ": in_metrics(
            "map", lambda m: m["ate_m"].update(rmse=0.0001)
        ),
        "room-2/patrol:goals.0.status: reported None, computed reached": in_metrics(
            "run", lambda m: m.update(goals=[])
        ),
        "room-2/patrol:award: reported best paper, not made again": in_metrics(
            "run", lambda m: m.update(award="best paper")
        ),
        "room-2/patrol: its manifest says seed 7; run again, it is 3": in_manifest(
            "run", lambda m: m.update(seed=7)
        ),
        "room-2/patrol/config.yaml: made again, it has other content": in_config,
    },
    "what a stage was given": {
        "room-2/patrol: the command in its manifest has another seed than its request: 3 and 7": in_manifest(
            "run", lambda m: (m.update(seed=7), m["request"].update(seed=7))
        ),
        "room/map: the command in its manifest cannot run: invalid choice: 'mpa'": a_command_that_cannot_run,
        "room/record: run again, it reads ": in_manifest("record", lambda m: m["inputs"].pop("teleop")),
    },
    "a request that cannot be run": {
        "room/map: cannot be run again: nowhere: no such file or folder": in_manifest(
            "map", lambda m: m["request"].update(source="nowhere")
        ),
    },
    "another recording": {"room/map: run again, its input source is another one: ": another_recording},
    "settings in a file": {
        "room/map: its request names a settings file, any.yaml, instead of holding its settings": in_manifest(
            "map", lambda m: m["request"].update(config="any.yaml")
        ),
    },
    "no request": {
        "room/map: made by an earlier version: run it again": in_manifest("map", lambda m: m.pop("request")),
    },
    "another command": {
        "room/map: is an output of map, but its request is of grade": in_manifest(
            "map", lambda m: m.update(request={"verb": "grade", "source": "theirs.py", "lesson": 2})
        ),
    },
    "a part from outside": {
        "room/map: names my.parts:Mine, from outside the package; --allow-commands runs it": in_manifest(
            "map", lambda m: m["request"]["settings"].update(front_end="my.parts:Mine")
        ),
    },
}


@pytest.mark.parametrize("name", FORGED)
def test_what_is_forged_in_a_stage_is_named_though_its_hash_and_the_report_are_made_anew(tree, capsys, name):
    for forge in FORGED[name].values():
        forge(tree)
    with_run = any(line.startswith("room-2") for line in FORGED[name])
    reported_again(tree, *(STAGES if with_run else STAGES[:2]))
    capsys.readouterr()
    with undrawn():
        assert main(["verify", str(tree / "report")]) == 1
    said = capsys.readouterr().out
    for line in FORGED[name]:
        assert re.search(f"^(DIFFERS|NOT RUN) {re.escape(line)}", said, re.M), said


def on_the_page(old, new):
    def forge(report):
        page = report / "index.html"
        text = page.read_text()
        assert old in text
        page.write_text(text.replace(old, new, 1))
        rehash(report, "index.html")

    return forge


def a_figure(report):
    (report / "figures/room-map-graph.svg").write_bytes(b"another")
    rehash(report, "figures/room-map-graph.svg")


def a_table(report):
    path = report / "tables/numbers.csv"
    path.write_text(path.read_text() + "room/map,award,1\n")
    rehash(report, "tables/numbers.csv")


PAGE = {
    "a figure": a_figure,
    "a table": a_table,
    "the title": on_the_page("<title>", "<title>Certified: "),
    "the style": on_the_page("<style>", "<style>.bad {display: none} "),
    "text of a picture": on_the_page("</svg>", "<text>0 cm</text></svg>"),
    "text after the script": on_the_page("</html>", "<p>All goals reached.</p></html>"),
    "a verdict": on_the_page("goals reached", "goals easily reached"),
}


@pytest.mark.parametrize("name", PAGE)
def test_what_is_forged_in_the_report_is_named_though_its_hash_is_made_anew(tree, name):
    PAGE[name](tree / "report")
    (problem,) = found_in(tree, quick=True).problems
    assert re.fullmatch(r"report/[\w/.-]+: made again, it has other content", problem)


def test_numbers_of_the_report_alone_are_compared_with_the_stages(tree):
    edit_json(tree / "report/metrics.json", lambda m: m["room"]["map"].update(keyframes=9999))
    rehash(tree / "report", "metrics.json")
    problems = found_in(tree, quick=True).problems
    assert "room/map:keyframes: the report and the stage's own metrics differ" in problems


def test_a_changed_file_and_a_lost_input_are_named(tree):
    path = tree / "map/trajectory.tum"
    path.write_text(path.read_text() + "\n")
    shutil.rmtree(tree / "record/truth")
    found = found_in(tree)
    assert "room/map/trajectory.tum: does not match its manifest" in found.problems
    assert any(line.startswith("room/map: its input source, ") for line in found.not_run)
    assert "room/map:ate_m.rmse" in found.unchecked


def test_an_input_that_is_no_stage_of_the_report_is_hashed(chain, tmp_path):
    shutil.copy(chain / "drive.log", tmp_path / "drive.log")
    (tmp_path / "mine.yaml").write_text("loops: {enabled: false}\n")
    asked = MapRequest(source=tmp_path / "drive.log", config=tmp_path / "mine.yaml")
    assert run(asked, Output(tmp_path / "map")) == 0
    reported_again(tmp_path, "map")
    (tmp_path / "mine.yaml").unlink()  # what it said stands in the request
    found = found_in(tmp_path)
    assert (found.problems, found.not_run) == ([], [])
    (tmp_path / "drive.log").write_text("another\n")
    (line,) = found_in(tmp_path).not_run
    assert re.fullmatch(r"\S+/map: its input source, .*drive\.log, is not what it was \(drive\.log\)", line)
    (tmp_path / "drive.log").unlink()
    (line,) = found_in(tmp_path).not_run
    assert re.fullmatch(r"\S+/map: its input source, .*drive\.log, is gone", line)


def test_a_drive_by_hand_is_driven_again_by_its_own_commands(chain, tmp_path):
    asked = KeyboardRequest(world=str(chain / "room.yaml"), seed=5)

    def hand():
        for _ in range(40):
            yield Twist(0.1, 0.3)

    driver = hand()
    output = recorded(asked, Output(tmp_path / "record"))
    assert record_drive(scene_of(asked), driver, "keyboard:keys", output) == 0
    reported_again(tmp_path, "record")
    found = found_in(tmp_path)
    assert (found.problems, found.not_run) == ([], [])
    edit_json(tmp_path / "record/manifest.json", lambda m: m["request"].update(seed=6))
    assert any("bag_0.mcap: made again" in line for line in found_in(tmp_path).problems)


def test_on_another_machine_numbers_may_differ_within_their_tolerances(tree, capsys):
    for name in STAGES[:2]:
        edit_json(tree / name / "manifest.json", lambda m: m["packages"].update(numpy="1.0"))
    in_metrics("map", lambda m: m["ate_m"].update(rmse=m["ate_m"]["rmse"] + 0.001))(tree)
    reported_again(tree, *STAGES[:2])
    found = found_in(tree)
    assert (found.problems, found.not_run) == ([], [])
    in_metrics("map", lambda m: m["ate_m"].update(rmse=m["ate_m"]["rmse"] + 0.1))(tree)
    reported_again(tree, *STAGES[:2])
    (problem,) = found_in(tree).problems
    assert problem.startswith("room/map:ate_m.rmse: reported 0.1")
    capsys.readouterr()
    with undrawn():
        assert main(["verify", str(tree / "report"), "--quick"]) == 0
    assert capsys.readouterr().out.startswith(
        "made on another machine or with other packages: numpy 1.0 (here "
    )


def test_values_of_another_machine_agree_as_far_as_they_can():
    assert Check("a", 0.5, 0.52, 0.05).agrees
    assert not Check("a", 0.5, 0.52).agrees
    assert Check("a", "54 % of 8", "53.9 % of 8", 0.0).agrees
    assert not Check("a", "good", "bad", 9.0).agrees
    assert not Check("a", True, False, 9.0).agrees
    assert not Check("a", 1, None, 9.0).agrees


def test_the_command_names_one_number_or_what_differs(tree, capsys):
    with undrawn():
        assert main(["verify", str(tree / "report"), "--only", "room/map:scans"]) == 0
        said = capsys.readouterr().out
        assert re.fullmatch(
            r"same    room/map:scans  \d+\n1 of 1 recomputed numbers agree, \d+ files hashed\n", said
        )
        assert main(["verify", str(tree / "report"), "--only", "room/map:nothing", "--quick"]) == 2
        assert main(["verify", str(tree / "report"), "--quick"]) == 0
        assert "not recomputed: room/record:scans" in capsys.readouterr().out


def test_a_persons_file_in_the_folder_of_a_stage_is_named_once_it_changes(tmp_path):
    fake_map(tmp_path / "map", fake_record(tmp_path / "record"))
    note = tmp_path / "map/note.txt"
    note.write_text("the door was open\n")
    reported_again(tmp_path, "record", "map")
    assert found_in(tmp_path, quick=True).problems == []
    note.write_text("it was shut\n")
    problems = found_in(tmp_path, quick=True).problems
    assert problems == ["room/map/note.txt: changed since the report was made"]


def test_a_report_of_an_earlier_version_is_to_be_made_again(tree, capsys):
    change = {"rival:other/trajectory": {"path": "poses.tum", "sha256": {"": "0"}}}
    edit_json(tree / "report/manifest.json", lambda m: m["inputs"].update(change))
    assert main(["verify", str(tree / "report")]) == 2
    assert capsys.readouterr().err.endswith("is a report of an earlier version; make it again\n")


def test_what_an_earlier_version_made_is_not_said_to_be_of_another_machine(tree):
    for name in (*STAGES, "report"):
        edit_json(tree / name / "manifest.json", lambda m: (m.pop("request"), m.pop("cpu")))
    found = verify(tree / "report")
    again = "made by an earlier version: run it again"
    assert found.elsewhere == []
    assert [line.partition(": ")[2] for line in found.not_run] == [again] * 4


def test_what_is_no_report_is_refused(tree, tmp_path, capsys):
    for folder in (tree / "map", Path("/"), tree / "gone"):
        assert main(["verify", str(folder)]) == 2
        assert capsys.readouterr().err.count("\n") == 1
    assert main(["verify", str(tree / "gone")]) == 2
    assert capsys.readouterr().err.endswith("gone: no such folder (expected a report)\n")


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
