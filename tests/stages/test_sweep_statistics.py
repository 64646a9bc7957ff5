"""Intervals, pairs and shares of a campaign's results, by what theory and others' tables say."""

import numpy as np
import pytest

from turtlebag.pipeline.campaign.statistics import compare_pairs, summarise
from turtlebag.reports.metrics.statistics import share_interval


def test_wilsons_interval_is_the_published_one():
    found = share_interval(15, 20)
    assert (found.low, found.high) == (pytest.approx(0.531, abs=1e-3), pytest.approx(0.888, abs=1e-3))
    assert share_interval(20, 20).high == 1.0
    assert 0.8 < share_interval(20, 20).low < 0.9
    assert share_interval(0, 0).value is None


def paired_rows(shift, rng, seeds=3):
    """Two systems on the same seeds, the second off by `shift` and a scatter of 0.02."""
    rows = []
    for seed in range(seeds):
        error_m = float(rng.normal())
        for system, off_m in (("a", 0.0), ("b", shift + float(rng.normal(scale=0.02)))):
            rows.append({"system": system, "seed": seed, "error_m": error_m + off_m})
    return rows


def test_three_seeds_call_a_difference_that_is_none_clear_once_in_twenty_times():
    rng = np.random.default_rng(5)
    clear = sum(
        compare_pairs(paired_rows(0.0, rng), "system", "a", ["seed"], ["error_m"])[0].differs
        for _ in range(400)
    )
    assert 8 <= clear <= 36


def test_pairs_see_a_small_shift_that_the_spread_hides():
    rows = [*paired_rows(0.05, np.random.default_rng(0), 40), {"system": "b", "seed": 99, "error_m": 9.0}]
    (pair,) = compare_pairs(rows, "system", "a", ["seed"], ["error_m"])
    assert (pair.difference.n, pair.differs) == (40, True)
    assert pair.difference.low > 0.0
    assert pair.less < 0.1


def test_failed_cases_count_against_a_share_and_not_in_a_mean():
    rows = [
        {"f": "a", "failed": False, "good": True, "error_m": 1.0},
        {"f": "a", "failed": True, "good": None, "error_m": None},
        {"f": "b", "failed": False, "good": False, "error_m": 3.0},
    ]
    good, _, error, _ = summarise(rows, "f", ["good", "error_m"])
    assert (good.kind, good.interval.value, good.failed) == ("share", 0.5, 1)
    assert (error.kind, error.interval.value, error.interval.n) == ("mean", 1.0, 1)
    (pair,) = compare_pairs(rows[:1] + rows[2:], "f", "a", [], ["error_m"])
    assert pair.difference.value == 2.0
