"""How the truth of covariances and of p_bad is counted."""

from pathlib import Path

import numpy as np
import pytest

from benchmarks.coverage import (
    EVERY,
    coverage,
    detection,
    distances,
    disturbed_cases,
    judged,
    localise_cases,
    map_cases,
)
from benchmarks.disturb import KINDS, SCORED
from benchmarks.kept_drives import DRIVES, mishap_of
from benchmarks.p_bad import PRIOR, fitted, threshold
from turtlebag.datasets.se2 import SE2
from turtlebag.pipeline.slam.check.p_bad import WEIGHTS


def test_there_are_five_hundred_maps_and_two_halves_of_kinds():
    cases = [*map_cases(Path()), *disturbed_cases(Path())]
    assert len(cases) == len({case.name for case in cases}) >= 500
    assert set(SCORED) < set(KINDS)
    assert 10 <= len(SCORED) <= len(KINDS) - 10
    plain = {case.about["half"] for case in cases if case.about["kind"] == "plain"}
    assert plain == {"build", "score"}
    assert {case.about["kind"] for case in cases} >= set(KINDS)
    kinds = [mishap_of(number) for number in range(DRIVES)]
    assert min(kinds.count(kind) for kind in set(kinds)) >= 37
    assert {case.about["kind"] for case in localise_cases(Path())} == set(kinds)


def test_distances_are_those_of_each_twentieth_pose():
    rng, n = np.random.default_rng(1), 20_001
    truth = SE2(np.zeros((n, 3)))
    off = rng.standard_normal((n, 3)) * [0.1, 0.2, 0.05]
    off[0] = 0.0
    covariance = np.tile(np.diag(np.square([0.1, 0.2, 0.05])), (n, 1, 1))
    found = distances(SE2(off), covariance, truth)
    assert len(found["d2"]) == (n - 1) // EVERY
    assert np.mean(np.array(found["d2"]) < 5.991) == pytest.approx(0.95, abs=0.02)
    assert np.mean(np.array(found["d3"]) < 7.815) == pytest.approx(0.95, abs=0.02)
    (line, *_) = coverage([{"world": "w", "robot": "r", "kind": "k", **found}])
    assert line["xy"].startswith(f"{sum(d < 5.991 for d in found['d2'])} of 1000")


def a_row(worst, verdict, kind="plain", half="build", within=1.0):
    about = {"world": "w", "robot": "r", "kind": kind, "half": half}
    terms = {"contradicted": 1.0 if verdict == "doubtful" else 0.0}
    return {**about, "worst_m": worst, "within": within, "check": {"terms": terms}}


def test_bad_is_far_off_or_five_times_the_median_of_its_own_world_or_has_walls_elsewhere():
    rows = [a_row(0.01, "good")] * 3 + [a_row(0.06, "good", "late"), a_row(0.3, "doubtful", "third", "score")]
    rows += [a_row(0.01, "good", "floor", "score", within=0.89)]
    assert [row["bad"] for row in judged(rows)] == [False] * 3 + [True] * 3
    assert [row["bad"] for row in judged(rows[3:])] == [False, True, True]  # no undisturbed maps to compare
    failed = {"error": "x", "world": "w", "robot": "r", "kind": "plain", "half": "build"}
    lines = {line["maps"]: line for line in detection(judged([*rows, failed]))}
    assert lines["all"]["n"] == 6
    assert lines["build"]["bad ones missed"].startswith("1 of 1")
    assert lines["score"]["bad ones missed"].startswith("1 of 2")


def test_the_likeliest_weights_are_found_and_none_is_below_zero():
    rng = np.random.default_rng(1)
    X = rng.uniform(0.0, 3.0, (4000, len(WEIGHTS)))
    true = np.linspace(-0.3, 1.0, len(WEIGHTS))
    bad = rng.random(4000) < 1.0 / (1.0 + np.exp(6.0 - X @ np.maximum(true, 0.0)))
    base, weights = fitted(X, bad)
    assert base == pytest.approx(-6.0, abs=1.5)
    assert (weights >= 0.0).all()
    np.testing.assert_allclose(weights, np.maximum(true, 0.0), atol=0.5)
    never = fitted(np.zeros((10, len(WEIGHTS))), np.zeros(10, dtype=bool))[1]
    np.testing.assert_allclose(never, list(PRIOR.values()), atol=1e-3)
    assert threshold(np.array([0.1, 0.2, 0.3, 0.9]), np.array([False, False, False, True])) <= 0.3
