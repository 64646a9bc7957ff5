"""Several runs a side: what differs beyond the spread over them, and what does not."""

import json
import re
from itertools import count

import numpy as np
import pytest

import turtlebag as tb
from turtlebag.datasets.errors import InputError
from turtlebag.datasets.outputs import Output, write_json, write_manifest
from turtlebag.pipeline.cli.main import main
from turtlebag.pipeline.stages.compare import compare_outputs
from turtlebag.reports.metrics.statistics import mean_difference, mean_interval, share_difference

ATE, WALLS = "ate_m.rmse", "map.occupied_error_m.within_one_cell"
SOURCES = count()


def run(folder, ate_m, share, *, recording=None, sigma=0.1):
    """A map's output with two numbers, of a recording with a seed or of another log."""
    folder.mkdir(parents=True)
    walls = {"occupied_error_m": {"within_one_cell": share}}
    write_json(folder / "metrics.json", {"ate_m": {"rmse": ate_m}, "map": walls})
    (folder / "config.yaml").write_text(f"sigma: {sigma}\nnoise: {ate_m}\n")
    if recording is None:
        source = folder.parent / f"log{next(SOURCES)}.txt"
        source.write_text(str(source))
    else:
        source = folder.parent.parent / f"rec-{folder.parent.name}-{recording}"
        (source / "bag").mkdir(parents=True)
        (source / "bag/log.txt").write_text(str(source))
        write_manifest(source, "record", ["turtlebag", "record"], {}, seed=recording, wall_s=1.0)
    command = ["turtlebag", "map", str(source), "--out", str(folder)]
    write_manifest(folder, "map", command, {"source": source}, seed=None, wall_s=1.0)


def side(folder, ates, shares, *, seeds=None, sigma=0.1):
    for k, (ate_m, share) in enumerate(zip(ates, shares, strict=True)):
        run(folder / f"run{k}", ate_m, share, recording=None if seeds is None else seeds[k], sigma=sigma)
    return folder


A_ATE, B_ATE = (0.010, 0.030, 0.050), (0.015, 0.036, 0.054)
A_WALLS, B_WALLS = (0.90, 0.95, 0.92), (0.93, 0.91, 0.94)


@pytest.fixture
def sides(tmp_path):
    """Worse by 5 mm in each of three pairs, though seeds differ by more; the walls are neither."""
    a = side(tmp_path / "usual", A_ATE, A_WALLS, seeds=(1, 2, 3))
    b = side(tmp_path / "rough", B_ATE[::-1], B_WALLS[::-1], seeds=(3, 2, 1), sigma=0.2)
    return a, b


def row(found, path):
    return next(one for one in found.rows if one.spec.path == path)


def test_a_clear_difference_in_pairs_of_one_seed_is_worse_and_an_unclear_one_is_within_the_spread(sides):
    found = compare_outputs(sides)
    ate, walls = row(found, ATE), row(found, WALLS)
    assert [(one.median, one.worst) for one in ate.summaries] == [(0.030, 0.050), (0.036, 0.054)]
    assert [one.worst for one in walls.summaries] == [0.90, 0.91]
    (clear,), (unclear,) = ate.differences, walls.differences
    assert clear.pairs
    assert unclear.pairs
    mean, half = 0.005, 4.30265 * 0.001 / np.sqrt(3.0)
    assert (clear.interval.low, clear.interval.high) == pytest.approx((mean - half, mean + half), rel=1e-4)
    assert (clear.verdict, unclear.verdict) == ("worse", "within the spread")
    assert found.sentences == ["B against A (3 pairs by seed): 1 worse, 1 within the spread."]
    assert row(compare_outputs(sides[::-1]), ATE).differences[0].verdict == "better"


def test_without_pairs_the_same_numbers_are_within_the_spread(tmp_path):
    found = compare_outputs([side(tmp_path / "a", A_ATE, A_WALLS), side(tmp_path / "b", B_ATE, B_WALLS)])
    (difference,) = row(found, ATE).differences
    assert (difference.pairs, difference.verdict) == (False, "within the spread")
    assert found.sentences == ["B against A (not in pairs): 2 within the spread."]


def test_seeds_that_only_one_side_has_are_in_no_pair(tmp_path, sides):
    more = side(tmp_path / "more", (9.0, *B_ATE), (0.1, *B_WALLS), seeds=(7, 1, 2, 3))
    (difference,) = row(compare_outputs([sides[0], more]), ATE).differences
    assert (difference.interval.n, difference.verdict) == (3, "worse")


