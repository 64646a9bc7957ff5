"""Range errors, calibrated from scans that saw the same walls from near and far."""

from dataclasses import replace
from functools import cache

import numpy as np
import pytest

from tests.helpers.made_drives import Drive, FloorPlan, Sensor, make_log
from tests.helpers.made_logs import rooms
from tests.helpers.slam_rooms import ROOM, around_the_room
from tests.helpers.slam_rooms import recording as recorded
from turtlebag.datasets.types import LidarSpec
from turtlebag.pipeline.slam.mapper import SlamConfig, run_slam, track_recording
from turtlebag.pipeline.slam.progress import no_progress
from turtlebag.pipeline.slam.scans.clouds import UNSURE_RAD, make_clouds
from turtlebag.pipeline.slam.sensors.range_calibration import (
    BESIDE,
    RangeCalibration,
    calibrate_ranges,
    straight_points,
)

ERRORS = RangeCalibration(0.006, -0.003)
log_of = cache(lambda make: make(1))


def misread(recording, errors):
    """The recording by a lidar whose ranges are off."""
    ranges, back = recording.ranges.astype(np.float64), recording.lidar.returns(recording.ranges)
    wrong = ranges + errors.error(np.where(back, ranges, 0.0))
    return replace(recording, ranges=np.where(back, wrong, ranges).astype(np.float32))


def learnt(log, errors):
    recording = misread(log.recording, errors)
    usable, keys = recording.lidar.range_max, np.arange(0, len(recording), 6)
    return calibrate_ranges(make_clouds(recording, usable), keys, log.truth.poses[keys], usable)


@pytest.mark.slow
@pytest.mark.parametrize("errors", [ERRORS, RangeCalibration(-0.008, 0.003)])
def test_an_error_of_all_ranges_is_learnt(errors):
    found = learnt(log_of(rooms), errors)
    ranges = np.linspace(0.3, 3.5, 20)
    left = np.sqrt(((found.error(ranges) - errors.error(ranges)) ** 2).mean())
    assert left < 0.003
    assert left < 0.35 * np.sqrt((errors.error(ranges) ** 2).mean())


@pytest.mark.slow
def test_turns_that_measure_longer_than_others_are_no_error_of_all():
    log, ranges, left = log_of(rooms).with_scans(slice(720)), np.linspace(0.3, 3.5, 20), []
    for seed in range(8):
        longer = 1.0 + 0.004 * np.random.default_rng(seed).standard_normal((len(log.recording), 1))
        turns = (log.recording.ranges * longer).astype(np.float32)
        found = learnt(replace(log, recording=replace(log.recording, ranges=turns)), ERRORS)
        left.append(found.error(ranges) - ERRORS.error(ranges))
    assert np.sqrt(np.mean(np.square(left))) < 0.004


@pytest.mark.slow
def test_a_lidar_that_measures_right_is_left_alone():
    assert learnt(log_of(rooms), RangeCalibration()) == RangeCalibration()


@pytest.mark.parametrize(("seed", "tilt_rad"), [(3, 0.2), (1, 0.3), (2, 0.2), (1, 0.0)])
def test_what_tilting_a_lidar_by_hand_does_to_its_ranges_is_no_error_of_the_lidar(seed, tilt_rad):
    """A Hokuyo carried about one room, 20 key scans: its ranges were "corrected" by up to 57 mm at 3 m."""
    plan = FloorPlan(8.0, 7.0)
    plan.carve(1.0, 1.0, 7.0, 6.0)
    plan.turned_box(2.0, 5.2, 0.8, 0.5, 0.3)
    plan.turned_box(6.2, 1.8, 0.6, 0.6, 0.8)
    lidar = LidarSpec(682, -np.deg2rad(120.0), np.deg2rad(240.0 / 681), 0.06, 5.6, 0.0, 0.1)
    route, drive = np.array([(2.5, 2.5), (5.0, 2.5), (5.0, 4.5), (3.0, 4.0)]), Drive(v=0.4)
    log = make_log("handheld", plan, route, Sensor(lidar, 0.25), seed=seed, drive=drive).recording
    rng, n, angles = np.random.default_rng(seed), len(log), lidar.angles
    pitch, roll = (tilt_rad * np.sin(np.linspace(0.0, end, n) + rng.uniform(0.0, 6.0)) for end in (9.0, 7.0))
    slope = np.tan(pitch)[:, None] * np.cos(angles) + np.tan(roll)[:, None] * np.sin(angles)
    ranges = (log.ranges * np.hypot(1.0, slope)).astype(np.float32)
    held = replace(log, ranges=ranges, T_odom_base=None, odometry=None)
    assert track_recording(held, SlamConfig(), no_progress).ranges == RangeCalibration()


