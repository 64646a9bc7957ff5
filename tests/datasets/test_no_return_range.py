"""Returns and their absence, by every convention of drivers."""

from dataclasses import replace

import numpy as np
import pytest

from tests.helpers.carmen_lines import flaser, write
from tests.helpers.foreign_bags import SCAN, laser_scan, write_foreign
from tests.helpers.slam_rooms import CORRIDOR, SICK, recording
from turtlebag.datasets.no_return_range import no_return_value
from turtlebag.datasets.recordings import load_recording
from turtlebag.datasets.se2 import SE2
from turtlebag.datasets.types import Observation as Seen
from turtlebag.datasets.types import Odometry, Scan
from turtlebag.pipeline.localisation.deskewed_beams import prepare
from turtlebag.pipeline.navigation.sensing import Sensing
from turtlebag.pipeline.slam.grid import OccupancyConfig, make_grid
from turtlebag.pipeline.slam.scans.clouds import make_clouds
from turtlebag.pipeline.slam.scans.range_noise import range_noise
from turtlebag.pipeline.slam.sensors.repeated_scans import without_repeats

NEAR = replace(SICK, range_max=5.6)  # no float32 number: the messages' own is a little less
DRIVE = np.stack([0.1 * np.arange(20), 0.3 * np.ones(20), 0.02 * np.arange(20)], axis=1)


@pytest.fixture(scope="module")
def corridor():
    """A corridor whose ends no beam reaches, as REP-117 says it: +inf."""
    log = recording(CORRIDOR, DRIVE, NEAR)
    log.ranges[log.ranges > 5.59] = np.inf
    assert 0.1 < np.isposinf(log.ranges).mean() < 0.5
    return log


def sent_as(log, value):
    """The log of a driver that sends `value` for "no return"."""
    return replace(log, ranges=np.where(np.isposinf(log.ranges), np.float32(value), log.ranges))


@pytest.mark.parametrize("value", [5.6, 5.7, 81.91], ids=["range_max", "a little more", "far more"])
def test_a_reading_at_range_max_or_past_it_is_no_return_to_anyone(corridor, value):
    log = sent_as(corridor, value)
    poses = SE2.from_array(DRIVE)
    for ours, theirs in zip(make_clouds(log, 30.0), make_clouds(corridor, 30.0), strict=True):
        np.testing.assert_array_equal(ours, theirs)
    assert range_noise(log, 30.0) == range_noise(corridor, 30.0)
    grids = [make_grid(one, poses, OccupancyConfig(), 30.0).cells for one in (log, corridor)]
    np.testing.assert_array_equal(*grids)
    for name in ("points", "silent_directions"):
        beams = [getattr(prepare(one.scan(3), log.T_base_lidar), name) for one in (log, corridor)]
        np.testing.assert_array_equal(*beams)
    scans = [seen(one.scan(3)) for one in (log, corridor)]
    np.testing.assert_array_equal(scans[0].hits_odom, scans[1].hits_odom)
    np.testing.assert_array_equal(scans[0].passes_odom, scans[1].passes_odom)


def seen(scan: Scan):
    sensing = Sensing(SE2.identity())
    still = Odometry(scan.stamp_ns, SE2.identity(), None)
    return sensing.observe(Seen(scan.stamp_ns, still, None, scan))


def bag_of(tmp_path, ranges, **changes):
    limits = {"angle_min": -np.pi / 2, "range_max": 30.0, **changes}
    scans = [laser_scan(k * 10**8, row, **limits) for k, row in enumerate(ranges)]
    return write_foreign(tmp_path / "bag", [("/scan", SCAN, k, scan) for k, scan in enumerate(scans)])


def log_of(tmp_path, ranges):
    lines = [flaser(row, stamp=f"{k}.5") for k, row in enumerate(ranges)]
    return write(tmp_path, "".join(lines))


@pytest.mark.parametrize("make", [bag_of, log_of], ids=["bag", "CARMEN log"])
@pytest.mark.parametrize("value", [5.6, 29.99])
def test_a_value_at_which_many_beams_pile_up_at_the_far_end_is_no_return(tmp_path, corridor, make, value):
    piled = np.round(sent_as(corridor, value).ranges, 2)
    found = load_recording(make(tmp_path, piled))
    np.testing.assert_array_equal(np.isposinf(found.ranges), np.isposinf(corridor.ranges))
    assert any(f"{value:g} m" in note and "no return" in note for note in found.notes)


def test_readings_at_range_max_become_no_return_in_a_bag(tmp_path):
    found = load_recording(bag_of(tmp_path, [[1.0, 5.59, 5.6, 5.61]], range_max=5.6))
    np.testing.assert_array_equal(np.isposinf(found.ranges[0]), [False, False, True, True])


def test_two_codes_and_the_odd_reading_beyond_them_are_no_returns():
    rng = np.random.default_rng(2)
    readings = np.round(rng.uniform(0.5, 20.0, (100, 180)), 2)
    readings[:, :20], readings[:, 20:25], readings[0, 30] = 29.99, 29.9, 30.0
    assert no_return_value(readings) == 29.9


