"""Pushes, aliasing, the fine pose and the search, one by one, by hand-computed cases."""

import math

import numpy as np
import pytest

from tests.helpers.localisation_room import STILL_LIDAR, T_BASE_LIDAR
from tests.localisation.filter_room import GRID, PLACE, beams_at, made
from turtlebag.datasets.se2 import SE2, wrap
from turtlebag.datasets.types import Scan
from turtlebag.pipeline.localisation import fine_pose
from turtlebag.pipeline.localisation.deskewed_beams import prepare
from turtlebag.pipeline.localisation.estimate import Estimate
from turtlebag.pipeline.localisation.fine_pose import FinePose, agree, next_share
from turtlebag.pipeline.localisation.global_search import GlobalSearch, tempered
from turtlebag.pipeline.localisation.pose_hypotheses import Aliasing, Keyframe, PoseHypotheses, apart, within
from turtlebag.pipeline.localisation.surfaces import fit_surfaces
from turtlebag.pipeline.localisation.wall_filter import WallFilter


def test_places_are_apart_by_more_than_a_metre_or_a_radian():
    here = SE2.from_xyt(1.0, 2.0, 3.0)
    for xyt, other in (
        ((0.6, 0.79, 0.99), False), ((0.61, 0.8, 0.0), True), ((0.0, 0.0, -1.01), True),
        ((0.0, 0.0, 1.01), True),
    ):  # fmt: skip
        assert apart(here, here @ SE2(np.array(xyt))) == other
    poses = np.array(
        [[0.5, 0.0, 0.0], [0.3, 0.41, 0.0], [0.0, 0.0, 0.59], [0.0, 0.0, -0.61], [0.0, 0.0, 6.2]]
    )
    assert within(poses, np.zeros(3)).tolist() == [True, False, True, False, True]


def test_the_agreement_of_several_scans_is_their_mean_each_from_its_own_place():
    search = made().search
    aliasing = Aliasing(search, np.random.default_rng(3))
    places = [PLACE, PLACE @ SE2.from_xyt(0.2, 0.1, 0.4)]
    scans = [Keyframe(beams_at(p), p) for p in places]
    relative = [places[1].inverse() @ p for p in places]
    poses = np.array([places[1].xyt, (places[1] @ SE2.from_xyt(0.05, 0.0, 0.1)).xyt])
    found = aliasing.mean_agreement(poses, relative, scans)
    for pose, value in zip(poses, found, strict=True):
        each = [search.agreement((SE2(pose) @ r).xyt, g.beams) for r, g in zip(relative, scans, strict=True)]
        assert value == pytest.approx(np.mean(each))
    assert found[0] > 0.95 > found[1]
    fit, second = aliasing.polish(SE2.from_xyt(0.05, -0.03, 0.0), scans, places)
    assert fit > 0.97
    assert np.abs((second @ places[1]).xyt - places[1].xyt).max() < 0.03
    assert aliasing.fits([SE2.identity()], scans[0], SE2.identity()) == pytest.approx(1.0, abs=0.03)


def test_the_places_of_one_scan_are_the_clusters_that_hold_more_than_one_in_a_hundred():
    rng = np.random.default_rng(4)
    centres = np.array([[0.0, 0.0, 0.0], [3.0, 0.0, 0.0], [0.0, 0.0, 2.0], [6.0, 6.0, 0.0]])
    poses = np.repeat(centres, [1800, 750, 421, 29], axis=0) + rng.normal(0.0, 0.03, (3000, 3))

    class Drawn:
        def draw(self, count, beams, of, without):
            assert count == 3000
            return rng.permutation(poses[~without(poses)])

    aliasing = Aliasing(Drawn(), rng)
    found = aliasing.places(None, [SE2.from_xyt(-20.0, 0.0, 0.0)])
    assert len(found) == 3
    for centre in centres[:3]:
        assert min(np.abs(place - centre).max() for place in found) < 0.02
    # Known ones are not drawn: the first, and one that is as near to the second in place, but not in heading.
    (other, turned) = sorted(aliasing.places(None, [SE2.identity(), SE2.from_xyt(3.0, 0.0, 1.5)]), key=sum)
    assert np.abs(turned - centres[1]).max() < 0.02
    assert np.abs(other - centres[2]).max() < 0.02