def test_surfaces_count_that_go_on_in_one_direction_to_either_side():
    clouds = make_clouds(recorded(ROOM, around_the_room(4)), 8.0)
    expected = np.zeros(len(clouds.points), dtype=bool)
    for key in (0, 2):
        scan = slice(clouds.starts[key], clouds.starts[key + 1])
        normals, line_ok = clouds.normals[scan], clouds.line_ok[scan]
        alike = (normals[BESIDE:] * normals[:-BESIDE]).sum(axis=1) > np.cos(UNSURE_RAD)
        goes_on = alike & line_ok[BESIDE:] & line_ok[:-BESIDE]
        expected[scan][BESIDE:-BESIDE] = goes_on[BESIDE:] & goes_on[:-BESIDE]
        assert 40 < expected[scan].sum() < goes_on.sum()
    np.testing.assert_array_equal(straight_points(clouds, np.array([0, 2])), expected)


def test_a_return_stays_a_return_and_nothing_else_changes():
    recording = log_of(rooms).recording
    lidar, strong = recording.lidar, RangeCalibration(-0.2, 0.0)
    ranges = recording.ranges[:3].copy()
    ranges[0, :6] = [np.inf, np.nan, lidar.range_max, 0.0, lidar.range_min, 3.499]
    right = strong.applied(replace(recording, stamps_ns=recording.stamps_ns[:3], ranges=ranges)).ranges
    back = lidar.returns(ranges)
    assert right.dtype == ranges.dtype
    assert lidar.returns(right).tolist() == back.tolist()
    assert np.array_equal(right[~back], ranges[~back], equal_nan=True)
    assert right[0, 5] == pytest.approx(lidar.range_max)
    inside = back & (ranges < 3.0)
    assert right[inside] == pytest.approx(ranges[inside] + 0.2, abs=1e-6)


def test_points_and_lines_are_moved_as_if_made_of_the_right_ranges():
    recording = misread(log_of(rooms).recording, ERRORS)
    some = np.arange(0, len(recording), 50)
    usable = recording.lidar.range_max
    moved = ERRORS.moved(make_clouds(recording, usable, scans=some))
    right = make_clouds(ERRORS.applied(recording), usable, scans=some)
    assert np.abs(moved.points - right.points).max() < 1e-3
    both = moved.line_ok & right.line_ok
    turned = np.arccos(np.clip((moved.normals * right.normals).sum(axis=1)[both], -1.0, 1.0))
    assert np.median(turned) < 0.002
    off = ((moved.centers - right.centers) * right.normals).sum(axis=1)[both]
    assert np.median(np.abs(off)) < 2e-4


@pytest.mark.slow
def test_a_map_has_the_size_of_the_world_all_the_same():
    log = log_of(rooms).with_scans(slice(300))
    recording, worst = misread(log.recording, RangeCalibration(0.0, -0.004)), {}
    for on in (True, False):
        result = run_slam(recording, SlamConfig(calibrate_ranges=on))
        assert (result.session.ranges == RangeCalibration()) is not on
        track, truth = result.trajectory.poses, log.truth.poses
        worst[on] = np.linalg.norm((truth[0] @ track[0].inverse() @ track).xy - truth.xy, axis=1).max()
    assert worst[True] < 0.5 * worst[False]
