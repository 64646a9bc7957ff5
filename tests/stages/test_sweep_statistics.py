"""Intervals, pairs and shares of a campaign's results, by what theory and others' tables say."""

import math

import numpy as np
import pytest

from turtlebag.pipeline.campaign.statistics import compare_pairs, summarise
from turtlebag.reports.metrics.statistics import LARGE, median_interval, paired, share_interval


def test_the_median_interval_covers_the_true_median_about_as_often_as_it_says():
    rng = np.random.default_rng(5)
    hits = 0
    for _ in range(100):
        found = median_interval(rng.exponential(size=30), rng)
        hits += found.low <= math.log(2.0) <= found.high
    assert 85 <= hits <= 100


def test_the_interval_of_many_values_is_that_of_the_resamples():
    """Of one value more no resample is drawn."""
    rng = np.random.default_rng(6)
    values = rng.exponential(size=LARGE)
    drawn = median_interval(values, rng)
    reckoned = median_interval(np.append(values, drawn.value), rng)
    assert (reckoned.n, reckoned.value) == (LARGE + 1, drawn.value)
    width = drawn.high - drawn.low
    assert abs(reckoned.low - drawn.low) < 0.1 * width
    assert abs(reckoned.high - drawn.high) < 0.1 * width
    many = median_interval(rng.exponential(size=1_000_000), rng)
    assert many.high - many.low == pytest.approx(2 * 1.96 / 1000.0, rel=0.1)  # what theory says


def test_wilsons_interval_is_the_published_one():
    found = share_interval(15, 20)
    assert (found.low, found.high) == (pytest.approx(0.531, abs=1e-3), pytest.approx(0.888, abs=1e-3))
    assert share_interval(20, 20).high == 1.0
    assert 0.8 < share_interval(20, 20).low < 0.9
    assert share_interval(0, 0).value is None


def test_pairs_see_a_small_shift_that_the_spread_hides():
    rng = np.random.default_rng(0)
    a = {key: float(rng.normal()) for key in range(40)}
    b = {key: value + 0.05 + float(rng.normal(scale=0.02)) for key, value in a.items()}
    found = paired(a, {**b, "alone": 9.0}, rng)
    assert found.difference.n == 40
    assert found.difference.low > 0.0
    assert found.less < 0.1


def test_failed_cases_count_against_a_share_and_not_in_a_median():
    rows = [
        {"f": "a", "failed": False, "good": True, "error_m": 1.0},
        {"f": "a", "failed": True, "good": None, "error_m": None},
        {"f": "b", "failed": False, "good": False, "error_m": 3.0},
    ]
    good, _, error, _ = summarise(rows, "f", ["good", "error_m"], 1)
    assert (good.kind, good.interval.value, good.failed) == ("share", 0.5, 1)
    assert (error.kind, error.interval.value, error.interval.n) == ("median", 1.0, 1)
    (pair,) = compare_pairs(rows[:1] + rows[2:], "f", "a", [], ["error_m"], 1)
    assert pair.found.difference.value == 2.0
