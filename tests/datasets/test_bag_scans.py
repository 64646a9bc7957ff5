"""Scans of one geometry and of several, by hand-computed cases."""

import inspect
import math

import numpy as np
import pytest

from turtlebag.datasets.bags.decode import RawScan
from turtlebag.datasets.bags.scans import assemble
from turtlebag.datasets.types import LidarSpec


def scan(ranges, angle_min=0.0, step=0.5, *, angle_max=None, near=0.1, far=8.0, increment=0.01, period=0.2):
    n = len(ranges)
    last = angle_min + (n - 1) * step if angle_max is None else angle_max
    geometry = (angle_min, last, step, increment, period, near, far)
    values = {"geometry": geometry, "ranges": np.asarray(ranges, dtype=np.float32)}
    for name in inspect.signature(RawScan).parameters:
        values.setdefault(name, "laser" if name == "frame" else 0)
    return RawScan(**values)


def assembled(scans):
    """Ranges, lidar and what was found, without its topic."""
    findings = []
    ranges, lidar = assemble("/scan", scans, np.arange(len(scans)), findings)
    return ranges, lidar, [str(finding).removeprefix("/scan: ") for finding in findings]


def test_scans_of_one_geometry_become_a_matrix_as_they_are():
    ranges, lidar, said = assembled([scan([1, 2, 3]), scan([4, 5, 6])])
    assert ranges.tolist() == [[1, 2, 3], [4, 5, 6]]
    assert lidar == LidarSpec(3, 0.0, 0.5, 0.1, 8.0, 0.01, 0.2)
    assert said == []


def test_readings_that_are_none_get_their_own_value():
    ranges, _, said = assembled([scan([0.0, -1.0, 0.05, 0.1, 8.0, 8.1, np.inf, np.nan])])
    one = np.float32
    np.testing.assert_array_equal(ranges[0], [np.nan, np.nan, -np.inf, one(0.1), *[np.inf] * 3, np.nan])
    assert said == [
        "25.0 % of the readings are 0; read as invalid, not as free space",
        "25.0 % of the readings are at or past range_max; read as no return",
    ]


@pytest.mark.parametrize("reading", [8.0, 0.0])
def test_a_few_readings_at_range_max_or_0_are_not_worth_a_line(reading):
    for few, lines in ((1, 0), (2, 1)):
        ranges, _, said = assembled([scan([reading] * few + [2.0 + 0.01 * k for k in range(200 - few)])])
        assert (~np.isfinite(ranges)).sum() == few
        assert len(said) == lines


@pytest.mark.parametrize(
    ("rows", "says"),
    [
        ([[math.nan] * 2, [1.0, math.nan]], ["1 of 2 scans are NaN only"]),
        ([[math.inf, 0.0], [1.0, 2.0], [math.inf] * 2], ["2 of 3 scans have no return at all"]),
        ([[1.0, math.inf]], []),
    ],
)
def test_scans_without_a_number_or_a_return_are_counted(rows, says):
    said = assembled([scan(row) for row in rows])[2]
    assert [line for line in said if "scans" in line] == says


def test_scans_of_another_geometry_are_put_on_the_nearest_beams():
    usual = [scan([1, 2, 3, 4], -1.0, 0.5)] * 12
    other = scan([5, 6, 7], -0.51, 0.5)
    coarse = scan([7.5, 6.5], -1.0, 1.0)
    ranges, lidar, said = assembled([*usual, other, coarse])
    assert (lidar.n_beams, lidar.angle_min, lidar.angle_increment) == (4, -1.0, 0.5)
    np.testing.assert_array_equal(ranges[12], np.array([np.nan, 5, 6, 7]))
    np.testing.assert_array_equal(ranges[13], np.array([7.5, np.nan, 6.5, np.nan]))
    assert said == ["2 scans of another geometry (2..4 readings); resampled to 4 beams"]


def test_a_scanner_whose_angles_change_is_put_on_a_finer_grid():
    step = 2.0 * math.pi / 8
    scans = [scan(np.arange(8) + 0.5, k * step / 4, step) for k in (0, 0, 1, 2, 3)]
    ranges, lidar, said = assembled(scans)
    assert said[0] == "the beam angles change from scan to scan; put on a grid of 32 beams"
    assert (lidar.n_beams, lidar.angle_increment, lidar.time_increment) == (32, step / 4, 0.0025)
    for row, k in zip(ranges, (0, 0, 1, 2, 3), strict=True):
        np.testing.assert_array_equal(np.flatnonzero(np.isfinite(row)), np.arange(8) * 4 + k)
        np.testing.assert_array_equal(row[np.isfinite(row)], np.arange(8) + 0.5)


@pytest.mark.parametrize(
    ("n", "step", "beams", "finer"),
    [(360, 2.0 * math.pi / 359.0, 1440, 2.0 * math.pi / 1440), (100, -0.02, 400, -0.005)],
    ids=["a full circle keeps a whole number of beams", "a sector keeps its step"],
)
def test_the_finer_grid_spans_the_same_sweep(n, step, beams, finer):
    scans = [scan(np.ones(n), 1.0 + part * step, step, increment=0.001) for part in (0.0, 0.0, 0.3)]
    lidar = assembled(scans)[1]
    assert (lidar.n_beams, lidar.angle_increment) == (beams, pytest.approx(finer))
    assert lidar.time_increment == pytest.approx(0.001 * finer / step)


