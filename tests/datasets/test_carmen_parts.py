"""Implausible numbers and units, function by function, at their limits."""

import math
from pathlib import Path

import numpy as np
import pytest

from turtlebag.datasets.bags import plausibility
from turtlebag.datasets.carmen import (
    _in_metres,
    _laser_pose,
    _period,
    is_carmen,
    parse_carmen,
)
from turtlebag.datasets.errors import InputError
from turtlebag.datasets.se2 import SE2


@pytest.mark.parametrize(
    "kind", [b"FLASER ", b"ROBOTLASER1 ", b"RLASER ", b"ODOM ", b"PARAM ", b"RAWLASER4", b"SYNC "]
)
def test_a_log_is_told_by_a_line_of_a_known_kind_near_its_beginning(kind):
    assert is_carmen(b"hello\n" + kind + b"1")
    assert is_carmen(b"# CARMEN Logfile\nx")
    assert not is_carmen(b"hello\n# CARMEN\nx " + kind)
    assert not is_carmen(b"x" * 65535 + b"\n" + kind)


@pytest.mark.parametrize("text", ["1 x 0 0 0 3 4 5", "1 2 0 0 0 3 2e8 5", "1 2 0 nan 0 3 4 5"])
def test_lines_with_words_or_impossible_poses_are_damaged(text):
    good, unreadable = (
        b"FLASER 2 %b 1.5 host 1.0" % words for words in (b"inf 2 0 0 0 3 4 5", text.encode())
    )
    found = parse_carmen(b"\n".join([unreadable, good, unreadable]), Path("a"), T_base_lidar=None, notes=[])
    assert found.ranges.tolist() == [[np.inf, 2.0]]
    np.testing.assert_allclose(found.T_odom_base.xyt, SE2.from_xyt([3.0], [4.0], [5.0]).xyt)
    assert "2 damaged lines skipped, the first is line 1" in found.notes


def test_millimetres_become_metres_apart_for_readings_and_poses():
    stamps = np.arange(20, dtype=np.int64) * 10**9
    rng = np.random.default_rng(2)
    values = np.column_stack([rng.uniform(900.0, 4000.0, (20, 30)), np.zeros((20, 6))])
    values[:, [-6, -5, -4, -3, -2, -1]] = np.arange(20)[:, None] * [200.0, 100.0, 0.01, 200.0, 100.0, 0.01]
    notes = []
    found = _in_metres(values, stamps, notes)
    np.testing.assert_allclose(found[:, :-6], 1e-3 * values[:, :-6])
    np.testing.assert_allclose(found[:, -6:], values[:, -6:] * [1e-3, 1e-3, 1, 1e-3, 1e-3, 1])
    assert len(notes) == 2
    metres = found.copy()
    assert _in_metres(metres, stamps, notes) is metres
    assert len(notes) == 2
    readings_only = np.column_stack([values[:, :-6], found[:, -6:]])
    np.testing.assert_allclose(_in_metres(readings_only, stamps, notes), found)


def test_the_laser_sits_where_the_poses_say_or_else_the_parameter():
    rng = np.random.default_rng(3)
    base = SE2(rng.normal(size=(9, 3)))
    notes = []
    fixed = _laser_pose(base, base @ SE2.from_xyt(0.12345, -0.05, 0.3), {}, notes)
    np.testing.assert_allclose(fixed.xyt, [0.1234, -0.05, 0.3], atol=6e-5)
    params = {b"robot_frontlaser_offset": b"0.27"}
    np.testing.assert_array_equal(_laser_pose(base, base, params, notes).xyt, [0.27, 0.0, 0.0])
    assert notes == []
    loose = base @ SE2.from_xyt(rng.normal(0.0, 0.1, 9), np.zeros(9), np.zeros(9))
    np.testing.assert_array_equal(_laser_pose(base, loose, params, notes).xyt, [0.27, 0.0, 0.0])
    assert notes == ["laser and robot poses are not rigidly linked; laser taken 0.27 m ahead of the robot"]
    for bad in ({}, {b"robot_frontlaser_offset": b"x"}):
        np.testing.assert_array_equal(_laser_pose(base, base, bad, notes).xyt, [0.0, 0.0, 0.0])


def test_the_period_is_the_usual_step_forwards():
    assert _period(np.array([0, 2, 4, 3, 3, 3, 3, 5]) * 10**8) == pytest.approx(0.2)
    assert _period(np.array([0, 0, 0, 5, 5, 5, 5]) * 10**9) == pytest.approx(5.0)
    assert _period(np.array([7, 7])) == 0.0
    assert _period(np.array([7])) == 0.0


GOOD = b"FLASER 3 1 2 3 0.1 0 0 0.2 0.3 0.4 5.25 host 1.0"


