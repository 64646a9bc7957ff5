"""Offline localisation and plans in a report."""

import json
import re
import shutil

import numpy as np
import pytest

from tests.helpers.report_fakes import (
    fake_localise,
    fake_map,
    fake_plan,
    fake_record,
    fake_run,
    rehash,
    unrendered,
)
from turtlebag.datasets.grid import OCCUPIED, OccupancyGrid
from turtlebag.datasets.maps import load_map, save_map
from turtlebag.datasets.outputs import Output, sha256_file, write_json
from turtlebag.pipeline.stages.report import make_report
from turtlebag.reports.content import interactive_map_of
from turtlebag.reports.drawing import planner_paths
from turtlebag.reports.stages import Group, load_stage


@pytest.mark.slow
def test_localisation_and_plan_stand_with_their_world(tmp_path):
    record = fake_record(tmp_path / "record")
    built = fake_map(tmp_path / "map", record)
    located = fake_localise(tmp_path / "localise", record, built)
    plan = fake_plan(tmp_path / "plan", built)
    page = make_report([plan, located, built, record], Output(tmp_path / "out"), animate=False).read_text()
    metrics = json.loads((tmp_path / "out/metrics.json").read_text())
    assert list(metrics) == ["room"]
    assert list(metrics["room"]) == ["record", "map", "localise", "plan"]
    assert "Localised, " in page
    assert "A path of 4.00\u202fm was found." in page


def test_a_plan_that_found_nothing_is_reported_with_its_reason(tmp_path):
    built = fake_map(tmp_path / "map", fake_record(tmp_path / "record"))
    plan = fake_plan(tmp_path / "plan", built)
    (plan / "path.csv").write_text("x,y,yaw\n")
    (plan / "metrics.json").write_text('{"success": false, "reason": "no way round the pillar"}')
    rehash(plan, "path.csv")
    rehash(plan, "metrics.json")
    with unrendered():
        page = make_report([plan], Output(tmp_path / "out"), animate=False).read_text()
    assert "No path was found: no way round the pillar." in page


@pytest.mark.slow
def test_planners_are_compared_on_the_map_and_in_a_table(tmp_path):
    built = fake_map(tmp_path / "map", fake_record(tmp_path / "record"))
    plan = fake_plan(tmp_path / "plan", built)
    entries = [
        {"planner": "RRTConnect", "success": True, "length_m": 4.25, "min_clearance_m": 0.2, "poses": 3},
        {"planner": "PRM", "success": False, "reason": "out of iterations"},
        {"planner": "BITstar", "success": True, "length_m": 4.0, "min_clearance_m": 0.1, "poses": 3},
    ]
    (plan / "metrics.json").write_text(json.dumps({"success": True, "length_m": 4.25, "planners": entries}))
    rehash(plan, "metrics.json")
    for number, name in enumerate(("RRTConnect", "PRM", "BITstar")):
        rows = "" if name == "PRM" else f"-2,-1.5,0\n0,{-1.5 + 0.2 * number},0\n2,-1.5,0\n"
        (plan / f"path-{name}.csv").write_text("x,y,yaw\n" + rows)
    assert list(planner_paths(load_stage(plan))) == ["RRTConnect", "BITstar"]
    page = make_report([plan], Output(tmp_path / "out"), animate=False).read_text()
    assert "2 of 3 planners found a path; the chosen one did." in page
    assert "Planners compared." in page
    assert 'data-key="map/plan:planners.0.length_m" data-value="4.25">4.25' in page
    assert "out of iterations" in page


@pytest.mark.slow
def test_who_was_not_told_where_it_is_and_what_was_mapped_on_the_way_are_shown_as_that(tmp_path):
    record = fake_record(tmp_path / "record")
    built = fake_map(tmp_path / "map", record)
    located, run = fake_localise(tmp_path / "localise", record, built), fake_run(tmp_path / "run", built)
    (located / "metrics.json").write_text(
        '{"success": false, "status": "rejected", "reason": "no initial pose"}'
    )
    rehash(located, "metrics.json")
    for name in ("map.pgm", "map.yaml"):
        shutil.copy(built / name, run / name)
    with unrendered():
        page = make_report([record, located, run], Output(tmp_path / "out"), animate=False).read_text()
    assert "Rejected: no initial pose." in page
    assert "<strong>Not localised.</strong>" in page
    assert "<strong>The map it built.</strong>" in page


