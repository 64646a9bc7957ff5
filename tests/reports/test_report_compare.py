"""Comparisons of two outputs of one stage."""

import json
import re

import numpy as np
import pytest

from tests.helpers.report_fakes import (
    fake_localise,
    fake_map,
    fake_maps,
    fake_plan,
    fake_record,
    mapped_room,
    undrawn,
)
from turtlebag.datasets.grid import OccupancyGrid
from turtlebag.datasets.outputs import Output
from turtlebag.datasets.se2 import SE2
from turtlebag.pipeline.cli.main import main
from turtlebag.pipeline.stages.compare import compare_outputs
from turtlebag.reports.compare import changed_between, map_overlap
from turtlebag.reports.figures.systems import walls


@pytest.fixture(scope="module")
def tree(tmp_path_factory):
    base = tmp_path_factory.mktemp("compare")
    fake_maps(base)
    return base


def by_path(found):
    """The differences of the second side to the first, by number."""
    return {row.spec.path: row.differences[0] for row in found.rows}


def test_only_what_differs_is_called_different(tree):
    found = compare_outputs([tree / "a", tree / "b"])
    assert found.settings == [("front.sigma", ["0.005", "0.02"])]
    assert "map.pgm" in found.pair.same_bytes
    assert "trajectory.tum" in found.pair.changed
    differences = by_path(found)
    assert differences["scans"].verdict == "the same"
    assert differences["ate_m.rmse"].verdict == "no spread"
    assert differences["ate_m.rmse"].text.startswith("+")


def test_the_other_way_round_more_becomes_less(tree):
    found = compare_outputs([tree / "b", tree / "a"])
    assert by_path(found)["ate_m.rmse"].text.startswith("\u2212")


def test_an_output_compared_with_itself_differs_in_nothing(tree):
    found = compare_outputs([tree / "a", tree / "a"])
    assert found.settings == found.pair.changed == []
    assert {one.verdict for one in by_path(found).values()} <= {"the same", ""}


@pytest.mark.slow
def test_the_page_shows_maps_paths_and_distance(tree, tmp_path):
    compare_outputs([tree / "a", tree / "b"], Output(tmp_path / "out"))
    page = (tmp_path / "out/index.html").read_text()
    assert sorted(path.name for path in (tmp_path / "out/figures").iterdir()) == [
        "apart.svg",
        "maps.svg",
        "paths.svg",
    ]
    assert "front.sigma" in page
    assert "one run of A and B: no spread, so no difference is judged" in page
    assert "good-number" not in page.partition("<body")[2]
    [table] = re.findall(r'<table class="sortable runs">.*?</table>', page, flags=re.DOTALL)
    rows = table.partition("<tbody>")[2].count("<tr>")
    assert rows > 0
    assert len(re.findall(r'data-sort="[-+.e\d]*"', table)) == 3 * rows
    sides = json.loads((tmp_path / "out/metrics.json").read_text())["sides"]
    a, b = (sides[letter]["numbers"]["ate_m.rmse"]["median"] for letter in "AB")
    assert b > 2.0 * a


def test_the_command_prints_the_differences(tree, capsys):
    assert main(["compare", str(tree / "a"), str(tree / "b")]) == 0
    out = capsys.readouterr().out
    assert "front.sigma: 0.005 | 0.02" in out
    assert "trajectory error (ATE), RMSE" in out
    assert out.endswith("\n4 files identical, 3 different\n")
    assert out.splitlines()[3].split() == ["A", "B", "B", "-", "A"]


def test_one_file_is_no_files(tree, tmp_path, capsys):
    hall = fake_record(tmp_path / "hall", world="hall")
    manifest = json.loads((hall / "manifest.json").read_text())
    del manifest["outputs"]["truth/map.yaml"]
    (hall / "manifest.json").write_text(json.dumps(manifest))
    assert main(["compare", str(tree / "record"), str(hall)]) == 0
    assert capsys.readouterr().out.endswith("\n1 file identical, 4 different\n")


def test_settings_missing_on_one_side_differ():
    a, b = {"a": {"b": 1}, "c": None, "e": True}, {"a": {"b": 1, "d": 2}, "e": False}
    assert changed_between([[a], [b]]) == [
        ("c", ["null", "not set"]),
        ("e", ["true", "false"]),
        ("a.d", ["not set", "2"]),
    ]


def test_map_overlap_counts_cells_in_metres_not_by_index():
    grid = mapped_room()
    count = int((grid.cells >= 65).sum())
    cut = OccupancyGrid(grid.cells[2:, 3:], 0.05, SE2.from_xyt(-3.15, -2.6, 0.0))
    assert map_overlap(grid, cut) == (count, 0, 0)
    empty = OccupancyGrid(np.zeros_like(grid.cells), 0.05, grid.T_map_grid)
    assert map_overlap(grid, empty) == (0, count, 0)


@pytest.mark.parametrize("turned", [False, True])
def test_walls_of_both_maps_are_in_the_picture_however_far_apart(turned):
    near, far = np.zeros((20, 20), dtype=np.int8), np.zeros((20, 20), dtype=np.int8)
    near[5, 5] = far[15, 15] = 100
    far_off = SE2.from_xyt(8.0, -4.0, 0.0)
    grids = [OccupancyGrid(near, 0.05, SE2.identity()), OccupancyGrid(far, 0.05, far_off)]
    axes = walls(*(grids[::-1] if turned else grids), ("A", "B")).axes[0]
    for grid, cell in zip(grids, ([5, 5], [15, 15]), strict=True):
        x, y = grid.center_of(np.array(cell))
        assert axes.get_xlim()[0] < x < axes.get_xlim()[1]
        assert axes.get_ylim()[0] < y < axes.get_ylim()[1]


def test_a_comparison_says_how_both_were_made_and_whether_of_the_same_recording(tmp_path):
    record = fake_record(tmp_path / "record")
    a, b = fake_map(tmp_path / "a", record), fake_map(tmp_path / "b", record, sigma_m=0.01)
    with undrawn():
        found = compare_outputs([a, b], Output(tmp_path / "out"))
    page = (tmp_path / "out/index.html").read_text()
    assert "A: turtlebag map record --out A\nB: turtlebag map record --out B" in page
    assert found.pair.same_source is True
    assert compare_outputs([record, record]).pair.same_source is None


@pytest.mark.slow
def test_plans_and_estimates_are_drawn_over_each_other_too(tmp_path):
    record = fake_record(tmp_path / "record")
    built = fake_map(tmp_path / "map", record)
    for maker, name in ((fake_plan, "plan"), (fake_localise, "localise")):
        inputs = (record, built) if maker is fake_localise else (built,)
        one, other = (maker(tmp_path / f"{name}-{k}", *inputs) for k in "ab")
        compare_outputs([one, other], Output(tmp_path / f"compare-{name}"))
        assert (tmp_path / f"compare-{name}" / "figures" / "paths.svg").is_file()


def test_a_number_that_one_side_lacks_is_sorted_as_one_that_is_not_there(tmp_path):
    record = fake_record(tmp_path / "record")
    a, b = fake_map(tmp_path / "a", record), fake_map(tmp_path / "b", record)
    numbers = json.loads((b / "metrics.json").read_text())
    del numbers["ate_m"]
    (b / "metrics.json").write_text(json.dumps(numbers))
    with undrawn():
        compare_outputs([a, b], Output(tmp_path / "out"))
    page = (tmp_path / "out/index.html").read_text()
    assert 'data-sort=""' in page
    assert 'data-sort="None"' not in page
