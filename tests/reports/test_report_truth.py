"""A report judges by the truth and says beside it what the robot believed; stages have descriptive names."""

import re
from pathlib import Path

import pytest

from tests.helpers.report_fakes import fake_map, fake_record, fake_run, undrawn, unrendered
from turtlebag.datasets.outputs import Output
from turtlebag.pipeline.stages.compare import compare_outputs
from turtlebag.pipeline.stages.report import make_index, make_report
from turtlebag.reports.grouping import group_stages
from turtlebag.reports.kinds import verdict
from turtlebag.reports.metrics.navigation import outcome
from turtlebag.reports.stages import Manifest, Stage, load_stage

AWAY = ((1.3, 0.6), (-1.3, 0.6), (0.0, 1.2))
"""The robot takes the last of these to be reached 2.4 m from it."""


@pytest.fixture(scope="module")
def folders(tmp_path_factory):
    base = tmp_path_factory.mktemp("truth")
    record = fake_record(base / "record")
    fake_map(base / "map", record)
    fake_run(base / "there", base / "map")
    fake_run(base / "lost", base / "map", where=AWAY, seed=2)
    return base


@pytest.fixture(scope="module")
def page(folders):
    stages = [folders / name for name in ("record", "map", "there", "lost")]
    with undrawn():
        return make_report(stages, Output(folders / "report"), animate=False)


@pytest.mark.slow
def test_a_run_that_only_believes_it_succeeded_is_a_failure_in_title_headline_tile_and_verdict(page):
    text = page.read_text()
    said = "1 of 2 tasks succeeded; the robot reported 2"
    assert f"<title>TurtleBag report: {said}</title>" in text
    assert f'<h1 class="bad">{said}</h1>' in text
    tile = re.search(
        r'<div class="tile bad"[^>]*><dt>goals reached</dt><dd>([^<]*)</dd><dd class="note">([^<]*)', text
    )
    assert tile.groups() == ("5 of 6", "the robot reported 6")
    words = " ".join(re.sub("<[^>]*>", "", text).split())
    assert "2 of 3 goals reached (the robot reported 3, but was up to 2.40 m away)" in words


@pytest.mark.slow
def test_what_the_robot_said_and_what_was_true_stand_in_columns_of_their_own(page):
    row = re.search(r"<tr><td>3</td><td>0.00\u202fm, 1.20\u202fm(.*?)</tr>", page.read_text()).group(1)
    assert ">reached</td>" in row
    assert '<td class="status elsewhere">elsewhere</td>' in row


@pytest.mark.slow
def test_a_goal_the_robot_was_not_at_is_marked_so_on_the_map_for_the_mouse(folders, page):
    with unrendered():
        stages = [folders / "map", folders / "lost"]
        text = make_report(stages, Output(folders / "alone"), animate=False).read_text()
    assert re.findall(r'<circle class="(good|bad)"', text) == ["good", "good", "bad"]
    assert re.findall(r'<circle class="(good|bad)"', page.read_text()) == ["good", "good", "good"]


def test_the_index_calls_it_bad_too(folders):
    text = make_index([folders / "lost"], Output(folders / "index")).read_text()
    assert re.search(r'<td class="verdict bad"[^>]*>2 of 3 goals</td>', text)


def test_a_single_goal_that_was_missed_unawares_says_how_far_the_robot_was():
    goal = {"x": 0.0, "y": 2.0, "yaw": 0.0, "status": "reached", "error_m": 3.997}
    metrics = {"success": True, "true_success": False, "goals": [goal]}
    assert verdict(Stage(Path("nowhere"), "navigate", "goal", Manifest(stage="navigate")), metrics) == (
        "bad",
        "Goal not reached: the robot reported it as reached, but was 4.00\u202fm away; no collision.",
    )


@pytest.mark.parametrize(
    ("status", "error_m", "end"),
    [
        ("reached", 0.25, "reached"),
        ("reached", 0.26, "elsewhere"),
        ("reached", None, "reached"),
        ("timeout", 0.1, "timeout"),
    ],
)
def test_the_outcome_of_a_goal_is_by_the_truth_where_there_is_one(status, error_m, end):
    assert outcome({"status": status, "error_m": error_m}) == end


