"""The filter's decisions one by one, by their formulas: shares, pauses, averages, resampling, searches."""

import copy
import math

import numpy as np
import pytest

from tests.helpers.localisation_room import LIDAR
from tests.localisation.filter_room import PLACE, beams_at, made, scan_at
from turtlebag.datasets.se2 import SE2, wrap
from turtlebag.pipeline.localisation import lost_detection, resampling
from turtlebag.pipeline.localisation.estimate import Estimate
from turtlebag.pipeline.localisation.lost_detection import AgreementWatch
from turtlebag.pipeline.localisation.parameters import AmclConfig


def test_the_limits_of_the_ranges_are_the_lidars_or_narrower():
    assert AmclConfig().range_limits(LIDAR) == (LIDAR.range_min, LIDAR.range_max)
    assert AmclConfig(laser_min_range=0.5, laser_max_range=2.0).range_limits(LIDAR) == (0.5, 2.0)
    assert AmclConfig(laser_min_range=0.0, laser_max_range=99.0).range_limits(LIDAR) == (0.0, 3.5)
    filter_ = made(laser_max_range=2.0)
    assert filter_.search.range_max == 2.0


def test_a_cloud_is_drawn_about_the_pose_it_was_told():
    filter_ = made(max_particles=20000, initial_cov_xx=0.04, initial_cov_yy=0.09, initial_cov_aa=0.01)
    odometry = SE2.from_xyt(-1.0, 3.0, 2.0)
    told = SE2.from_xyt(2.0, 2.0, 3.1)
    filter_.initialise(told, None, odometry)
    off = filter_.particles.xyt - told.xyt
    off[:, 2] = wrap(off[:, 2])
    np.testing.assert_allclose(off.mean(axis=0), 0.0, atol=0.01)
    np.testing.assert_allclose(np.cov(off.T), np.diag([0.04, 0.09, 0.01]), atol=0.002)
    assert np.abs(filter_.particles.yaw).max() <= math.pi
    np.testing.assert_allclose(filter_.T_map_base(odometry).xyt, told.xyt, atol=1e-12)
    np.testing.assert_allclose(filter_._cloud.weights, 1.0 / 20000)
    assert (filter_.size, filter_.initialised, filter_.converged, filter_.lost) == (20000, True, False, True)
    given = np.array([[0.01, 0.005, 0.0], [0.005, 0.01, 0.0], [0.0, 0.0, 0.0]])
    filter_.initialise(told, given)
    np.testing.assert_allclose(np.cov((filter_.particles.xyt - told.xyt).T), given, atol=5e-4)
    with pytest.raises(ValueError, match="no pose yet"):
        _ = filter_.covariance
    filter_._at.estimate = Estimate(told, np.eye(3), 2.0 * np.eye(3))
    np.testing.assert_array_equal(filter_.covariance, 2.0 * np.eye(3))


@pytest.mark.parametrize(
    ("std", "converged"),
    [
        ((0.1, 0.1, 0.05), True),
        ((0.151, 0.1, 0.05), False),
        ((0.1, 0.151, 0.05), False),
        ((0.1, 0.1, 0.101), False),
        ((0.149, 0.149, 0.099), True),
    ],
)
def test_a_cloud_has_converged_when_it_is_narrow_in_place_and_heading(std, converged):
    filter_ = made()
    filter_._at.estimate = Estimate(PLACE, np.zeros((3, 3)), np.diag(np.square(std)))
    assert filter_.converged == converged
    assert filter_.lost == (not converged)
    filter_.watch.fast = 0.5 * filter_.watch.slow
    assert filter_.lost


def test_random_particles_are_mixed_in_by_how_far_agreement_has_fallen():
    filter_ = made()
    filter_.watch.slow = 0.8
    for fast, share in ((0.8, 0.0), (0.601, 0.0), (0.59, 1 - 0.59 / 0.8), (0.3, 1 - 0.3 / 0.8)):
        filter_.watch.fast = fast
        assert filter_.watch.random_share() == pytest.approx(share)
        assert filter_.agrees == (share == 0.0)
        assert filter_.agreement == fast
    off = made(recovery_alpha_slow=0.0)
    off.watch.fast = 0.1
    assert off.watch.random_share() == 0.0


def test_the_averages_follow_the_agreement_each_at_its_rate():
    filter_ = made(recovery_alpha_slow=0.01, recovery_alpha_fast=0.2)
    slow = fast = lost_detection.NOMINAL_AGREEMENT
    best = 0.0
    for agreement in (0.9, 0.95, 0.2, 0.4):
        filter_.watch.update(agreement)
        slow, fast = slow + 0.01 * (agreement - slow), fast + 0.2 * (agreement - fast)
        best = max(best, fast)
        assert (filter_.watch.slow, filter_.watch.fast, filter_.watch.best) == pytest.approx(
            (slow, fast, best)
        )
    filter_.watch.anywhere = True
    filter_.watch.update(0.7)
    assert filter_.watch.fast == 0.7


