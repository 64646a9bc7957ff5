"""Stopped clocks, two lasers on one topic, millimetres, absurd places: reported, and corrected for
mapping."""

import numpy as np
import pytest

from tests.helpers.foreign_bags import ODOMETRY, SCAN, TF, laser_scan, odometry, tf, transform, write_foreign
from turtlebag.datasets.bags.doctor import examine
from turtlebag.datasets.bags.plausibility import driven_in_millimetres, ranges_in_millimetres
from turtlebag.datasets.errors import InputError
from turtlebag.datasets.recordings import load_recording
from turtlebag.pipeline.cli.main import main

STEP = 100_000_000
RANGES = np.linspace(1.0, 3.0, 360)
STILL = (0, 0, 0, 1)


def scan(k, time=None, scale=1.0, frame="base_scan", **changes):
    return (
        "/scan",
        SCAN,
        k * STEP,
        laser_scan(k * STEP if time is None else time, scale * RANGES, frame, **changes),
    )


def odom(k, time=None, scale=1.0, **changes):
    time = k * STEP if time is None else time
    return "/odom", ODOMETRY, k * STEP, odometry(time, scale * 0.02 * k, **changes)


def moved(k, time=None, scale=1.0):
    link = transform(
        k * STEP if time is None else time, "odom", "base_footprint", (scale * 0.02 * k, 0, 0), STILL
    )
    return "/tf", TF, k * STEP, tf(link)


def mounted(x=0.1, child="base_scan"):
    return "/tf_static", TF, 0, tf(transform(0, "base_footprint", child, (x, 0.0, 0.2), STILL))


def bag(folder, *each, static=None):
    """A drive of 6 s at 0.2 m/s; `each` gives the messages of a step, None for one left out."""
    messages = [make(k) for k in range(60) for make in (each or (odom, scan))]
    return write_foreign(folder, [*(static or [mounted()]), *(message for message in messages if message)])


DEFECTS = {
    "scans without time": (
        {"each": [odom, lambda k: scan(k, 0)]},
        ("no time", "/scan: all 60 stamps are 0 s"),
        "/scan: all 60 stamps are 0 s; the recording times are used instead",
    ),
    "nothing has time": (
        {"each": [lambda k: odom(k, 0), lambda k: scan(k, 0)]},
        ("no time", "/odom: all 60 stamps are 0 s"),
        "/odom: all 60 stamps are 0 s; the recording times",
    ),
    "transforms without time": (
        {"each": [lambda k: moved(k, 0), scan]},
        ("no time", "/tf: odom -> base_footprint: all 60 stamps"),
        "/tf: odom -> base_footprint: all 60 stamps are 0 s; the recording times",
    ),
    "a clock that stopped": (
        {"each": [lambda k: odom(k, 7 * 10**9), scan]},
        ("no time", "/odom: all 60 stamps are 7 s"),
        "/odom: all 60 stamps are 7 s; the recording times",
    ),
    "readings in millimetres": (
        {"each": [odom, lambda k: scan(k, scale=1000.0)]},
        ("millimetres", "/scan: the readings"),
        "the readings exceed any lidar's range; read as millimetres",
    ),
    "readings and limits in millimetres": (
        {"each": [odom, lambda k: scan(k, scale=1000.0, range_min=120.0, range_max=3500.0)]},
        ("millimetres", "/scan: the readings"),
        "the readings exceed any lidar's range; read as millimetres",
    ),
    "odometry in millimetres": (
        {"each": [lambda k: odom(k, scale=1000.0), scan]},
        ("millimetres", "/odom: the robot would be implausibly fast"),
        "/odom: the robot would be implausibly fast; read as millimetres",
    ),
    "transforms in millimetres": (
        {"each": [lambda k: moved(k, scale=1000.0), scan]},
        ("millimetres", "/tf: odom -> base_footprint: the robot would be implausibly fast"),
        "/tf: odom -> base_footprint: the robot would be implausibly fast; read as millimetres",
    ),
    "two robots on one topic": (
        {"each": [odom, lambda k: odom(k, scale=-3.0, child="other/base_link") if k % 2 else None, scan]},
        ("mixed frames", "'odom -> base_footprint' (60), 'odom -> other/base_link' (30)"),
        "'odom -> other/base_link' (30); the most frequent is used",
    ),
    "two lasers on one topic": (
        {"each": [odom, scan, lambda k: scan(k, scale=0.5, frame="rear") if k % 2 else None]},
        ("mixed frames", "'base_scan' (60), 'rear' (30)"),
        "'base_scan' (60), 'rear' (30); the most frequent is used",
    ),
    "a camera beyond the Earth": (
        {"static": [mounted(1e300, "camera"), mounted()]},
        ("absurd places", "base_footprint -> camera is implausibly"),
        "the transform base_footprint -> camera is implausibly far away; left out",
    ),
    "poses beyond the Earth": (
        {"each": [odom, lambda k: odom(k, k * STEP + 1, scale=1e300) if k == 9 else None, scan]},
        ("absurd places", "/odom: 1 pose is not finite or implausibly far away"),
        "/odom: 1 pose is not finite or implausibly far away; left out",
    ),
}