@pytest.mark.slow
def test_a_stage_is_drawn_on_the_very_map_it_was_given_or_on_none(tmp_path):
    record = fake_record(tmp_path / "record")
    first, given = fake_map(tmp_path / "first", record), fake_map(tmp_path / "given", record)
    changed = load_map(given / "map.yaml").cells.copy()
    changed[60:70, 60:70] = OCCUPIED
    save_map(OccupancyGrid(changed, 0.05, load_map(given / "map.yaml").T_map_grid), given)
    rehash(given, "map.pgm")
    run = load_stage(fake_run(tmp_path / "run", given))
    assert run.hashes("map_image") == {"map.pgm": sha256_file(given / "map.pgm")}
    group = Group("room", (load_stage(record), load_stage(first), load_stage(given), run))
    np.testing.assert_array_equal(group.given_map(run).cells, changed)
    # The file is another map by now: the same one is found by its hashes, where it was moved to.
    given.rename(tmp_path / "moved")
    shutil.copytree(first, given)
    elsewhere = Group("room", (load_stage(first), load_stage(tmp_path / "moved"), run))
    np.testing.assert_array_equal(elsewhere.given_map(run).cells, changed)
    assert Group("room", (load_stage(first), run)).given_map(run) is None
    on_truth = load_stage(fake_run(tmp_path / "cheat", record / "truth"))
    record.rename(tmp_path / "far")
    seen = Group("room", (load_stage(tmp_path / "far"), on_truth)).given_map(on_truth)
    np.testing.assert_array_equal(seen.cells, load_map(tmp_path / "far/truth/map.yaml").cells)


@pytest.mark.slow
def test_the_map_under_the_mouse_is_the_one_that_was_driven_on(tmp_path):
    record = fake_record(tmp_path / "record")
    first, given = fake_map(tmp_path / "first", record), fake_map(tmp_path / "given", record)
    grid = load_map(first / "map.yaml")
    save_map(OccupancyGrid(grid.cells[:90], 0.05, grid.T_map_grid), first)
    rehash(first, "map.pgm")
    run = fake_run(tmp_path / "run", given)
    group = Group("room", tuple(load_stage(folder) for folder in (record, first, given, run)))
    assert interactive_map_of(group).grid.shape[0] == 108
    assert interactive_map_of(Group("room", group.stages[:2])).grid.shape[0] == 90


@pytest.mark.slow
def test_without_a_run_the_headline_says_what_there_is_and_whether_it_was_found(tmp_path):
    record = fake_record(tmp_path / "record")
    built = fake_map(tmp_path / "map", record)
    plan, located = fake_plan(tmp_path / "plan", built), fake_localise(tmp_path / "localise", record, built)

    def head(name, *folders):
        with unrendered():
            page = make_report(list(folders), Output(tmp_path / name), animate=False).read_text()
        return re.search(r'<h1 class="(\w+)">(.*?)</h1>', page).groups(), page

    assert head("one", record)[0] == ("neutral", "1 recording, no navigation")
    assert head("two", record, located, plan)[0] == (
        "good",
        "1 recording, 1 localisation, 1 plan, no navigation",
    )
    (mood, text), page = head("three", plan)
    assert (mood, text) == ("good", "1 plan, no navigation")
    assert re.search(r"<dt>length of the plan</dt><dd[^>]*>4.00", page)
    write_json(plan / "metrics.json", {"success": False, "reason": "no way"})
    rehash(plan, "metrics.json")
    assert head("four", plan)[0] == ("bad", "1 plan, no navigation")
