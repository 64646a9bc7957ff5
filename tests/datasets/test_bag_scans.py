"""Scans of one geometry and of several, by hand-computed cases."""

import inspect
import math

import numpy as np
import pytest

from turtlebag.datasets.bags.decode import RawScan
from turtlebag.datasets.bags.scans import _finer, _median, assemble, turned_over
from turtlebag.datasets.types import LidarSpec


def scan(ranges, angle_min=0.0, step=0.5, *, angle_max=None, near=0.1, far=8.0, increment=0.01, period=0.2):
    n = len(ranges)
    last = angle_min + (n - 1) * step if angle_max is None else angle_max
    geometry = (angle_min, last, step, increment, period, near, far)
    values = {"geometry": geometry, "ranges": np.asarray(ranges, dtype=np.float32)}
    for name in inspect.signature(RawScan).parameters:
        values.setdefault(name, "laser" if name == "frame" else 0)
    return RawScan(**values)


def test_scans_of_one_geometry_become_a_matrix_as_they_are():
    notes = []
    ranges, lidar = assemble([scan([1, 2, 3]), scan([4, 5, 6])], notes)
    assert ranges.tolist() == [[1, 2, 3], [4, 5, 6]]
    assert lidar == LidarSpec(3, 0.0, 0.5, 0.1, 8.0, 0.01, 0.2)
    assert notes == []


def test_readings_that_are_none_get_their_own_value():
    notes = []
    ranges, _ = assemble([scan([0.0, -1.0, 0.05, 0.1, 8.0, 8.1, np.inf, np.nan])], notes)
    one = np.float32
    np.testing.assert_array_equal(ranges[0], [np.nan, np.nan, -np.inf, one(0.1), *[np.inf] * 3, np.nan])
    assert notes[0].startswith("25.0 % of the readings are 0")
    assert notes[1].startswith("25.0 % of the readings are at or past range_max")


def test_a_few_readings_at_range_max_are_not_worth_a_line():
    for far, said in ((1, 0), (2, 1)):
        notes = []
        ranges, _ = assemble([scan([8.0] * far + [2.0 + 0.01 * k for k in range(200 - far)])], notes)
        assert np.isinf(ranges).sum() == far
        assert len(notes) == said


def test_scans_of_another_geometry_are_put_on_the_nearest_beams():
    usual = [scan([1, 2, 3, 4], -1.0, 0.5)] * 12
    other = scan([5, 6, 7], -0.51, 0.5)
    coarse = scan([7.5, 6.5], -1.0, 1.0)
    notes = []
    ranges, lidar = assemble([*usual, other, coarse], notes)
    assert (lidar.n_beams, lidar.angle_min, lidar.angle_increment) == (4, -1.0, 0.5)
    np.testing.assert_array_equal(ranges[12], np.array([np.nan, 5, 6, 7]))
    np.testing.assert_array_equal(ranges[13], np.array([7.5, np.nan, 6.5, np.nan]))
    assert notes == ["2 scans of another geometry resampled to 4 beams"]


def test_a_scanner_whose_angles_change_is_put_on_a_finer_grid():
    step = 2.0 * math.pi / 8
    scans = [scan(np.arange(8) + 0.5, k * step / 4, step) for k in (0, 0, 1, 2, 3)]
    notes = []
    ranges, lidar = assemble(scans, notes)
    assert notes == ["the beam angles change from scan to scan: put on a grid of 32 beams"]
    assert (lidar.n_beams, lidar.angle_increment, lidar.time_increment) == (32, step / 4, 0.0025)
    for row, k in zip(ranges, (0, 0, 1, 2, 3), strict=True):
        np.testing.assert_array_equal(np.flatnonzero(np.isfinite(row)), np.arange(8) * 4 + k)
        np.testing.assert_array_equal(row[np.isfinite(row)], np.arange(8) + 0.5)
    # a full circle keeps a whole number of beams, a sector its step
    full = _finer(LidarSpec(360, 0.0, 2.0 * math.pi / 359.0, 0.1, 8.0, 0.001, 0.2))
    assert full.angle_increment == pytest.approx(2.0 * math.pi / 1440)
    sector = _finer(LidarSpec(100, 1.0, -0.02, 0.1, 8.0, 0.001, 0.2))
    assert (sector.n_beams, sector.angle_increment) == (400, pytest.approx(-0.005))
    assert sector.time_increment == pytest.approx(0.00025)


