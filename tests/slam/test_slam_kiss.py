"""KISS-ICP in our wrapper: its search radius, and its result without map or points."""

import math
from types import SimpleNamespace

import numpy as np
import pytest

from turtlebag.datasets.se2 import SE2, compose
from turtlebag.datasets.se3 import lifted
from turtlebag.pipeline.slam.odometry.kiss import VOXEL_M, KissIcp, LidarOdometry

POSTS = np.random.default_rng(0).uniform(-3.0, 3.0, (100, 2))


def test_what_a_wrong_guess_teaches_grows_with_the_lidar_s_range():
    """Vizzo et al. (2023), eq. 8: a guess off by an angle is off by its chord at the farthest point."""
    found = LidarOdometry(max_range=8.0)
    found.update(POSTS, np.array([0.0, 0.0, 0.1]), np.zeros(3))
    chord = 2.0 * 8.0 * math.sin(0.05)
    assert found.search_radius == pytest.approx(math.sqrt(((2.0 * VOXEL_M) ** 2 + chord**2) / 2.0))


def test_a_guess_near_the_truth_is_led_to_it():
    found = LidarOdometry(max_range=8.0)
    start, truth = np.array([1.0, -2.0, 0.5]), np.array([1.1, -1.9, 0.55])
    found.update(POSTS, start, start)
    seen = (SE2(truth).inverse() @ SE2(start)) @ POSTS
    answer = found.register(seen, start)
    assert np.hypot(*(answer - truth)[:2]) < 0.05
    assert answer[2] == pytest.approx(truth[2], abs=0.02)


def test_in_space_a_guess_near_the_truth_is_led_to_it_too():
    found, posts = LidarOdometry(max_range=8.0), np.random.default_rng(0).uniform(-3.0, 3.0, (400, 3))
    truth = lifted(SE2.from_xyt(0.04, -0.03, 0.02))
    truth[2, 3] = 0.05
    found.update(posts, np.eye(4), np.eye(4))
    answer = found.register((posts - truth[:3, 3]) @ truth[:3, :3], np.eye(4))
    np.testing.assert_allclose(answer, truth, atol=0.01)


def test_with_no_map_or_no_points_the_guess_is_the_answer():
    found, guess = LidarOdometry(max_range=8.0), np.array([1.0, 2.0, 0.3])
    assert np.array_equal(found.register(POSTS, guess), guess)
    found.update(POSTS, guess, guess)
    assert np.array_equal(found.register(POSTS[:2], guess), guess)


def test_where_the_answer_does_not_fit_the_pose_by_the_odometry_stands():
    tracker = SimpleNamespace(
        scan=1, pose=np.array([1.0, 2.0, 0.3]), velocity=np.array([0.5, 0.0, 0.1]), max_range=8.0,
        fit=lambda points, pose: 0.1, field_keys=lambda: ([0], [np.zeros(3)]),
        clouds=SimpleNamespace(of=lambda key: POSTS),
    )  # fmt: skip
    driven = np.array([0.2, 0.0, -0.1])
    placed = KissIcp(tracker).step(POSTS, driven, 0.2)
    np.testing.assert_allclose(placed.T_track_base, compose(tracker.pose, driven))
    assert not placed.information.any()
    by_speed = KissIcp(tracker).step(POSTS, None, 0.2)
    np.testing.assert_allclose(by_speed.T_track_base, compose(tracker.pose, tracker.velocity))