def test_a_hypothesis_stays_while_its_mean_of_six_is_close():
    places = [SE2.identity(), SE2.from_xyt(2.0, 0.0, 0.0)]
    for off, left in ((0.049, 2), (0.051, 1)):
        hypotheses = PoseHypotheses(places)
        for _ in range(6):
            found = hypotheses.judge(np.array([0.9, 0.9 - off]))
        assert len(hypotheses.poses) == left
        assert found is (places[0] if left == 1 else None)


def test_the_fine_pose_agrees_with_a_cloud_within_its_reach():
    narrow = Estimate(SE2.from_xyt(1.0, 2.0, 3.1), 1e-6 * np.eye(3), np.eye(3))
    wide = Estimate(narrow.T_map_base, np.diag([0.01, 0.04, 0.0025]), np.eye(3))
    for offset, cloud, agrees in (
        ((0.149, 0.149, 0.099), narrow, True), ((0.151, 0, 0), narrow, False),
        ((0, -0.151, 0), narrow, False),
        ((0, 0, 0.101), narrow, False), ((0.29, 0.59, 0.149), wide, True), ((0, 0.61, 0), wide, False),
        ((0, 0, 2 * math.pi - 0.05), narrow, True),
    ):  # fmt: skip
        assert agree(SE2(narrow.T_map_base.xyt + np.array(offset)), cloud) == agrees


def test_the_trust_in_odometry_follows_the_scans_nis():
    for share, nis, expected in ((0.3, 0.5, 0.3), (0.3, 1.5, 0.315), (0.2, 9.0, 0.285), (0.2, 0.0, 0.195)):
        assert next_share(share, nis) == pytest.approx(expected)
    assert next_share(fine_pose.LEAST_SHARE, 0.0) == fine_pose.LEAST_SHARE
    assert next_share(0.9, 30.0) == 1.0
    # Beside a wall filter that is given the same.
    cloud, points = Estimate(PLACE, 1e-4 * np.eye(3), np.eye(3)), beams_at(PLACE).points
    fine, track = FinePose(GRID), WallFilter(fit_surfaces(GRID), PLACE, cloud.core)
    fine.correct(cloud, points)
    track.correct(points)
    share, std = fine_pose.FIRST_SHARE, np.array([0.02, 0.05, 0.02])
    for _ in range(6):
        assert fine.share == pytest.approx(share)
        step = SE2.from_xyt(0.02, 0.0, 0.01)
        fine.predict(step, (0.0, 0.02, 0.01), std)
        track.predict(step, (0.0, 0.02, 0.01), share * std)
        share = next_share(share, track.correct(points))
        np.testing.assert_array_equal(fine.correct(cloud, points).xyt, track.T_map_base.xyt)
    assert fine.share == share != fine_pose.FIRST_SHARE


@pytest.mark.parametrize(("std", "started"), [(0.149, True), (0.151, False)])
def test_a_fine_pose_starts_from_a_narrow_cluster(std, started):
    cloud = Estimate(PLACE, np.diag([1e-4, std**2, 1e-4]), np.eye(3))
    pose = FinePose(GRID).correct(cloud, beams_at(PLACE @ SE2.from_xyt(0.01, 0.01, 0.0)).points)
    assert (pose is not cloud.T_map_base) == started


def test_where_even_a_new_start_disagrees_the_clouds_mean_is_told():
    """The scan is of a place farther off than the cloud is wide."""
    cloud = Estimate(PLACE @ SE2.from_xyt(0.0, 0.2, 0.0), 1e-3 * np.eye(3), np.eye(3))
    points = beams_at(PLACE).points
    alone = WallFilter(fit_surfaces(GRID), cloud.T_map_base, cloud.core)
    alone.correct(points)
    assert not agree(alone.T_map_base, cloud)
    assert FinePose(GRID).correct(cloud, points) is cloud.T_map_base


