"""Finding a place without a guess, and several recordings in one map."""

from dataclasses import replace

import numpy as np
import pytest

from tests.slam_rooms import LDS, ROOM, around_the_room, drifted, recording, rectangle
from turtlebag.datasets.errors import InputError
from turtlebag.datasets.se2 import SE2
from turtlebag.datasets.types import Trajectory
from turtlebag.pipeline.slam.cloud_parts import joined_clouds
from turtlebag.pipeline.slam.clouds import make_clouds
from turtlebag.pipeline.slam.relocate import Place, agreed_place, find_place
from turtlebag.pipeline.slam.slam import SlamConfig, run_slam
from turtlebag.reports.metrics.trajectory import ate

FIRST = around_the_room(100)
SECOND = around_the_room(100)[::-1] + np.array([0.1, 0.1, np.pi])


def test_place_is_found_from_any_frame():
    poses = np.vstack([FIRST[::5], SECOND[40:52]])
    clouds = make_clouds(recording(ROOM, poses), 30.0)
    T_far = SE2.from_xyt(30.0, -12.0, 2.0)
    query = np.arange(20, 32)
    place = find_place(clouds, np.arange(20), poses[:20], query, (T_far @ SE2(poses[query])).xyt)
    assert place is not None
    assert place.certain
    off = (T_far @ SE2(place.T_map_query)).xyt
    np.testing.assert_allclose(off, 0.0, atol=0.04)


def test_symmetric_room_is_ambiguous():
    square = rectangle(0, 0, 5, 5)
    poses = np.array([[1.5, 1.0, 0.2], [2.0, 1.2, 0.4], [2.5, 1.5, 0.6], [2.2, 1.3, 1.5], [1.8, 1.1, 0.0]])
    clouds = make_clouds(recording(square, poses), 30.0)
    place = find_place(clouds, np.arange(3), poses[:3], np.array([3, 4]), poses[3:])
    assert place is not None
    assert not place.certain


def test_a_map_without_surfaces_is_no_place():
    poses = FIRST[:10]
    log = recording(ROOM, poses)
    blind = replace(log, ranges=np.where(np.arange(10)[:, None] < 5, np.float32(np.nan), log.ranges))
    query = np.arange(5, 10)
    assert find_place(make_clouds(blind, 30.0), np.arange(5), poses[:5], query, poses[query]) is None


def test_one_opinion_is_not_enough():
    here, there = np.array([1.0, 2.0, 0.1]), np.array([3.0, 2.0, 0.1])
    sure, other, unsure = Place(here, 0.95, 0.5), Place(there, 0.95, 0.5), Place(here, 0.95, 0.94)
    assert agreed_place([sure, other, unsure]) is None
    np.testing.assert_array_equal(agreed_place([other, sure, Place(here + 0.02, 0.9, 0.3)]), here)


def test_joined_clouds_keep_every_scan():
    a = make_clouds(recording(ROOM, FIRST[:3]), 30.0)
    b = make_clouds(recording(ROOM, SECOND[:2]), 30.0)
    both = joined_clouds([a, b])
    assert len(both.starts) == 6
    np.testing.assert_array_equal(both.of(4), b.of(1))
    kept = both.table[3][both.table[3] >= 0]
    np.testing.assert_array_equal(both.points[kept], b.points[b.table[0][b.table[0] >= 0]])


@pytest.mark.slow
def test_second_session_joins_the_first_map():
    a = recording(ROOM, FIRST, odometry=drifted(FIRST))
    elsewhere = SE2.from_xyt(-4.0, 9.0, -2.2) @ SE2.from_array(SECOND)
    b = recording(ROOM, SECOND, odometry=drifted(elsewhere.xyt, seed=3), seed=7)
    result = run_slam(a, SlamConfig(), more=[b])
    assert len(result.trajectory) == 200
    truth = SE2.from_array(np.vstack([FIRST, SECOND]))
    stamps = np.arange(200) * 10**9
    both = ate(Trajectory(stamps, result.trajectory.poses), Trajectory(stamps, truth), align=False)
    assert both["rmse"] < 0.01


@pytest.mark.slow
def test_sessions_drawn_along_their_odometry_are_not_bent_by_scans():
    a = recording(ROOM, FIRST, odometry=drifted(FIRST))
    b = recording(ROOM, SECOND, odometry=drifted(SECOND, seed=3), seed=7)
    result = run_slam(a, SlamConfig(sensors="odometry"), more=[b])
    np.testing.assert_allclose(result.trajectory.poses.xyt[:100], a.T_odom_base.xyt, atol=1e-3)
    kinds = [c.kind for c in result.constraints]
    assert (kinds.count("loop"), kinds.count("pair")) == (1, 0)  # the one holds the sessions together


def test_another_lidar_is_refused():
    a = recording(ROOM, FIRST[:20], odometry=FIRST[:20])
    b = recording(ROOM, FIRST[:20], replace(LDS, range_max=7.0), odometry=FIRST[:20])
    with pytest.raises(InputError, match="lidar"):
        run_slam(a, SlamConfig(), more=[b])
