"""A point against a line: distance, weight and derivatives, by definition and by finite differences."""

import math

import numpy as np
import pytest

from turtlebag.datasets.point_to_line import add_equation, linearise, of_the_line
from turtlebag.datasets.se2 import SE2

STEP = 1e-6


def case(seed):
    """A pose of a scan in the frame of a line, a point of it, the line's normal and a point on it."""
    rng = np.random.default_rng(seed)
    angle = rng.uniform(-math.pi, math.pi)
    return (
        rng.normal(0.0, 2.0, 3),
        rng.normal(0.0, 3.0, 2),
        np.array([math.cos(angle), math.sin(angle)]),
        rng.normal(size=2),
    )


def of(T_line_scan, point, normal, center, inv_sigma2=0.0):
    x, y, yaw = T_line_scan
    return linearise((x, y, math.cos(yaw), math.sin(yaw)), tuple(point), (*normal, *center), inv_sigma2)


def moved(T, delta):
    return (SE2(T) @ SE2(np.asarray(delta))).xyt


@pytest.mark.parametrize("seed", range(4))
def test_the_distance_is_along_the_normal_and_its_derivative_by_a_motion_of_the_scan(seed):
    T, point, normal, center = case(seed)
    e, _, j = of(T, point, normal, center)
    assert e == pytest.approx(normal @ (SE2(T) @ point - center))
    for k, d in enumerate(STEP * np.eye(3)):
        ahead, behind = (of(moved(T, way), point, normal, center)[0] for way in (d, -d))
        assert j[k] == pytest.approx((ahead - behind) / (2 * STEP), abs=1e-6)


@pytest.mark.parametrize("seed", range(4))
def test_the_other_derivative_is_by_a_motion_of_the_line(seed):
    T, point, normal, center = case(seed)
    j = of_the_line((T[0], T[1], math.cos(T[2]), math.sin(T[2])), tuple(point), tuple(normal))
    for k, d in enumerate(STEP * np.eye(3)):
        ahead, behind = (of((SE2(way).inverse() @ SE2(T)).xyt, point, normal, center)[0] for way in (d, -d))
        assert j[k] == pytest.approx((ahead - behind) / (2 * STEP), abs=1e-6)


@pytest.mark.parametrize(("off_sigmas", "weight"), [(0.0, 1.0), (1.0, 0.25), (-1.0, 0.25), (3.0, 0.01)])
def test_a_point_one_sigma_off_counts_a_quarter(off_sigmas, weight):
    e, w, j = of((0.0, 0.0, 0.0), (2.0, 0.05 * off_sigmas), (0.0, 1.0), (1.0, 0.0), 1.0 / 0.05**2)
    assert (e, w) == pytest.approx((0.05 * off_sigmas, weight))
    assert j == pytest.approx((0.0, 1.0, 2.0))


def test_equations_add_up_in_the_upper_half():
    h, g = np.ones((3, 3)), np.ones(3)
    j = np.array([0.5, -2.0, 3.0])
    add_equation(h, g, 4.0, tuple(j), 0.1)
    np.testing.assert_allclose(np.triu(h), np.triu(1.0 + 4.0 * np.outer(j, j)))
    np.testing.assert_array_equal(np.tril(h, -1), np.tril(np.ones((3, 3)), -1))
    np.testing.assert_allclose(g, 1.0 + 0.4 * j)