def test_the_fine_pose_is_matched_with_the_first_scan_already_and_starts_again_where_it_disagrees():
    fine, points = FinePose(GRID), beams_at(PLACE).points
    off = PLACE @ SE2.from_xyt(0.03, -0.02, 0.02)
    cloud = Estimate(off, np.diag([1e-3, 1e-3, 1e-3]), np.eye(3))
    found = PLACE.inverse() @ fine.correct(cloud, points)
    assert np.hypot(found.x, found.y) < 0.015
    assert abs(float(found.yaw)) < 0.008
    # It is tracked on, not started anew: the second scan says less than the first.
    anew = FinePose(GRID).correct(cloud, points).xyt
    np.testing.assert_array_equal((PLACE @ found).xyt, anew)
    assert np.abs(fine.correct(cloud, points).xyt - anew).max() > 1e-7
    # Where cloud and track are apart the track is given up.
    far = Estimate(PLACE @ SE2.from_xyt(0.5, 0.0, 0.0), cloud.core, np.eye(3))
    fine.correct(far, points)
    np.testing.assert_array_equal(fine.correct(cloud, points).xyt, anew)
    wide = Estimate(off, np.eye(3), np.eye(3))
    assert fine.correct(wide, points) is not off
    fine.forget()
    assert fine.correct(wide, points) is off


def test_tempering_takes_the_steepest_power_that_leaves_enough():
    rng = np.random.default_rng(5)
    log_likelihood = rng.normal(0.0, 40.0, 500)
    weights = tempered(log_likelihood)
    power = np.polyfit(log_likelihood, np.log(weights), 1)[0]
    assert 1.0 / np.square(weights).sum() >= 0.02 * 500
    steeper = np.exp((power + 2e-4) * (log_likelihood - log_likelihood.max()))
    steeper /= steeper.sum()
    assert 1.0 / np.square(steeper).sum() < 0.02 * 500 * 1.01
    flat = tempered(1e-3 * log_likelihood)
    assert np.polyfit(1e-3 * log_likelihood, np.log(flat), 1)[0] == pytest.approx(0.3, rel=1e-3)


def test_the_search_finds_the_place_anywhere_and_about_a_pose():
    # How far odometry may be off is another thing than how well the first pose was known.
    search = made(initial_cov_xx=0.0, initial_cov_yy=0.0, initial_cov_aa=0.0).search
    assert isinstance(search, GlobalSearch)
    rng, beams = np.random.default_rng(6), beams_at(PLACE)
    for around in (None, (PLACE @ SE2.from_xyt(0.6, -0.4, 0.4)).xyt):
        poses = search.draw(400, beams, rng, around)
        assert poses.shape == (400, 3)
        off = poses - PLACE.xyt
        off[:, 2] = wrap(off[:, 2])
        assert np.median(np.hypot(off[:, 0], off[:, 1])) < 0.1
        assert np.abs(poses[:, 2]).max() <= math.pi
    elsewhere = search.draw(400, beams, rng, without=lambda poses: np.hypot(*(poses - PLACE.xyt).T[:2]) < 1.0)
    assert len(elsewhere) == 400
    assert np.hypot(*(elsewhere - PLACE.xyt).T[:2]).min() > 0.8
    assert search.draw(400, beams, rng, without=lambda poses: np.ones(len(poses), bool)).shape == (0, 3)
    assert search.agreement(PLACE.xyt, beams) > 0.9
    both = search.agreements(np.array([PLACE.xyt, [2.5, 3.0, 1.0]]), beams)
    assert both[0] == search.agreement(PLACE.xyt, beams) > both[1]
    silent = prepare(Scan(0, np.full(360, np.nan, np.float32), STILL_LIDAR), T_BASE_LIDAR)
    assert search.agreements(PLACE.xyt[None], silent).tolist() == [0.0]
    free = search.uniform(50, rng)
    assert free.shape == (50, 3)
    flat = 0.3 * search.path_log_likelihood(free, beams)
    np.testing.assert_allclose(search.log_likelihood(free, beams), flat)
