"""CARMEN logs line by line, and implausible numbers and units at their limits."""

import math
from pathlib import Path

import numpy as np
import pytest

from turtlebag.datasets.bags import plausibility
from turtlebag.datasets.carmen import is_carmen, parse_carmen
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


def log_of(poses_base, *, poses_lidar=None, readings=None, stamps=None, params=()):
    """A log of scans at poses (n, 3), a second apart if not told: the recording that is read of it."""
    poses_base = np.asarray(poses_base)
    poses_lidar = poses_base if poses_lidar is None else poses_lidar
    stamps = range(len(poses_base)) if stamps is None else stamps
    readings = [[1.0, 2.0, 3.0]] * len(poses_base) if readings is None else readings
    lines = [f"PARAM {name} {value}" for name, value in params]
    for row, lidar, base, stamp in zip(readings, poses_lidar, poses_base, stamps, strict=True):
        words = " ".join(repr(float(value)) for value in (*row, *lidar, *base))
        lines.append(f"FLASER {len(row)} {words} {stamp} host {stamp}")
    return parse_carmen("\n".join(lines).encode(), Path("a.log"), T_base_lidar=None, notes=[])


def told(recording, part):
    return [note for note in recording.notes if part in note]


def test_millimetres_become_metres_apart_for_readings_and_poses():
    readings = np.random.default_rng(2).uniform(900.0, 4000.0, (20, 30))
    poses = np.arange(20)[:, None] * [200.0, 100.0, 0.01]
    in_metres = poses * [1e-3, 1e-3, 1.0]
    both = log_of(poses, readings=readings)
    np.testing.assert_allclose(both.ranges, 1e-3 * readings, rtol=1e-6)
    np.testing.assert_allclose(both.T_odom_base.xyt, in_metres)
    assert len(told(both, "read as millimetres")) == 2
    neither = log_of(in_metres, readings=1e-3 * readings)
    assert told(neither, "millimetres") == []
    only_readings = log_of(in_metres, readings=readings)
    assert len(told(only_readings, "readings exceed any lidar's range; read as millimetres")) == 1
    for same in (neither, only_readings):
        np.testing.assert_allclose(same.ranges, both.ranges, rtol=1e-6)
        np.testing.assert_allclose(same.T_odom_base.xyt, in_metres)


def test_the_laser_sits_where_the_poses_say_or_else_the_parameter():
    rng = np.random.default_rng(3)
    base = SE2(rng.normal(size=(9, 3)))
    fixed = log_of(base.xyt, poses_lidar=(base @ SE2.from_xyt(0.12345, -0.05, 0.3)).xyt)
    np.testing.assert_allclose(fixed.T_base_lidar.xyt, [0.1234, -0.05, 0.3], atol=6e-5)
    params = [("robot_frontlaser_offset", "0.27")]
    same = log_of(base.xyt, params=params)
    np.testing.assert_array_equal(same.T_base_lidar.xyt, [0.27, 0.0, 0.0])
    assert told(same, "laser taken") + told(fixed, "laser taken") == []
    shaken = base @ SE2.from_xyt(rng.normal(0.0, 0.1, 9), np.zeros(9), np.zeros(9))
    loose = log_of(base.xyt, poses_lidar=shaken.xyt, params=params)
    np.testing.assert_array_equal(loose.T_base_lidar.xyt, [0.27, 0.0, 0.0])
    note = "laser and robot poses are not rigidly linked; laser taken 0.27 m ahead of the robot"
    assert told(loose, "laser taken") == [note]
    for bad in ((), [("robot_frontlaser_offset", "x")]):
        np.testing.assert_array_equal(log_of(base.xyt, params=bad).T_base_lidar.xyt, [0.0, 0.0, 0.0])


@pytest.mark.parametrize(
    ("stamps", "period"),
    [
        (["0", "0.2", "0.4", "0.3", "0.3", "0.3", "0.3", "0.5"], 0.2),
        ([0, 0, 0, 5, 5, 5, 5], 5.0),
        ([7, 7], 0.0),
        ([7], 0.0),
    ],
)
def test_the_period_is_the_usual_step_forwards(stamps, period):
    assert log_of(np.zeros((len(stamps), 3)), stamps=stamps).lidar.scan_time == pytest.approx(period)


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