def test_a_success_the_truth_denies_is_bad_whatever_the_goals_say():
    metrics = {"success": True, "true_success": False, "goals": [], "collisions": 0}
    assert (
        verdict(Stage(Path("nowhere"), "navigate", "explore", Manifest(stage="navigate")), metrics)[0]
        == "bad"
    )


@pytest.mark.slow
def test_runs_of_one_task_are_named_by_what_tells_them_apart(page, folders):
    stages = [load_stage(folders / name) for name in ("record", "map", "there", "lost")]
    (group,) = group_stages(stages)
    assert [(stage.label, stage.title) for stage in group.stages] == [
        ("record", "Recording"),
        ("map", "Mapping"),
        ("patrol-seed-1", "Patrol, seed 1"),
        ("patrol-seed-2", "Patrol, seed 2"),
    ]
    assert "Patrol, seed 2</a>" in page.read_text()
    assert "burger in room" in page.read_text()
    assert (page.parent / "figures/room-patrol-seed-2-path.svg").is_file()


def run_of(goal, *options, seed=1, task="goal"):
    command = ["turtlebag", "navigate", "--world", "room", "--task", task, f"--goal={goal}", *options]
    return Stage(
        Path("nowhere"),
        "navigate",
        "navigate",
        Manifest(stage="navigate", world="room", seed=seed, command=command),
    )


def test_goals_are_named_by_where_they_are_and_poses_keep_their_signs():
    (group,) = group_stages([run_of("5.5,-4.5,0"), run_of("5.5,4.5,0"), run_of("5.5,4.5,0")])
    assert [stage.title for stage in group.stages] == [
        "Goal (5.5, \u22124.5)",
        "Goal (5.5, 4.5)",
        "Goal (5.5, 4.5), no. 2",
    ]
    assert len({stage.label for stage in group.stages}) == 3
    assert "minus" in group.stages[0].label


def test_only_what_differs_goes_into_a_name():
    told = ["--initial-pose", "2,0.5,3.14"]
    (group,) = group_stages(
        [run_of("0,2,0", *told, seed=4), run_of("0,2,0", "--initial-pose", "start", seed=4)]
    )
    assert [stage.title for stage in group.stages] == [
        "Goal (0, 2), initial pose (2, 0.5, 3.14)",
        "Goal (0, 2), initial pose start",
    ]


def test_maps_of_several_recordings_say_whose_they_are(tmp_path):
    def stage(kind, seed, inputs, outputs):
        named = {name: {"path": name, "sha256": files} for name, files in inputs.items()}
        manifest = {"stage": kind, "world": "room", "seed": seed, "inputs": named, "outputs": outputs}
        return Stage(tmp_path, kind, kind, Manifest.model_validate(manifest))

    records = [stage("record", n, {}, {"bag/bag_0.mcap": f"bag {n}"}) for n in (1, 2)]
    maps = [stage("map", None, {"source": {"bag_0.mcap": f"bag {n}"}}, {}) for n in (1, 2)]
    (group,) = group_stages([*records, *maps])
    assert [stage.title for stage in group.stages] == [
        "Recording, seed 1",
        "Recording, seed 2",
        "Mapping, of recording seed 1",
        "Mapping, of recording seed 2",
    ]


def test_a_localisation_that_only_believes_it_is_there_is_bad():
    stage = Stage(Path("nowhere"), "localise", "localise", Manifest(stage="localise"))
    metrics = {"success": True, "true_success": False, "status": "localised", "last_error_m": 3.98}
    assert verdict(stage, metrics) == (
        "bad",
        "Not localised: the filter reported success, but was 3.98\u202fm off at the end.",
    )
    assert verdict(stage, metrics | {"true_success": True})[0] == "good"
    del metrics["true_success"]
    assert verdict(stage, metrics)[0] == "good"


@pytest.mark.slow
def test_a_comparison_says_of_both_how_they_truly_went(folders):
    compare_outputs([folders / "lost", folders / "there"], Output(folders / "comparison"))
    text = (folders / "comparison/index.html").read_text()
    lines = re.findall(r'<li class="(good|bad)">(A|B): (\d of 3) goals reached', text)
    assert lines == [("bad", "A", "2 of 3"), ("good", "B", "3 of 3")]
    assert re.search(r"success \(ground truth\)</td><td[^>]*>no</td><td[^>]*>yes</td>", text)
    assert re.search(r"success \(robot&#39;s estimate\)</td><td[^>]*>yes</td><td[^>]*>yes</td>", text)
