"""Pose hypotheses: found in a room that is its own mirror image, and decided in one that is not."""

import math

import numpy as np
import pytest

from tests.helpers.exact_rays import rectangle
from tests.helpers.localisation_room import STILL_LIDAR, T_BASE_LIDAR, Room
from turtlebag.datasets.se2 import SE2
from turtlebag.datasets.types import Scan
from turtlebag.pipeline.localisation.amcl import Amcl
from turtlebag.pipeline.localisation.deskewed_beams import prepare
from turtlebag.pipeline.localisation.parameters import AmclConfig
from turtlebag.pipeline.localisation.pose_hypotheses import (
    Aliasing,
    Keyframe,
    PoseHypotheses,
    apart,
    within,
)

# Turned by half a circle about (2, 1.5) the hall is itself, but for the box where there is one.
HALL = Room(rectangle(0.013, 0.013, 3.987, 2.987), (2.0, 1.5))
WITH_A_BOX = Room(np.vstack([HALL.walls, rectangle(0.5, 2.3, 1.1, 2.9)]), (2.0, 1.5))
HALF_TURN = SE2.from_xyt(4.0, 3.0, math.pi)


def seen_from(room: Room, poses: list[tuple[float, float, float]]) -> tuple[Aliasing, list[Keyframe]]:
    """Exact scans on a drive, the odometry being in the map's frame."""
    search = Amcl(room.grid(), STILL_LIDAR, T_BASE_LIDAR, AmclConfig(), np.random.default_rng(1)).search
    scans = []
    for pose in poses:
        T = SE2.from_xyt(*pose)
        ranges = room.ranges(SE2((T @ T_BASE_LIDAR).xyt[None]), STILL_LIDAR.angles, 3.5).astype(np.float32)
        scans.append(Keyframe(prepare(Scan(0, ranges, STILL_LIDAR), T_BASE_LIDAR), T))
    return Aliasing(search, np.random.default_rng(2)), scans


DRIVE = [(1.1, 0.9, 0.3), (1.4, 1.0, 0.5)]


def test_the_aliased_place_is_found_and_the_estimate_stays_first():
    aliasing, scans = seen_from(HALL, DRIVE)
    found = aliasing.find(scans, SE2.identity())
    assert len(found) == 2
    assert np.array_equal(found[0].xyt, np.zeros(3))
    off = HALF_TURN.inverse() @ found[1]
    assert np.abs(off.xyt).max() < 0.1
    fits = aliasing.fits(found, scans[0], SE2.identity())
    assert fits.min() > 0.9
    assert abs(fits[0] - fits[1]) < 0.05


@pytest.mark.slow
def test_a_wrong_estimate_gives_way_to_the_place_that_explains_the_scans():
    aliasing, scans = seen_from(WITH_A_BOX, DRIVE)
    (only,) = aliasing.find(scans, SE2.identity())
    assert np.array_equal(only.xyt, np.zeros(3))
    (right,) = aliasing.find(scans, HALF_TURN)
    T_map_base = right @ HALF_TURN @ scans[-1].T_odom_base
    assert np.abs((scans[-1].T_odom_base.inverse() @ T_map_base).xyt).max() < 0.1


def test_a_hypothesis_is_dropped_when_six_scans_in_a_row_speak_against_it():
    places = [SE2.identity(), HALF_TURN, SE2.from_xyt(1.0, 0.0, 0.0)]
    hypotheses = PoseHypotheses(places)
    for _ in range(5):
        assert hypotheses.judge(np.array([0.9, 0.88, 0.6])) is None
    assert len(hypotheses.poses) == 3
    assert hypotheses.judge(np.array([0.9, 0.88, 0.6])) is None
    assert hypotheses.poses == places[:2]
    for _ in range(2):
        # on average of the last six scans 0.833 and 0.88: still in the race
        assert hypotheses.judge(np.array([0.7, 0.88])) is None
    assert hypotheses.judge(np.array([0.7, 0.88])) is HALF_TURN
    assert hypotheses.poses == [HALF_TURN]


@pytest.mark.parametrize(
    ("other", "far"),
    [((0.6, 0.6, 0.0), False), ((0.8, 0.8, 0.0), True), ((0.0, 0.0, 0.9), False), ((0.0, 0.0, -1.1), True)],
)
def test_places_a_metre_or_a_radian_apart_are_two(other, far):
    here = SE2.from_xyt(3.0, -2.0, 2.5)
    assert apart(here, here @ SE2.from_xyt(*other)) == far


def test_poses_about_a_place_are_near_in_both_place_and_heading():
    centre = np.array([1.0, 2.0, 3.1])
    poses = centre + np.array(
        [[0.1, -0.1, 0.05], [3.0, 0.0, 0.0], [0.0, 3.0, 0.0], [0.0, 0.0, 2.0], [0, 0, 0.1]]
    )
    assert within(poses, centre).tolist() == [True, False, False, False, True]