def test_searches_come_at_intervals_while_scans_agree_less_than_they_once_did():
    filter_ = made()
    filter_.watch.slow, filter_.watch.fast = 0.8, 0.4
    looked = []
    for update in range(130):
        filter_.watch.updates = update
        share = filter_.watch.search_share()
        assert share in (0.0, 0.5)
        if share:
            looked.append(update)
    assert looked == [0, 32, 64, 96, 128]
    filter_.watch.fast = 0.8
    assert filter_.watch.search_share() == 0.0
    filter_.watch.anywhere = True
    assert filter_.watch.search_share() == 1.0
    # faded, not lost: a look now and then
    again = made()
    again.watch.slow, again.watch.fast, again.watch.best = 0.8, 0.71, 0.8
    looked = [u for u in range(60) if (setattr(again.watch, "updates", u), again.watch.search_share())[1]]
    assert looked == [0, 32]
    again.watch.fast = 0.721
    again.watch.updates = 500
    assert again.watch.search_share() == 0.0


def test_the_robot_has_moved_enough_by_its_way_or_by_its_turn():
    filter_ = made(update_min_d=0.2, update_min_a=0.3)
    still = SE2.identity()
    assert filter_._moved_enough(still)
    filter_.watch.updates = 1
    assert filter_._moved_enough(None)
    for xyt, moved in (
        ((0.12, 0.16, 0.0), True), ((0.12, 0.15, 0.29), False), ((0.0, 0.0, 0.3), True),
        ((0.0, 0.0, -0.31), True), ((-0.2, 0.0, 0.0), True), ((0.0, -0.19, -0.29), False),
    ):  # fmt: skip
        assert filter_._moved_enough(SE2(np.array(xyt))) == moved


def test_weights_are_multiplied_by_the_sensors_while_it_agrees_and_by_the_paths_while_lost():
    filter_ = made(max_particles=200, min_particles=10)
    filter_.initialise(PLACE, np.diag([1e-3, 1e-3, 1e-3]))
    beams = beams_at(PLACE)
    before = np.random.default_rng(2).random(200)
    for lost in (True, False):
        filter_._cloud.weights = before / before.sum()
        if not lost:
            filter_._at.estimate = Estimate(PLACE, np.zeros((3, 3)), np.zeros((3, 3)))
        assert filter_.lost == lost
        source = filter_.search.log_likelihood if lost else filter_._sensor.weigh
        expected = np.log(before) + source(filter_.particles.xyt, beams)
        expected = np.exp(expected - expected.max())
        filter_._weigh(beams)
        np.testing.assert_allclose(filter_._cloud.weights, expected / expected.sum(), rtol=1e-9)


def test_resampling_waits_for_its_interval_and_for_weights_that_differ():
    beams = beams_at(PLACE)
    for updates, effective, interval, resampled in (
        (1, 0.1, 2, True), (0, 0.1, 2, False), (1, 0.9, 2, False), (3, 0.49, 4, True), (3, 0.51, 4, False),
    ):  # fmt: skip
        filter_ = made(
            max_particles=400, min_particles=50, resample_interval=interval, selective_resampling=True
        )
        filter_.initialise(PLACE, np.diag([1e-3, 1e-3, 1e-3]))
        filter_.watch.updates = updates
        weights = np.zeros(400)
        weights[: round(400 * effective)] = 1.0
        filter_._cloud.weights = weights / weights.sum()
        heavy = filter_.particles.xyt[: round(400 * effective)]
        filter_._resample(beams)
        assert (np.ptp(filter_._cloud.weights) == 0.0) == resampled
        if resampled:
            kept = {tuple(p) for p in filter_.particles.xyt}
            assert kept <= {tuple(p) for p in heavy}
            assert 50 <= filter_.size <= 400
            assert filter_._cloud.weights.sum() == pytest.approx(1.0)


def test_as_many_particles_are_kept_as_kld_sampling_asks_for():
    filter_ = made(max_particles=900, min_particles=60, kld_err=0.08, kld_z=1.5)
    filter_.initialise(PLACE, np.diag([0.02, 0.02, 0.02]))
    filter_._cloud.weights = np.random.default_rng(8).random(900) ** 6
    filter_._cloud.weights /= filter_._cloud.weights.sum()
    filter_.watch.updates = filter_.config.resample_interval - 1
    poses, weights, rng = filter_.particles.xyt, filter_._cloud.weights, copy.deepcopy(filter_._rng)
    drawn = poses[rng.permutation(resampling.low_variance(weights, 900, rng.random()))]
    count = resampling.kld_count(
        resampling.bin_numbers(drawn, resampling.BIN_M, resampling.BIN_RAD), 0.08, 1.5, 60
    )
    filter_._resample(beams_at(PLACE))
    assert 60 < filter_.size == count < 900
    np.testing.assert_array_equal(
        filter_.particles.xyt, poses[resampling.low_variance(weights, count, rng.random())]
    )


