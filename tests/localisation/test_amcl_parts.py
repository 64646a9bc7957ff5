"""The filter's decisions one by one, by their formulas: shares, pauses, averages, resampling, searches."""

import math

import numpy as np
import pytest

from tests.helpers.localisation_room import LIDAR, STILL_LIDAR, T_BASE_LIDAR
from tests.localisation.filter_room import GRID, PLACE, beams_at, made, scan_at
from turtlebag.datasets.se2 import SE2, wrap
from turtlebag.datasets.types import Scan
from turtlebag.pipeline.localisation import lost_detection, resampling
from turtlebag.pipeline.localisation.amcl import Amcl
from turtlebag.pipeline.localisation.estimate import narrow
from turtlebag.pipeline.localisation.likelihood_field import LikelihoodField
from turtlebag.pipeline.localisation.lost_detection import AgreementWatch
from turtlebag.pipeline.localisation.parameters import AmclConfig
from turtlebag.pipeline.localisation.resampling import Cloud

BLIND = Scan(0, np.full(360, np.nan, dtype=np.float32), STILL_LIDAR)
"""A scan that says nothing: what is left is what odometry and the start said."""


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
    np.testing.assert_allclose(filter_.cloud.weights, 1.0 / 20000)
    assert (filter_.size, filter_.initialised, filter_.converged, filter_.lost) == (20000, True, False, True)
    given = np.array([[0.01, 0.005, 0.0], [0.005, 0.01, 0.0], [0.0, 0.0, 0.0]])
    filter_.initialise(told, given)
    np.testing.assert_allclose(np.cov((filter_.particles.xyt - told.xyt).T), given, atol=5e-4)
    filter_.update(BLIND, odometry)
    np.testing.assert_allclose(filter_.covariance, np.cov((filter_.particles.xyt - told.xyt).T), atol=1e-4)


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
    assert narrow(np.diag(np.square(std))) == converged
    filter_ = made(max_particles=20000, update_min_d=0.0)
    # By more than a cloud of so many differs from what it is drawn from.
    filter_.initialise(PLACE, np.diag(np.square(np.array(std) * (0.97 if converged else 1.03))))
    assert not filter_.converged
    filter_.update(BLIND, SE2.identity())
    filter_.watch.fast = filter_.watch.slow
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
    looked = []
    for again.watch.updates in range(60):
        if again.watch.search_share():
            looked.append(again.watch.updates)
    assert looked == [0, 32]
    again.watch.fast = 0.721
    again.watch.updates = 500
    assert again.watch.search_share() == 0.0


def test_the_robot_has_moved_enough_by_its_way_or_by_its_turn():
    for xyt, moved in (
        ((0.12, 0.16, 0.0), True), ((0.12, 0.15, 0.29), False), ((0.0, 0.0, 0.301), True),
        ((0.0, 0.0, -0.31), True), ((-0.2, 0.0, 0.0), True), ((0.0, -0.19, -0.29), False),
    ):  # fmt: skip
        filter_ = made(update_min_d=0.2, update_min_a=0.3, max_particles=20, min_particles=10)
        filter_.initialise(PLACE)
        assert filter_.update(BLIND, SE2.identity())  # the first scan always
        assert filter_.update(BLIND, SE2(np.array(xyt))) == moved


def test_weights_are_multiplied_by_the_sensors_while_it_agrees_and_by_the_paths_while_lost():
    filter_ = made(max_particles=200, min_particles=10, resample_interval=99)
    filter_.initialise(PLACE, np.diag([1e-3, 1e-3, 1e-3]))
    sensor = LikelihoodField(filter_.config, filter_.search.field, filter_.search.range_max)
    beams, before = beams_at(PLACE), np.random.default_rng(2).random(200)
    for k, lost in enumerate((True, False)):
        filter_.cloud = Cloud(filter_.cloud.poses, before / before.sum())
        assert filter_.lost == lost
        filter_.update(scan_at(PLACE), SE2.from_xyt(0.0, 0.0, 0.1 * k))
        source = filter_.search.log_likelihood if lost else sensor.weigh
        expected = np.log(before) + source(filter_.particles.xyt, beams)
        expected = np.exp(expected - expected.max())
        np.testing.assert_allclose(filter_.cloud.weights, expected / expected.sum(), rtol=1e-9)