def test_one_run_a_side_has_no_spread(tmp_path, sides):
    one = side(tmp_path / "one", (9.0,), (0.1,), seeds=(1,))
    found = compare_outputs([sides[0], one, one / "run0"])
    assert [part.verdict for part in row(found, ATE).differences] == ["no spread"] * 2
    assert found.sentences[0] == "B against A: one run of B: no spread, so no difference is judged."
    assert found.sides[2].title == "C: run0 (1 run)"


def test_the_page_colours_only_what_is_clear(sides, tmp_path):
    compare_outputs(sides, Output(tmp_path / "out"))
    page = (tmp_path / "out/index.html").read_text()
    [table] = re.findall(r'<table class="sortable.*?</table>', page, flags=re.DOTALL)
    assert (table.count("good-number"), table.count("bad-number")) == (0, 1)
    assert "A: usual (3 runs); B: rough (3 runs)" in page
    assert "<td>0.1</td><td>0.2</td>" in page
    metrics = json.loads((tmp_path / "out/metrics.json").read_text())
    assert metrics["sides"]["A"]["numbers"][ATE]["values"] == list(A_ATE)
    assert metrics["differences"]["B"][ATE]["verdict"] == "worse"


def test_the_command_prints_systems_beside_each_other(sides, capsys):
    a, b = sides
    assert main(["compare", str(a), str(b), str(a)]) == 0
    lines = capsys.readouterr().out.splitlines()
    assert lines[:3] == ["A: usual (3 runs)", "B: rough (3 runs)", "C: usual (3 runs)"]
    assert lines[-1] == "C against A (3 pairs by seed): 2 the same."


def test_what_is_no_side_is_said_in_a_line(sides, tmp_path):
    (tmp_path / "empty").mkdir()
    with pytest.raises(InputError, match=r"empty: is no finished output, and holds none$"):
        compare_outputs([sides[0], tmp_path / "empty"])
    with pytest.raises(InputError, match="nothing to compare"):
        compare_outputs([sides[0], tmp_path / "rec-usual-1"])
    with pytest.raises(InputError, match="at most 26 systems, not 27"):
        compare_outputs([sides[0]] * 27)


def test_intervals_of_few_runs_hold_what_they_say():
    """Of samples of three without a difference, one in twenty is called different, not one in four."""
    rng = np.random.default_rng(1)
    samples = rng.normal(size=(2000, 2, 3))
    for intervals in (
        [mean_interval(b - a) for a, b in samples],
        [mean_difference(a, b) for a, b in samples],
    ):
        called = np.mean([one.low > 0.0 or one.high < 0.0 for one in intervals])
        assert 0.02 < called < 0.065


def test_numbers_that_nobody_measures_are_left_out_or_the_same(tmp_path, capsys):
    """Squares of the large ones overflow, of the small ones vanish."""
    a = side(tmp_path / "a", (1e308, -9e99, 0.1), (0.0, 1e-170, 2e-170))
    b = side(tmp_path / "b", (-1e308, 0.2, 9e99), (1e-170, 0.0, 3e-170))
    assert main(["compare", str(a), str(b)]) == 0
    said = capsys.readouterr()
    assert "(1 of 3)" in said.out
    assert said.err == ""
    assert said.out.splitlines()[-1] == "B against A (not in pairs): 2 no spread."


def test_what_does_not_vary_and_what_is_single_has_no_interval():
    assert mean_interval(np.array([0.3 - 0.2, 0.1, 0.1])).low is None
    assert mean_difference(np.array([1.0]), np.array([1.0, 2.0])).low is None
    assert mean_difference(np.ones(3), np.zeros(3)).low is None
    assert mean_interval(np.zeros(0)).value is None


def test_shares_differ_by_newcombes_interval():
    """Newcombe 1998, table II: 56/70 minus 48/80 is 0.2000, from 0.0524 to 0.3339."""
    a, b = np.arange(80) < 48, np.arange(70) < 56
    found = share_difference(a, b)
    assert (found.value, found.low, found.high) == pytest.approx((0.2, 0.0524, 0.3339), abs=1e-4)


def test_two_runs_of_one_seed_on_a_side_leave_no_pairs(sides, tmp_path):
    twice = side(tmp_path / "twice", (*B_ATE, 0.04), (*B_WALLS, 0.9), seeds=(1, 2, 3, 4))
    (tmp_path / "rec-twice-4/manifest.json").write_text((tmp_path / "rec-twice-1/manifest.json").read_text())
    (difference,) = row(compare_outputs([sides[0], twice]), ATE).differences
    assert (difference.pairs, difference.verdict) == (False, "within the spread")


def test_python_gives_the_medians_and_the_sentence(sides):
    found = tb.compare(*sides)
    numbers = found.numbers
    assert numbers["B"][numbers["number"].tolist().index(ATE)] == 0.036
    assert found.verdict == "B against A (3 pairs by seed): 1 worse, 1 within the spread."