def test_beams_off_the_grid_by_a_little_stay_and_a_turn_of_the_circle_is_none():
    step = 2.0 * math.pi / 8
    for off, changed in ((0.04, False), (0.06, True)):
        scans = [scan(np.ones(8), 0.0, step)] * 3 + [scan(np.ones(8), off * step, step)] * 2
        assert ("grid of" in assembled(scans)[2][0]) == changed
    ranges = assembled([*[scan([1, 2, 3, 4, 5, 6, 7, 8], 0.0, step)] * 11, scan([6.5, 7.5], -step, step)])[0]
    np.testing.assert_array_equal(ranges[11], np.array([7.5, *[np.nan] * 6, 6.5]))
    back = [scan([1, 2, 3], 1.0, -0.5)] * 11 + [scan([6, 7], 0.5, -0.5)]
    np.testing.assert_array_equal(assembled(back)[0][11], np.array([np.nan, 6, 7]))


def test_what_a_driver_leaves_out_is_made_up_for_and_said():
    _, lidar, said = assembled([scan([1, 2, 3], 0.0, 0.0, angle_max=1.0, near=-1.0, far=math.nan)])
    assert (lidar.angle_increment, lidar.range_min, lidar.range_max) == (0.5, 0.0, 100.0)
    assert said == [
        "angle_increment is 0; angle_min and angle_max say 0.5 rad",
        "valid ranges -1..nan m; 0..100 m used",
    ]
    _, lidar, said = assembled([scan([1, 2, 3], 0.0, 0.5, angle_max=1.5)])
    assert lidar.n_beams == 3
    implied = "3 readings, but angle_min, angle_max and the increment imply 4; the increment is used"
    assert said == [implied]
    assert assembled([scan([1, 2, 3], 0.0, 0.5, angle_max=1.24)])[2] == []
    ranges, _, said = assembled([scan([1, 2]), scan([3, 4], math.nan), scan([5, 6])])
    assert np.isnan(ranges[1]).all()
    assert said == ["1 scan without a usable geometry; left empty"]
    with pytest.raises(ValueError, match=r"2 readings from inf rad on, 0\.5 rad apart"):
        assembled([scan([1, 2], math.inf)])


@pytest.mark.parametrize(
    ("near", "far", "used"),
    [
        (8.0, 8.0, (8.0, 100.0)),
        (-0.1, 8.0, (0.0, 8.0)),
        (0.0, math.inf, (0.0, 100.0)),
        (0.1, 0.0, (0.1, 100.0)),
    ],
)
def test_limits_that_leave_no_valid_range_are_made_up_for(near, far, used):
    _, lidar, said = assembled([scan([1, 2, 3], near=near, far=far)])
    assert (lidar.range_min, lidar.range_max) == used
    assert said[0] == f"valid ranges {near:g}..{far:g} m; {used[0]:g}..{used[1]:g} m used"


def test_a_sweep_takes_a_minute_at_the_most_and_usually_the_time_between_scans():
    _, lidar, said = assembled([scan([1, 2, 3], increment=21.0)])
    assert lidar.time_increment == 0.0
    assert said == ["time_increment implies a sweep of 63.000 s; taken as 0"]
    assert assembled([scan([1, 2, 3], increment=19.0)])[1].time_increment == 19.0
    varied = assembled([scan([1, 2], increment=t) for t in (0.01, 0.03, math.nan, 0.02)])
    assert varied[1].time_increment == 0.02
    assert assembled([scan([1, 2], increment=math.nan)])[1].time_increment == 0.0
    for increment, slow in ((0.039, False), (0.041, True)):
        scans = [scan([1, 2, 3], increment=increment)._replace(stamp_ns=k * 10**8) for k in range(4)]
        _, lidar, said = assembled(scans)
        assert lidar.time_increment == (0.0 if slow else pytest.approx(increment))
        assert any("implies a sweep of 0.123 s, a scan comes every 0.100 s" in line for line in said) == slow


@pytest.mark.parametrize(("far", "made"), [(8.0, (0.1, 8.0)), (8000.0, (0.12, 8.0))])
def test_millimetres_are_made_metres_and_so_are_the_limits_if_they_were(far, made):
    near = made[0] * far / 8.0
    ranges, lidar, said = assembled([scan(np.linspace(600.0, 4000.0, 40), near=near, far=far)] * 3)
    assert (lidar.range_min, lidar.range_max) == pytest.approx(made)
    np.testing.assert_allclose(ranges[0], np.linspace(0.6, 4.0, 40), rtol=1e-6)
    assert said == ["the readings exceed any lidar's range; read as millimetres"]


def test_a_lidar_upside_down_is_seen_from_below():
    lidar = LidarSpec(4, -1.0, 0.5, 0.1, 8.0, 0.02, 0.2)
    upright = lidar.turned_over()
    assert upright == LidarSpec(4, 1.0, -0.5, 0.1, 8.0, 0.02, 0.2)
    np.testing.assert_allclose(upright.angles, -lidar.angles)