def test_resampling_waits_for_its_interval_and_for_weights_that_differ():
    for update, effective, interval, due in (
        (2, 0.1, 2, True), (1, 0.1, 2, False), (2, 0.9, 2, False), (4, 0.49, 4, True), (4, 0.51, 4, False),
    ):  # fmt: skip
        config = AmclConfig(
            max_particles=400, min_particles=50, resample_interval=interval, selective_resampling=True
        )
        weights = np.zeros(400)
        heavy = round(400 * effective)
        weights[:heavy] = 1.0 / heavy
        poses = np.random.default_rng(4).normal(0.0, 0.03, (400, 3))
        cloud = Cloud(poses, weights)
        assert cloud.due(config, update) == due
        assert cloud.due(config.model_copy(update={"selective_resampling": False}), update) == (
            update % interval == 0
        )
        drawn = cloud.resampled(config, np.random.default_rng(5))
        assert {tuple(p) for p in drawn.poses} <= {tuple(p) for p in poses[:heavy]}
        assert 50 <= len(drawn.poses) <= 400
        np.testing.assert_allclose(drawn.weights, 1.0 / len(drawn.poses))


def test_as_many_particles_are_kept_as_kld_sampling_asks_for():
    config = AmclConfig(max_particles=900, min_particles=60, kld_err=0.08, kld_z=1.5)
    weights = np.random.default_rng(8).random(900) ** 6
    weights /= weights.sum()
    poses, rng = np.random.default_rng(9).normal(0.0, 0.14, (900, 3)), np.random.default_rng(10)
    found = Cloud(poses, weights).resampled(config, np.random.default_rng(10))
    pool = resampling.low_variance(weights, 900, rng.random())
    drawn = poses[resampling.scattered(pool, rng.random())]
    count = resampling.kld_count(
        resampling.bin_numbers(drawn, resampling.BIN_M, resampling.BIN_RAD), 0.08, 1.5, 60
    )
    assert 60 < len(found.poses) == count < 900
    np.testing.assert_array_equal(found.poses, poses[resampling.low_variance(weights, count, rng.random())])


def test_a_share_of_random_particles_replaces_as_many_particles():
    config = AmclConfig(max_particles=1000, min_particles=300)
    cloud = Cloud.even(np.random.default_rng(1).normal(0.0, 0.03, (1000, 3)))
    elsewhere = np.column_stack([np.full(600, 9.0), np.arange(600.0), np.zeros(600)])
    mixed = cloud.resampled(config, np.random.default_rng(2), elsewhere, 0.5)
    there = mixed.poses[mixed.poses[:, 0] == 9.0]
    assert len(there) == len(mixed.poses) // 2
    np.testing.assert_array_equal(there, elsewhere[: len(there)])  # they come in random order already
    alone = cloud.resampled(config, np.random.default_rng(2), None, 0.5)
    assert len(alone.poses) == len(mixed.poses) >= 300