@pytest.fixture(scope="module")
def good(tmp_path_factory):
    return load_recording(bag(tmp_path_factory.mktemp("good") / "bag"))


@pytest.mark.parametrize("defect", DEFECTS)
def test_a_defect_is_named_and_mapping_has_the_same_log_without_it(good, tmp_path, defect):
    made, (check, says), note = DEFECTS[defect]
    path = bag(tmp_path / "bag", *made.get("each", ()), static=made.get("static"))
    found = [finding for finding in examine(path) if finding.kind == check]
    assert any(says in finding.what and finding.severity == "error" for finding in found), found
    log = load_recording(path)
    assert any(note in line for line in log.notes), log.notes
    assert not any("damaged" in line for line in log.notes)
    assert log.stamps_ns.tolist() == good.stamps_ns.tolist()
    np.testing.assert_allclose(log.ranges, good.ranges, rtol=1e-6)
    np.testing.assert_allclose(log.T_odom_base.xyt, good.T_odom_base.xyt, atol=1e-9)
    np.testing.assert_allclose(log.T_base_lidar.xyt, good.T_base_lidar.xyt)
    assert (log.lidar.range_min, log.lidar.range_max) == pytest.approx((0.12, 3.5))


def test_a_good_drive_has_none_of_these(good, tmp_path):
    assert good.notes == ()
    path = bag(tmp_path / "bag", odom, moved, scan)
    assert examine(path) == []


@pytest.mark.parametrize("x", [32.0, -64.0, 1e7])
def test_a_laser_beyond_its_robot_is_refused_until_the_user_says_where_it_is(good, tmp_path, capsys, x):
    path = bag(tmp_path / "bag", static=[mounted(x)])
    (finding,) = (found for found in examine(path) if found.kind == "millimetres")
    assert f"the laser 'base_scan' {abs(x):.4g} m from 'base_footprint'" in finding.what
    assert main(["map", str(path), "--out", str(tmp_path / "map")]) == 2
    said = capsys.readouterr().err
    assert said.count("\n") == 1
    assert f"the laser 'base_scan' {abs(x):.4g} m from 'base_footprint'" in said
    assert "--laser X,Y,YAW" in said
    assert not (tmp_path / "map").exists()
    assert load_recording(path, T_base_lidar=good.T_base_lidar).notes == ()


def test_a_laser_beyond_the_earth_is_left_out_and_said_so(tmp_path):
    path = bag(tmp_path / "bag", static=[mounted(1e300)])
    assert {finding.kind for finding in examine(path)} >= {"absurd places"}
    log = load_recording(path)
    assert log.T_base_lidar.xyt.tolist() == [0.0, 0.0, 0.0]
    assert any("--laser X,Y,YAW" in note for note in log.notes)


def test_long_ranges_and_fast_cars_are_no_millimetres():
    rng = np.random.default_rng(0)
    far = rng.uniform(20.0, 240.0, 2000).astype(np.float32)
    assert not ranges_in_millimetres(far, 250.0)
    assert not ranges_in_millimetres(far, 1e6)
    assert not ranges_in_millimetres(np.full(2000, 9999.0, np.float32), 30.0)
    assert not ranges_in_millimetres(np.full(9, np.nan, np.float32), 3.5)
    assert ranges_in_millimetres(rng.uniform(200.0, 3000.0, 2000).astype(np.float32), 3.5)
    stamps = np.arange(0, 20 * STEP, STEP)
    ahead = np.stack([4.0 * np.arange(20.0), np.zeros(20)], axis=-1)
    assert not driven_in_millimetres(stamps, ahead)
    assert driven_in_millimetres(stamps, 5.0 * ahead)
    assert not driven_in_millimetres(stamps, np.where(np.arange(20)[:, None] < 15, 0.01 * ahead, 1e5))


OVERTURNED = "/tf_static", TF, 0, tf(transform(0, "base_footprint", "base_scan", (0.1, 0, 0.2), (1, 0, 0, 0)))


@pytest.mark.parametrize("static", [OVERTURNED, mounted()], ids=["overturned", "upright"])
@pytest.mark.parametrize("time", [1.0, 1e30, -1e30])
def test_a_sweep_of_minutes_is_taken_for_an_instant(good, tmp_path, time, static):
    log = load_recording(bag(tmp_path / "bag", odom, lambda k: scan(k, time_increment=time), static=[static]))
    assert any("; taken as 0" in note for note in log.notes)
    assert log.lidar.time_increment == 0.0
    assert log.stamps_ns.tolist() == good.stamps_ns.tolist()


@pytest.mark.parametrize(
    "changes", [{"angle_increment": 1e-30}, {"angle_increment": 1e30}, {"angle_min": 1e30}]
)
def test_beams_without_directions_are_named_and_refused(tmp_path, changes):
    path = bag(tmp_path / "bag", odom, lambda k: scan(k, **changes))
    assert "beam angles" in {finding.kind for finding in examine(path)}
    with pytest.raises(InputError, match="no scan has a usable geometry; there is nothing to map"):
        load_recording(path)
