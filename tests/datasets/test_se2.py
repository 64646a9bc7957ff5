"""SE2 obeys the axioms of a group, over batches."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from hypothesis.extra.numpy import arrays

from turtlebag.datasets.se2 import SE2, wrap

finite = st.floats(-100.0, 100.0)


def poses(*shape: int) -> st.SearchStrategy[SE2]:
    return arrays(np.float64, (*shape, 3), elements=finite).map(SE2.from_array)


def assert_same(a: SE2, b: SE2) -> None:
    np.testing.assert_allclose(a.xy, b.xy, atol=1e-9)
    np.testing.assert_allclose(wrap(a.yaw - b.yaw), 0.0, atol=1e-9)


@pytest.mark.slow
@given(poses(4), poses(4), poses(4))
def test_composition_is_associative(a, b, c):
    assert_same((a @ b) @ c, a @ (b @ c))


@given(poses(4))
def test_inverse_composes_to_identity_on_both_sides(a):
    assert_same(a @ a.inverse(), SE2.identity(4))
    assert_same(a.inverse() @ a, SE2.identity(4))


@given(poses(3), arrays(np.float64, (3, 2), elements=finite))
def test_moving_points_agrees_with_homogeneous_matrices(a, points):
    homogeneous = np.concatenate([points, np.ones((3, 1))], axis=1)
    expected = np.einsum("nij,nj->ni", a.matrix(), homogeneous)[:, :2]
    np.testing.assert_allclose(a @ points, expected, atol=1e-9)


@pytest.mark.slow
@given(poses(3), poses(3))
def test_interpolation_starts_and_ends_at_its_poses(a, b):
    assert_same(a.interpolate(b, 0.0), a)
    assert_same(a.interpolate(b, np.ones(3)), b)


@given(poses(5))
def test_matrix_round_trip(a):
    assert_same(SE2.from_matrix(a.matrix()), a)


def test_each_pose_moves_all_points_through_an_inserted_axis():
    moved = SE2.from_xyt([0.0, 1.0], [0.0, 0.0], [0.0, np.pi / 2])[:, None] @ np.array([[1.0, 0.0]] * 3)
    np.testing.assert_allclose(moved[0], [[1.0, 0.0]] * 3)
    np.testing.assert_allclose(moved[1], [[1.0, 1.0]] * 3, atol=1e-12)


def test_interpolation_takes_the_short_way_across_pi():
    a, b = SE2.from_xyt(0, 0, 3.1), SE2.from_xyt(0, 0, -3.1)
    assert abs(a.interpolate(b, 0.5).yaw) == pytest.approx(np.pi)


def test_yaw_is_wrapped_to_half_open_interval():
    assert wrap(np.pi) == -np.pi
    assert SE2.from_xyt(0, 0, 7.0).yaw == pytest.approx(7.0 - 2 * np.pi)


def test_wrong_shape_is_refused():
    with pytest.raises(ValueError, match="shape"):
        SE2.from_array(np.zeros((3, 2)))


def test_steps_lead_from_each_pose_to_the_next():
    T = SE2.from_array(np.random.default_rng(3).normal(0.0, 2.0, (6, 3)))
    steps = T.steps()
    assert steps.shape == (5, 3)
    for k, step in enumerate(steps):
        np.testing.assert_allclose((T[k] @ SE2(step)).xyt, T[k + 1].xyt, atol=1e-12)
    assert T[:1].steps().shape == (0, 3)