def test_a_log_is_read_line_by_line():
    notes = []
    content = b"\n".join(
        [
            b"PARAM robot_frontlaser_offset 0.5",
            b"PARAM short",
            GOOD,
            b"FLASER 3 1 2 3 0 0 0 0 0 0 4.5 h 1",
            b"RLASER x",
            GOOD + b" more",
            b"FLASER 0 0 0 0 0 0 0 1.5 h 1",
            b"FLASER 3 1 2 3 0 0 0 0 0 0 -1 h 1",
            b"FLASER 3 1 2 3 0 0 0 0 0 0 2147483648 h 1",
            b"FLASER",
        ]
    )
    found = parse_carmen(content, Path("a.log"), T_base_lidar=None, notes=notes)
    assert found.stamps_ns.tolist() == [5_250_000_000, 4_500_000_000]
    np.testing.assert_allclose(found.T_odom_base.xyt, [[0.2, 0.3, 0.4], [0.0, 0.0, 0.0]])
    # so few readings do not tell a wall from a code for no return
    assert found.ranges.tolist() == [[1.0, 2.0, 3.0]] * 2
    assert found.notes[1:4] == (
        "5 damaged lines skipped, the first is line 6",
        "1 rear laser scans (RLASER) not used",
        "stamps go back 1 time; file order kept",
    )
    assert (found.lidar.range_min, found.lidar.range_max, found.lidar.n_beams) == (0.0, 4.0, 3)
    told = parse_carmen(content, Path("a"), T_base_lidar=SE2.from_xyt(1.0, 2.0, 3.0), notes=[])
    np.testing.assert_array_equal(told.T_base_lidar.xyt, SE2.from_xyt(1.0, 2.0, 3.0).xyt)
    for text, says in (
        (b"ODOM 1", "no FLASER or ROBOTLASER1 line"),
        (GOOD + b" x", "only damaged scan lines"),
    ):
        with pytest.raises(InputError, match=f"a: {says}"):
            parse_carmen(text, Path("a"), T_base_lidar=None, notes=[])


# units


def test_beams_have_directions_from_finite_angles_a_real_step_apart():
    for angles, expected in (
        ((0.0, 0.01, 3), True), ((99.9, 0.01, 3), True), ((-100.0, 0.01, 3), False), ((0.0, 1e-5, 3), True),
        ((0.0, -9e-6, 3), False), ((0.0, 0.0, 1), True), ((0.0, -math.pi, 2), True), ((0.0, 3.15, 2), False),
        ((0.0, 0.01, 0), False), ((math.nan, 0.01, 3), False), ((0.0, math.inf, 1), False),
    ):  # fmt: skip
        assert plausibility.directed(*angles) == expected


def test_clocks_and_places_that_cannot_be():
    assert [plausibility.stands_still(s) for s in ([5, 5], [5, 6, 5], [5], [])] == [True, False, False, False]
    assert [plausibility.far_away(p) for p in ((0, 1, 2), (0, -1e8, 0), (0, 9.9e7, 0), (math.nan, 0, 0))] == [
        False,
        True,
        False,
        True,
    ]
    assert [plausibility.limits_in_millimetres(m) for m in (1000.0, 1000.1)] == [False, True]


def test_ranges_are_millimetres_when_most_are_longer_than_any_lidar_sees():
    ramp = np.linspace(600.0, 4000.0, 100)
    for ranges, top, expected in (
        (ramp, 8.0, True), (ramp, 3500.0, True), (ramp, 1000.0, False), (ramp / 1000.0, 8.0, False),
        (np.full(100, 900.0), 8.0, False), (ramp / 30.0, 30.0, False), (ramp / 11.0, 30.0, True),
        (ramp / 11.0, 90.0, False), (np.full(100, np.nan), 8.0, False), (ramp * 1000.0, 8.0, False),
        (np.r_[ramp, np.full(13, 1.0)], 8.0, False),
        (np.r_[ramp, np.zeros(90), -np.ones(90), np.full(90, np.inf)], 8.0, True),
        (np.r_[ramp, np.full(900, 3600.0)], 3500.0, True),
        (np.r_[np.full(900, 600.0), 610.0, 640.0], 8.0, False),
    ):  # fmt: skip
        assert plausibility.ranges_in_millimetres(ranges, top) == expected


def test_a_drive_is_in_millimetres_when_seconds_of_it_are_faster_than_any_robot():
    stamps = np.arange(0, 30 * 10**9 + 1, 10**8)

    def at(speed, of=stamps):
        return np.column_stack([of * 1e-9 * speed * 0.6, of * 1e-9 * speed * 0.8])

    assert plausibility.driven_in_millimetres(stamps, at(50.1))
    assert not plausibility.driven_in_millimetres(stamps, at(49.9))
    mixed = np.random.default_rng(4).permutation(len(stamps))
    assert plausibility.driven_in_millimetres(stamps[mixed], at(50.1)[mixed])
    assert not plausibility.driven_in_millimetres(stamps[mixed], at(49.9)[mixed])
    # one leap is none: nine seconds in ten are slow
    leap = at(1.0)
    leap[150:] += 5000.0
    assert not plausibility.driven_in_millimetres(stamps, leap)
    assert not plausibility.driven_in_millimetres(stamps[:10], at(500.0)[:10])
    assert plausibility.driven_in_millimetres(stamps[:11], at(500.0)[:11])
    assert not plausibility.driven_in_millimetres(stamps[:1], at(500.0)[:1])
    sparse = np.array([0, 10, 20]) * 10**9
    assert plausibility.driven_in_millimetres(sparse, at(60.0, sparse))
    assert not plausibility.driven_in_millimetres(sparse, at(40.0, sparse))
