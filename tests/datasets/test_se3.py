"""Transforms in space against SciPy's."""

import math

import numpy as np
import pytest
from scipy.linalg import expm
from scipy.spatial.transform import Rotation

from turtlebag.datasets import se3
from turtlebag.datasets.se2 import SE2


@pytest.mark.parametrize("size", [0.0, 1e-9, 1e-4, 0.5, 2.0, 3.1])
def test_tangent_vectors_and_transforms_are_those_of_scipy(size):
    rng = np.random.default_rng(int(size * 10))
    w = rng.normal(size=(5, 3))
    w *= size / np.linalg.norm(w, axis=1)[:, None]
    xi = np.column_stack([w, rng.normal(size=(5, 3))])
    T = se3.exp(xi)
    for one, made in zip(xi, T, strict=True):
        hat = np.zeros((4, 4))
        hat[:3, :3], hat[:3, 3] = se3.skew(one[:3]), one[3:]
        np.testing.assert_allclose(made, expm(hat), atol=1e-9)
    np.testing.assert_allclose(se3.log(T), xi, atol=1e-7)
    np.testing.assert_allclose(se3.inverse(T) @ T, np.tile(np.eye(4), (5, 1, 1)), atol=1e-12)
    np.testing.assert_allclose(se3.interpolate(T, T @ T, np.full(5, 0.5)), T @ se3.exp(0.5 * xi), atol=1e-6)
    expected = Rotation.from_matrix(T[:, :3, :3]).as_quat()
    found = se3.quaternions(T)
    np.testing.assert_allclose(
        found * np.sign(np.sum(found * expected, axis=1))[:, None], expected, atol=1e-8
    )
    np.testing.assert_allclose(np.cross(w[0], w[1]), se3.skew(w[:1])[0] @ w[1], atol=1e-12)
    points = rng.normal(size=(4, 3))
    np.testing.assert_allclose(se3.moved(T[0], points), [(T[0] @ [*p, 1.0])[:3] for p in points])


def test_a_planar_pose_is_lifted_into_space_and_back():
    flat = SE2(np.random.default_rng(6).normal(size=(4, 3)))
    lifted = se3.lifted(flat)
    points = np.random.default_rng(7).normal(size=(3, 2))
    for k in range(4):
        np.testing.assert_allclose(
            se3.moved(lifted[k], np.column_stack([points, np.ones(3)]))[:, :2], flat[k] @ points
        )
        np.testing.assert_array_equal(lifted[k][2], [0.0, 0.0, 1.0, 0.0])
        np.testing.assert_array_equal(lifted[k][3], [0.0, 0.0, 0.0, 1.0])
    np.testing.assert_allclose(se3.planar(lifted).xyt, flat.xyt)
    # half turns about each axis, where one part of the quaternion alone is left
    for axis in np.eye(3):
        T = np.eye(4)
        T[:3, :3] = Rotation.from_rotvec(math.pi * axis).as_matrix()
        np.testing.assert_allclose(np.abs(se3.quaternions(T)), [*axis, 0.0], atol=1e-9)