def test_what_walls_give_is_no_pile():
    rng = np.random.default_rng(3)
    standing = np.tile(np.round(rng.uniform(0.5, 9.0, 180), 2), (200, 1))  # a robot that never moves
    assert no_return_value(standing) == np.inf
    angles = SICK.angles
    ahead, beside = 5.0 / np.cos(angles[1:]), 2.0 / np.maximum(np.abs(np.sin(angles[1:])), 1e-9)
    square_on = np.tile(np.round(np.minimum(ahead, beside), 2), (50, 1))
    assert no_return_value(square_on) == np.inf
    before_it = rng.uniform(0.5, 20.0, (100, 180))
    before_it[:, :20] = 10.0  # many beams at one value, but others see as far again
    assert no_return_value(before_it) == np.inf
    assert no_return_value(np.where(np.arange(180) < 60, 1.0, 3.0)[None]) == np.inf


def test_beams_put_on_a_finer_grid_have_the_same_noise_lines_and_open_space(corridor):
    """Interlaced scans leave other columns empty than the one before; nothing else may change."""
    ranges = np.full((len(corridor), 4 * SICK.n_beams), np.nan, dtype=np.float32)
    ranges[:, ::4] = corridor.ranges
    lidar = replace(NEAR, n_beams=4 * SICK.n_beams, angle_increment=SICK.angle_increment / 4)
    finer = replace(corridor, ranges=ranges, lidar=lidar)
    assert (corridor.stride, finer.stride) == (1, 4)
    noise, expected = ({**vars(range_noise(one, 30.0)), "others": 0.0} for one in (finer, corridor))
    assert noise == pytest.approx(expected)
    ours, theirs = make_clouds(finer, 30.0), make_clouds(corridor, 30.0)
    np.testing.assert_allclose(ours.normals, theirs.normals, atol=1e-9)
    np.testing.assert_array_equal(ours.line_ok, theirs.line_ok)
    assert ours.table.shape == theirs.table.shape
    grids = [
        make_grid(one, SE2.from_array(DRIVE), OccupancyConfig(), 30.0).cells for one in (finer, corridor)
    ]
    np.testing.assert_array_equal(*grids)


def test_sweeps_sent_again_while_the_robot_moves_are_not_used():
    log = recording(CORRIDOR, DRIVE, SICK, odometry=DRIVE)
    log.ranges[8:13] = log.ranges[7]
    log.ranges[15, 3] = np.nan
    log.ranges[16] = log.ranges[15]
    found = without_repeats(log, 30.0)
    assert np.flatnonzero(np.isnan(found.ranges).all(axis=1)).tolist() == [8, 9, 10, 11, 12, 16]
    kept = [k for k in range(len(log)) if k not in (8, 9, 10, 11, 12, 16)]
    np.testing.assert_array_equal(found.ranges[kept], log.ranges[kept])
    assert "6 scans are exact copies of an earlier one" in found.notes[-1]


@pytest.mark.parametrize("odometry", [SE2.from_array(np.tile(DRIVE[:1], (20, 1))), None])
def test_the_same_sweep_from_a_standing_robot_stays(odometry):
    log = replace(recording(CORRIDOR, np.tile(DRIVE[:1], (20, 1)), SICK), T_odom_base=odometry)
    log.ranges[5:] = log.ranges[4]
    assert without_repeats(log, 30.0) is log


def test_a_lidar_without_noise_may_measure_the_same_again():
    log = recording(CORRIDOR, np.tile(DRIVE[:1], (20, 1)), SICK, noise=0.0, odometry=DRIVE)
    assert without_repeats(log, 30.0) is log


def test_a_code_that_few_beams_give_is_one_all_the_same():
    """0.29 % of the readings stand at 26 m and nothing near: they became walls."""
    rng = np.random.default_rng(4)
    readings = np.round(rng.gamma(2.0, 2.0, (200, 180)), 2)
    readings.flat[:: round(1 / 0.0029)] = 26.0
    assert no_return_value(readings) == 26.0


def test_several_codes_beside_each_other_are_all_codes():
    """As a SICK of 2005 says it: 51.15, 51.14 and 50 m."""
    rng = np.random.default_rng(5)
    readings = np.round(rng.gamma(2.0, 4.0, (200, 180)), 2)
    readings[:, :10], readings[:, 10:13], readings[:, 13] = 51.15, 51.14, 50.0
    assert no_return_value(readings) == 50.0


def test_a_wall_far_away_that_a_standing_robot_sees_again_and_again_is_a_wall():
    rng = np.random.default_rng(6)
    readings = np.round(rng.uniform(0.5, 8.0, (300, 180)), 2)
    readings[:, 90] = np.round(20.0 + 0.01 * rng.standard_normal(300), 2)
    assert no_return_value(readings) == np.inf


def test_a_lidar_that_says_one_metre_in_all_directions_wherever_the_robot_is_sees_nothing():
    log = recording(CORRIDOR, DRIVE, SICK, odometry=DRIVE)
    rng = np.random.default_rng(7)
    for noise in (0.0, 0.005):
        ranges = (1.0 + noise * rng.standard_normal(log.ranges.shape)).astype(np.float32)
        found = without_repeats(replace(log, ranges=ranges), 30.0)
        # the first scans, up to 0.2 m away, may have seen a round place
        assert np.flatnonzero(np.isnan(found.ranges).all(axis=1)).tolist() == list(range(3, 20))
        assert "17 scans are one range in all directions although the odometry moves" in found.notes[-1]
