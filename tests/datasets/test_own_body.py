"""Beams that hit the robot itself are left out, and no others."""

from dataclasses import replace

import numpy as np
import pytest

from tests.helpers.slam_rooms import ROOM, around_the_room, drifted, recording
from turtlebag.datasets.own_body import without_own_body
from turtlebag.datasets.se2 import SE2


def driven(T):
    return recording(ROOM, T, odometry=drifted(T))


@pytest.fixture(scope="module")
def drive():
    """Round the room to the left, and back the same way."""
    there = around_the_room(160)
    return driven(np.concatenate([there, there[::-1]]))


def with_strut(log, metres=0.2, noise=0.005):
    ranges = log.ranges.copy()
    ranges[:, 20:35] = metres + noise * np.random.default_rng(1).standard_normal((len(ranges), 15))
    return replace(log, ranges=ranges.astype(np.float32))


def test_a_strut_that_rides_along_is_left_out(drive):
    kept = without_own_body(with_strut(drive))
    assert np.flatnonzero(np.isnan(kept.ranges).all(axis=0)).tolist() == list(range(20, 35))
    assert kept.notes[-1].startswith(f"15 of {drive.ranges.shape[1]} beams hit the robot itself")
    others = np.delete(np.arange(drive.ranges.shape[1]), np.arange(20, 35))
    np.testing.assert_array_equal(kept.ranges[:, others], drive.ranges[:, others])


def test_what_stays_as_near_in_one_kind_of_motion_alone_may_be_a_pillar_that_is_circled():
    circling = with_strut(driven(around_the_room(320, laps=2)))
    assert without_own_body(circling) is circling


def test_without_odometry_and_without_scans_nothing_is_taken_away(drive):
    lidar_alone = replace(with_strut(drive), T_odom_base=None)
    assert without_own_body(lidar_alone) is lidar_alone
    stamps, T_odom = drive.stamps_ns[:0], drive.T_odom_base[:0]
    nothing = replace(drive, ranges=drive.ranges[:0], stamps_ns=stamps, T_odom_base=T_odom)
    assert without_own_body(nothing) is nothing


def test_nothing_is_taken_from_a_drive_without_one(drive):
    assert without_own_body(drive) is drive
    assert without_own_body(with_strut(drive, noise=0.05)).notes == drive.notes
    assert without_own_body(with_strut(drive, metres=0.8)).notes == drive.notes


def test_a_robot_that_stands_close_to_a_wall_sees_no_body_of_its_own(drive):
    still = with_strut(replace(drive, ranges=np.repeat(drive.ranges[:1], len(drive), axis=0)))
    assert without_own_body(still) is still
    # it stands for most of the log, and then drives on
    log = with_strut(drive)
    ranges = np.concatenate([np.repeat(log.ranges[:1], 5 * len(log), axis=0), drive.ranges])
    stamps = np.arange(len(ranges)) * 200_000_000
    odometry = SE2(
        np.concatenate([np.repeat(drive.T_odom_base.xyt[:1], 5 * len(log), axis=0), drive.T_odom_base.xyt])
    )
    waits = replace(log, ranges=ranges, stamps_ns=stamps, T_odom_base=odometry, odometry=None)
    assert without_own_body(waits) is waits