def test_a_share_of_random_particles_replaces_as_many_particles():
    filter_ = made(max_particles=1000, min_particles=300)
    filter_.initialise(PLACE, np.diag([1e-3, 1e-3, 1e-3]))
    filter_.watch.slow, filter_.watch.fast = 0.8, 0.4
    elsewhere = np.tile([9.0, 9.0, 0.0], (600, 1))
    filter_._found = lambda share, beams: elsewhere
    filter_._resample(beams_at(PLACE))
    found_there = int(np.sum(filter_.particles.x == 9.0))
    assert found_there == filter_.size // 2
    filter_.watch.updates = 100
    filter_._found = lambda share, beams: None
    filter_._resample(beams_at(PLACE))
    assert filter_.size >= 300


class Found:
    """A search that finds the place near by or the one far away, with the agreements it is told."""

    def __init__(self, here, near, far):
        self.told = {"here": here, "near": near, "far": far}
        self.asked = []

    def draw(self, count, beams, rng, around=None):
        self.asked.append((count, None if around is None else tuple(np.round(around, 6))))
        return np.tile([1.0 if around is None else 2.0, 0.0, 0.0], (count, 1))

    def agreement(self, pose, beams):
        return self.told[{1.0: "far", 2.0: "near"}.get(round(float(pose[0]), 6), "here")]


@pytest.mark.parametrize(
    ("here", "near", "far", "found"),
    [
        (0.5, 0.61, 0.3, 2.0), (0.5, 0.6, 0.3, None), (0.5, 0.7, 0.74, 2.0),
        (0.5, 0.7, 0.76, 1.0),
        (0.7, 0.7, 0.76, None),
    ],
)  # fmt: skip
def test_a_place_found_must_explain_clearly_more_and_a_far_one_more_still(here, near, far, found):
    filter_ = made(max_particles=1000)
    filter_.initialise(SE2.from_xyt(5.0, 5.0, 0.0), None, SE2.from_xyt(1.0, 0.0, 0.0))
    filter_.search = Found(here, near, far)
    poses = filter_._found(0.25, beams_at(PLACE))
    assert (None if poses is None else float(poses[0, 0])) == found
    searches = int(found is not None)
    assert filter_.searches == searches
    assert filter_.search.asked == [(251, (5.0, 5.0, 0.0)), (251, None)]
    assert poses is None or len(poses) == 251
    filter_.watch.anywhere = True
    assert filter_._found(1.0, beams_at(PLACE))[0, 0] == 1.0
    assert filter_.searches == searches + 1
    assert filter_.search.asked[-1] == (1001, None)


def test_a_scan_that_explains_far_less_than_usual_contradicts():
    filter_ = made()
    assert not filter_.contradicted(scan_at(PLACE), PLACE, PLACE)
    filter_.initialise(PLACE, np.diag([1e-4] * 3), PLACE)
    beams = beams_at(PLACE)
    usual = filter_.search.agreement(PLACE.xyt, beams)
    for slow, told in (
        (usual / (1.0 - lost_detection.DOUBTFUL) * 0.99, False),
        (usual / (1.0 - lost_detection.DOUBTFUL) * 1.01, True),
    ):
        filter_.watch.slow = slow
        assert filter_.contradicted(scan_at(PLACE), PLACE, PLACE) == told
    filter_.watch.slow = 0.9
    wrong = PLACE @ SE2.from_xyt(1.0, 0.5, 1.0)
    assert filter_.contradicted(scan_at(PLACE), wrong, wrong)


def test_a_restart_forgets_all_but_the_settings():
    filter_ = made()
    filter_.initialise(PLACE, np.diag([1e-3] * 3))
    for k in range(3):
        filter_.update(scan_at(PLACE), SE2.from_xyt(0.0, 0.0, 0.5 * k))
    filter_.watch._next_search, filter_.watch.best = 9, 0.9
    filter_.initialise_globally()
    assert (filter_.watch.updates, filter_.watch._next_search, filter_.watch.best) == (0, 0, 0.0)
    assert (filter_.watch.slow, filter_.watch.fast, filter_._at.estimate, filter_._at.T_map_odom) == (
        0.8,
        0.0,
        None,
        None,
    )
    assert filter_.size == filter_.config.max_particles
    assert filter_._fine is not None
    assert filter_._fine._filter is None


def test_a_scan_that_agrees_with_nothing_is_no_division_by_zero_however_fast_the_slow_average():
    watch = AgreementWatch(AmclConfig(recovery_alpha_slow=1.0, recovery_alpha_fast=1.0))
    watch.update(0.0)
    assert watch.random_share() == watch.search_share() == 0.0
