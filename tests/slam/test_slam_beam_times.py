"""How long a lidar's sweep takes, which way, and where in the array it begins, as the scans show it."""

from dataclasses import replace

import numpy as np
import pytest

from tests.helpers.made_drives import Drive, Sensor, Wheels, lds, make_log, sick
from tests.helpers.made_logs import office_plan
from turtlebag.datasets.types import Trajectory
from turtlebag.pipeline.slam.mapper import SlamConfig, run_slam
from turtlebag.pipeline.slam.sensors.corrected import in_step
from turtlebag.pipeline.slam.times.timing import compared_times

PERIOD = 0.2
ROUTE = np.array(
    [(14.7, 7.0), (10.1, 7.0), (10.1, 10.5), (10.1, 7.0), (14.7, 7.0), (14.7, 10.5), (14.7, 7.0)]
)


def drive(spec, route=ROUTE):
    sensor, wheels = Sensor(spec, PERIOD), Wheels(0.01, 0.03, 0.002)
    return make_log("times", office_plan(1), route, sensor, drive=Drive(v=0.7, w=1.2), wheels=wheels)


@pytest.fixture(scope="module")
def turning():
    """A lidar that turns once per scan, from its first reading on."""
    return drive(replace(lds(), range_max=8.0)).recording


def swept(recording, share):
    """The recording with a declared sweep of this share of the period."""
    lidar = recording.lidar
    return replace(recording, lidar=replace(lidar, time_increment=share * PERIOD / lidar.n_beams))


def begun(recording, first):
    """The recording with its array rolled, so that the sweep begins with this reading."""
    lidar, ranges = recording.lidar, np.roll(recording.ranges, first, axis=1)
    angle_min = lidar.angle_min - first * lidar.angle_increment
    return replace(recording, ranges=ranges, lidar=replace(lidar, angle_min=angle_min))


def backwards(recording):
    """The recording with its readings listed in the opposite order."""
    lidar = recording.lidar
    other = replace(lidar, angle_min=lidar.angles[-1], angle_increment=-lidar.angle_increment)
    return replace(recording, ranges=recording.ranges[:, ::-1].copy(), lidar=other)


def late(recording, seconds):
    """The recording with odometry that much behind its scans."""
    ns, stream = round(seconds * 1e9), recording.odometry
    moved = Trajectory(stream.stamps_ns + ns, stream.poses)
    return replace(recording, T_odom_base=stream.at(recording.stamps_ns - ns), odometry=moved)


def merged(recording, part=slice(90, 270)):
    """Two lidars merged without synchronisation: a part of each scan is one scan old."""
    ranges = recording.ranges.copy()
    ranges[1:, part] = recording.ranges[:-1, part]
    return replace(recording, ranges=ranges)


@pytest.mark.slow
def test_a_sweep_as_declared_stays_and_is_known_with_a_standard_deviation(turning):
    timing = compared_times(turning)
    assert timing[:4] == (0.0, False, None, True)
    share, sigma = timing.times.sweep
    assert sigma < 0.06
    assert share == pytest.approx(1.0, abs=2.0 * sigma)
    assert timing.times.first_beam.value == 0.0
    assert timing.times.upside_down is False
    assert timing.times.apart_s == 0.0
    assert in_step(turning, timing).lidar == turning.lidar


@pytest.mark.slow
@pytest.mark.parametrize("share", [0.0, 1.5, -1.0])
def test_a_wrong_duration_or_direction_of_the_sweep_is_found(turning, share):
    timing = compared_times(swept(turning, share))
    assert timing.late_s == 0.0
    found, sigma = timing.times.sweep
    assert found == pytest.approx(1.0, abs=0.06)
    assert sigma < 0.05
    fixed = in_step(swept(turning, share), timing)
    assert fixed.lidar.time_increment * 360 == pytest.approx(PERIOD, rel=0.1)
    assert fixed.lidar.first_beam == 0
    declared = abs(share) * PERIOD * 359 / 360
    assert fixed.notes[-1].startswith(f"the lidar takes {fixed.lidar.sweep_s:.3f} s for a scan, in the order")
    assert f"where the log says {declared:.3f} s" in fixed.notes[-1]


@pytest.mark.slow
@pytest.mark.parametrize("first", [137, 270])
def test_a_sweep_that_begins_anywhere_in_the_array_is_found(turning, first):
    timing = compared_times(begun(turning, first))
    assert timing.late_s == 0.0
    assert timing.lidar.first_beam == pytest.approx(first, abs=3)
    assert timing.lidar.time_increment * 360 == pytest.approx(PERIOD, rel=0.08)


@pytest.mark.slow
def test_readings_against_the_sweep_late_odometry_and_a_lidar_upside_down_are_told_apart(turning):
    timing = compared_times(backwards(turning))
    assert timing.times.sweep.value == pytest.approx(-1.0, abs=0.06)
    assert (timing.late_s, timing.over, timing.lidar.first_beam) == (0.0, False, 0)
    over = replace(turning, lidar=turning.lidar.turned_over())
    timing = compared_times(late(backwards(over), 0.3))
    assert timing.times.sweep.value == pytest.approx(-1.0, abs=0.06)
    assert timing.late_s == pytest.approx(0.3, abs=0.03)
    assert timing.over
    fixed = in_step(late(backwards(over), 0.3), timing)
    np.testing.assert_allclose(fixed.lidar.angles, backwards(turning).lidar.angles)


@pytest.mark.slow
def test_half_a_scan_from_another_time_is_doubted_and_not_corrected(turning):
    timing = compared_times(merged(turning))
    assert timing.lidar is None
    assert timing.times.apart_s > 0.3 * PERIOD
    result = run_slam(merged(turning), SlamConfig())
    assert any("parts of each scan disagree about the motion" in reason for reason in result.check.reasons)


@pytest.mark.slow
def test_a_quarter_from_another_time_is_seen_although_the_sweep_is_left_as_declared(turning):
    """House `fast` 8211, halves merged without increment: 49 % of the walls elsewhere, and called good."""
    timing = compared_times(merged(swept(turning, 0.0), slice(0, 90)))
    assert timing.lidar is None
    assert timing.times.apart_s > 0.3 * PERIOD


@pytest.mark.slow
@pytest.mark.parametrize("spec", [replace(lds(), range_max=8.0, time_increment=0.0), sick(180, 30.0)])
def test_a_lidar_that_takes_all_beams_at_once_has_no_sweep(spec):
    timing = compared_times(drive(spec).recording)
    assert timing[:4] == (0.0, False, None, True)
    assert timing.times.sweep.value == pytest.approx(0.0, abs=0.05)


@pytest.mark.slow
def test_a_straight_drive_shows_neither_delay_nor_sweep():
    recording = drive(replace(lds(), range_max=8.0), np.array([(10.0, 7.0), (26.0, 7.0)])).recording
    for share in (0.0, 1.0):
        timing = compared_times(swept(recording, share))
        assert timing[:4] == (0.0, False, None, True)
        assert timing.times.sweep is None
        assert timing.times.first_beam is None
        assert timing.times.upside_down is None