def test_beams_off_the_grid_by_a_little_stay_and_a_turn_of_the_circle_is_none():
    step = 2.0 * math.pi / 8
    for off, changed in ((0.04, False), (0.06, True)):
        notes = []
        scans = [scan(np.ones(8), 0.0, step)] * 3 + [scan(np.ones(8), off * step, step)] * 2
        assemble(scans, notes)
        assert ("grid of" in notes[0]) == changed
    notes = []
    ranges, _ = assemble(
        [*[scan([1, 2, 3, 4, 5, 6, 7, 8], 0.0, step)] * 11, scan([6.5, 7.5], -step, step)], notes
    )
    np.testing.assert_array_equal(ranges[11], np.array([7.5, *[np.nan] * 6, 6.5]))
    back = [scan([1, 2, 3], 1.0, -0.5)] * 11 + [scan([6, 7], 0.5, -0.5)]
    np.testing.assert_array_equal(assemble(back, [])[0][11], np.array([np.nan, 6, 7]))


def test_what_a_driver_leaves_out_is_made_up_for_and_said():
    notes = []
    _, lidar = assemble([scan([1, 2, 3], 0.0, 0.0, angle_max=1.0, near=-1.0, far=math.nan)], notes)
    assert (lidar.angle_increment, lidar.range_min, lidar.range_max) == (0.5, 0.0, 100.0)
    assert notes == ["range_max is nan; 100 m used"]
    notes = []
    assert assemble([scan([1, 2, 3], 0.0, 0.5, angle_max=1.5)], notes)[1].n_beams == 3
    assert notes == ["angle_max implies 4 beams, the scans have 3; using the increment"]
    notes = []
    assemble([scan([1, 2, 3], 0.0, 0.5, angle_max=1.24)], notes)
    assert notes == []
    notes = []
    slow = assemble([scan([1, 2, 3], increment=21.0)], notes)[1]
    assert slow.time_increment == 0.0
    assert "a sweep of 63 s" in notes[0]
    assert assemble([scan([1, 2, 3], increment=19.0)], [])[1].time_increment == 19.0
    assert (
        assemble([scan([1, 2], increment=t) for t in (0.01, 0.03, math.nan, 0.02)], [])[1].time_increment
        == 0.02
    )
    assert _median([math.nan]) == 0.0
    notes = []
    ranges, _ = assemble([scan([1, 2]), scan([3, 4], math.nan), scan([5, 6])], notes)
    assert np.isnan(ranges[1]).all()
    assert notes == ["1 scans without a usable geometry left empty"]
    with pytest.raises(ValueError, match="no scan has a usable geometry"):
        assemble([scan([1, 2], math.inf)], [])


@pytest.mark.parametrize(("far", "made"), [(8.0, (0.1, 8.0)), (8000.0, (0.12, 8.0))])
def test_millimetres_are_made_metres_and_so_are_the_limits_if_they_were(far, made):
    notes = []
    ranges, lidar = assemble(
        [scan(np.linspace(600.0, 4000.0, 40), near=made[0] * far / 8.0, far=far)] * 3, notes
    )
    assert (lidar.range_min, lidar.range_max) == pytest.approx(made)
    np.testing.assert_allclose(ranges[0], np.linspace(0.6, 4.0, 40), rtol=1e-6)
    assert len(notes) == 1


def test_a_lidar_upside_down_is_seen_from_below():
    lidar = LidarSpec(4, -1.0, 0.5, 0.1, 8.0, 0.02, 0.2)
    upright = turned_over(lidar)
    assert upright == LidarSpec(4, 1.0, -0.5, 0.1, 8.0, 0.02, 0.2)
    np.testing.assert_allclose(upright.angles, -lidar.angles)