class Found:
    """A search that finds the place near by or the one far away, with the agreements it is told."""

    def __init__(self, here, near, far):
        self.told = {"here": here, "near": near, "far": far}
        self.asked = []

    def uniform(self, count, rng):
        return np.tile([5.0, 5.0, 0.0], (count, 1))

    def log_likelihood(self, poses, beams):
        return np.zeros(len(poses))

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
    filter_ = made(max_particles=1000, refine=False)
    odometry = SE2.from_xyt(1.0, 0.0, 0.0)
    filter_.initialise(SE2.from_xyt(5.0, 5.0, 0.0), np.zeros((3, 3)), odometry)
    filter_.search = Found(here, near, far)
    filter_.watch.slow, filter_.watch.fast = 0.8, 0.6  # a quarter of the particles is searched for
    filter_.update(scan_at(PLACE), odometry)
    there = filter_.particles.x[-filter_.size // 4 :]
    assert np.all(there == (5.0 if found is None else found))
    assert np.sum(filter_.particles.x == 5.0) == filter_.size - (0 if found is None else filter_.size // 4)
    assert filter_.searches == int(found is not None)
    assert filter_.search.asked == [(251, (5.0, 5.0, 0.0)), (251, None)]


@pytest.mark.parametrize(("off", "sure"), [(0.0, True), (0.14, True), (0.5, False)])
def test_where_a_search_leads_back_to_the_estimate_the_scans_are_worse_than_expected(off, sure):
    filter_ = made(max_particles=1000, refine=False)
    filter_.initialise(SE2.from_xyt(2.0 + off, 0.0, 0.0), np.zeros((3, 3)), SE2.identity())
    filter_.search = Found(0.5, 0.55, 0.3)
    filter_.watch.fast = 0.5
    assert not filter_.agrees
    filter_.update(scan_at(PLACE), SE2.identity())
    assert filter_.searches == 0
    assert filter_.agrees == sure
    filter_.watch.fast = 0.3  # what is worse than that is still noticed
    assert not filter_.agrees


def test_after_a_global_start_whatever_is_found_is_taken():
    filter_ = made(max_particles=1000, refine=False)
    filter_.search = Found(0.9, 0.9, 0.9)
    filter_.initialise_globally()
    filter_.update(scan_at(PLACE), SE2.identity())
    assert np.all(filter_.particles.x == 1.0)
    assert (filter_.searches, filter_.search.asked) == (1, [(1001, None)])


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
    """It goes on as one that was just made, with the same random numbers; how far odometry may be trusted
    is learned for good."""
    rng = np.random.default_rng(7)
    again = Amcl(GRID, LIDAR, T_BASE_LIDAR, AmclConfig(), rng)
    again.initialise(PLACE @ SE2.from_xyt(0.0, 0.0, 1.0), np.diag([1e-3] * 3))
    for k in (2, 1, 0):  # it ends where the other begins
        odometry = SE2.from_xyt(0.0, 0.0, 0.5 * k)
        again.update(scan_at(PLACE @ odometry), odometry)
    again.watch.slow, again.watch.fast = 0.9, 0.5
    again.watch.search_share()  # the next search waits from here on
    rng.bit_generator.state = np.random.default_rng(1).bit_generator.state
    fresh = made()
    for one in (again, fresh):
        one.initialise_globally()
        assert one.size == one.config.max_particles
        assert (one.watch.updates, one.watch.slow, one.watch.fast, one.watch.best) == (0, 0.8, 0.0, 0.0)
    for k in range(3):
        odometry = SE2.from_xyt(0.1 * k, 0.0, 0.5 * k)
        for one in (again, fresh):
            one.update(scan_at(PLACE @ odometry), odometry)
        np.testing.assert_array_equal(again.particles.xyt, fresh.particles.xyt)
        off = 1e-5 if k else 0.0
        np.testing.assert_allclose(again.T_map_odom.xyt, fresh.T_map_odom.xyt, rtol=0.0, atol=off)
    for one in (again, fresh):
        one.watch.fast = 0.1
    assert again.watch.search_share() == fresh.watch.search_share() > 0.0


def test_a_scan_that_agrees_with_nothing_is_no_division_by_zero_however_fast_the_slow_average():
    watch = AgreementWatch(AmclConfig(recovery_alpha_slow=1.0, recovery_alpha_fast=1.0))
    watch.update(0.0)
    assert watch.random_share() == watch.search_share() == 0.0
