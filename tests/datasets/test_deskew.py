"""Each beam starts from the base's pose at its time, on arcs of constant twist between the knots of the
motion."""

import numpy as np
import pytest
from scipy.linalg import expm, logm

from turtlebag.datasets import se3
from turtlebag.datasets.deskew import deskewed, deskewed_points
from turtlebag.datasets.se2 import SE2

T_BASE_LIDAR = SE2.from_xyt(0.1, 0.05, 0.3)
ANGLES = np.linspace(-2.0, 2.0, 12)
BEAMS = np.column_stack([np.cos(ANGLES), np.sin(ANGLES)])
FRACTIONS = np.arange(12) / 12


@pytest.mark.parametrize(
    "motion",
    [
        [(0.1, -0.03, 0.7)],
        [(0.1, 0.05, 0.0)],
        [(0.02, 0.0, -1e-12)],
        [(0.0, 0.0, 2.0)],
        [(0.1, 0.0, 0.4), (0.15, 0.1, 0.2), (0.1, 0.2, 1.0)],
        [(0.1, 0.0, 1.6), (0.15, 0.1, 3.1), (0.1, 0.2, -2.9)],
    ],
)
def test_each_beam_is_sent_from_the_arc_between_two_knots(motion):
    knots = len(motion)
    origins, directions = deskewed(BEAMS, FRACTIONS, T_BASE_LIDAR.xyt, np.array(motion))
    poses = [np.eye(3), *(SE2.from_xyt(*knot).matrix() for knot in motion)]
    for i, fraction in enumerate(FRACTIONS):
        k = min(int(fraction * knots), knots - 1)
        twist = logm(np.linalg.solve(poses[k], poses[k + 1])).real
        T_lidar = poses[k] @ expm((fraction * knots - k) * twist) @ T_BASE_LIDAR.matrix()
        np.testing.assert_allclose(origins[i], T_lidar[:2, 2], atol=1e-8)
        np.testing.assert_allclose(directions[i], T_lidar[:2, :2] @ BEAMS[i], atol=1e-8)


def test_the_order_of_the_beams_does_not_matter():
    motion = np.array([(0.1, 0.0, 0.4), (0.15, 0.1, 0.2), (0.1, 0.2, 1.0)])
    forth = deskewed(BEAMS, FRACTIONS, T_BASE_LIDAR.xyt, motion)
    back = deskewed(BEAMS[::-1].copy(), FRACTIONS[::-1].copy(), T_BASE_LIDAR.xyt, motion)
    for one, other in zip(forth, back, strict=True):
        assert np.array_equal(one, other[::-1])


def test_no_beams_are_no_beams():
    origins, directions = deskewed(BEAMS[:0], FRACTIONS[:0], T_BASE_LIDAR.xyt, np.zeros((1, 3)))
    assert origins.shape == directions.shape == (0, 2)


def test_each_point_of_a_cloud_is_seen_from_where_the_sweep_started():
    rng = np.random.default_rng(4)
    twist = np.array([0.02, -0.03, 0.2, 0.1, 0.02, -0.01])
    still, when = rng.normal(size=(50, 3)) * 3.0, rng.uniform(size=50)
    knots = np.linspace(0.0, 1.0, 9)[:, None] * twist
    poses = se3.exp(when[:, None] * twist)
    taken = np.array([se3.moved(se3.inverse(T), p[None])[0] for T, p in zip(poses, still, strict=True)])
    np.testing.assert_allclose(deskewed_points(taken, when, knots), still, atol=1e-9)


def test_a_scan_and_a_cloud_of_the_same_beams_are_deskewed_alike():
    motion = SE2.from_xyt(0.1, -0.03, 0.7)
    origins, directions = deskewed(BEAMS, FRACTIONS, T_BASE_LIDAR.xyt, motion.xyt[None])
    ends = np.column_stack([T_BASE_LIDAR @ (2.0 * BEAMS), np.full(12, 0.2)])
    knots = np.stack([np.zeros(6), se3.log(se3.lifted(motion))])
    expected = np.column_stack([origins + 2.0 * directions, np.full(12, 0.2)])
    np.testing.assert_allclose(deskewed_points(ends, FRACTIONS, knots), expected, atol=1e-9)


def test_the_last_point_of_a_sweep_reads_nothing_beyond_the_last_knot():
    knots = np.zeros((4, 6))
    knots[1:3, 3] = 1.0, 2.0
    knots[3] = np.nan
    moved = deskewed_points(np.zeros((3, 3)), np.array([0.25, 1.0, 2.0]), knots[:3])
    np.testing.assert_allclose(moved, [[0.5, 0.0, 0.0], [2.0, 0.0, 0.0], [2.0, 0.0, 0.0]], atol=1e-12)
