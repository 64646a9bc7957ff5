"""Beams are sent from where the base was, on arcs of constant twist between the knots of its motion."""

import numpy as np
import pytest
from scipy.linalg import expm, logm

from turtlebag.datasets.deskew import deskewed
from turtlebag.datasets.se2 import SE2

T_BASE_LIDAR = SE2.from_xyt(0.1, 0.05, 0.3)
ANGLES = np.linspace(-2.0, 2.0, 12)
FRACTIONS = np.arange(12) / 12


@pytest.mark.parametrize(
    "motion",
    [
        [(0.1, -0.03, 0.7)],
        [(0.1, 0.05, 0.0)],
        [(0.02, 0.0, -1e-12)],
        [(0.0, 0.0, 2.0)],
        [(0.1, 0.0, 0.4), (0.15, 0.1, 0.2), (0.1, 0.2, 1.0)],
    ],
)
def test_each_beam_is_sent_from_the_arc_between_two_knots(motion):
    knots = len(motion)
    origins, directions = deskewed(ANGLES, FRACTIONS, T_BASE_LIDAR.xyt, np.array(motion))
    poses = [np.eye(3), *(SE2.from_xyt(*knot).matrix() for knot in motion)]
    for i, fraction in enumerate(FRACTIONS):
        k = min(int(fraction * knots), knots - 1)
        twist = logm(np.linalg.solve(poses[k], poses[k + 1])).real
        T_lidar = poses[k] @ expm((fraction * knots - k) * twist) @ T_BASE_LIDAR.matrix()
        np.testing.assert_allclose(origins[i], T_lidar[:2, 2], atol=1e-8)
        beam = [np.cos(ANGLES[i]), np.sin(ANGLES[i])]
        np.testing.assert_allclose(directions[i], T_lidar[:2, :2] @ beam, atol=1e-8)


def test_no_beams_are_no_beams():
    origins, directions = deskewed(ANGLES[:0], FRACTIONS[:0], T_BASE_LIDAR.xyt, np.zeros((1, 3)))
    assert origins.shape == directions.shape == (0, 2)
