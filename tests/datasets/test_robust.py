"""Robust statistics, by definition and against samples with wild values."""

import numpy as np
import pytest
import scipy

from turtlebag.datasets.robust import cauchy_cost, cauchy_weight, not_negative, sigma_by_median


def test_a_tenth_of_wild_values_hardly_moves_the_standard_deviation():
    errors = np.random.default_rng(0).normal(0.0, 0.2, (20_000, 2))
    np.testing.assert_allclose(sigma_by_median(errors, axis=0), 0.2, rtol=0.03)
    errors[::10] = 50.0
    assert 0.2 < sigma_by_median(errors) < 0.25


@pytest.mark.parametrize(
    ("sigmas", "weight", "cost"), [(0.0, 1.0, 0.0), (2.0, 0.5, np.log(2.0)), (6.0, 0.1, np.log(10.0))]
)
def test_two_standard_deviations_off_an_error_counts_half(sigmas, weight, cost):
    assert cauchy_weight(np.array([sigmas**2])) == pytest.approx([weight])
    assert cauchy_cost(np.array([sigmas**2])) == pytest.approx([cost])


def test_the_weight_is_the_slope_of_the_cost():
    squares, h = np.linspace(0.0, 30.0, 7), 1e-6
    slope = (cauchy_cost(squares + h) - cauchy_cost(squares)) / h
    np.testing.assert_allclose(slope / slope[0], cauchy_weight(squares), rtol=1e-5)


def test_least_squares_without_negative_parts_are_those_of_lawson_and_hanson():
    rng, zeros = np.random.default_rng(3), 0
    for _ in range(50):
        rows, wanted = rng.normal(size=(8, 3)), rng.normal(size=8)
        found = not_negative(rows, wanted)
        np.testing.assert_allclose(found, scipy.optimize.nnls(rows, wanted)[0], atol=1e-12)
        zeros += np.count_nonzero(found == 0.0)
    assert zeros > 30
