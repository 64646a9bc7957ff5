"""The lidar's pose and which way up it is: from the bag, from an option, or unknown."""

import logging
import math

import numpy as np
import pytest

from tests.helpers.carmen_lines import flaser
from tests.helpers.foreign_bags import ODOMETRY, SCAN, TF, laser_scan, odometry, tf, transform, write_foreign
from turtlebag.datasets.recordings import load_recording
from turtlebag.pipeline.stages.command_line import read

FULL_TURN = 2.0 * math.pi


def test_a_lidar_upside_down_is_turned_over(tmp_path):
    ranges = np.linspace(1.0, 2.0, 360)
    messages = [
        ("/tf_static", TF, 0, tf(transform(0, "base_footprint", "base_scan", (0, 0, 0.2), (1, 0, 0, 0)))),
        ("/scan", SCAN, 0, laser_scan(0, ranges)),
    ]
    recording = load_recording(write_foreign(tmp_path / "bag", messages))
    upright = {
        round(math.degrees(a)) % 360: r
        for a, r in zip(recording.lidar.angles, recording.ranges[0], strict=True)
    }
    assert upright[359] == np.float32(ranges[1])
    assert upright[0] == np.float32(ranges[0])


def test_a_turning_lidar_upside_down_keeps_the_time_of_every_reading(tmp_path):
    """Reading k is taken at bearing -k degrees, k / 1800 s after the message's stamp."""
    at, ranges = 10**9, np.linspace(1.0, 2.0, 300, dtype=np.float32)
    over = transform(0, "base_footprint", "base_scan", (0, 0, 0.2), (1, 0, 0, 0))
    messages = [("/tf_static", TF, 0, tf(over))]
    messages += [("/odom", ODOMETRY, t, odometry(t, t * 1e-9)) for t in range(0, 2 * 10**9, 50_000_000)]
    messages += [("/scan", SCAN, at, laser_scan(at, ranges, time_increment=1 / 1800))]
    recording = load_recording(write_foreign(tmp_path / "bag", messages))
    lidar = recording.lidar
    order = np.argsort(recording.ranges[0])
    np.testing.assert_array_equal(recording.ranges[0][order], ranges)
    bearings = np.degrees(np.unwrap(lidar.angles)[order])
    np.testing.assert_allclose((bearings + np.arange(300) + 180.0) % 360.0, 180.0, atol=1e-4)
    times = recording.stamps_ns[0] * 1e-9 + lidar.time_increment * np.arange(300)
    np.testing.assert_allclose(times[order], 1.0 + np.arange(300) / 1800, atol=1e-6)
    assert recording.stamps_ns.tolist() == [at]  # what a trajectory is to carry
    assert float(recording.T_odom_base.x[0]) == pytest.approx(1.0, abs=1e-6)


def laser(text):
    """What --laser says."""
    return read(["map", "drive.log", "--laser", text]).laser


@pytest.mark.parametrize("log", [False, True], ids=["bag", "CARMEN log"])
def test_an_option_turns_the_lidar_over(tmp_path, caplog, monkeypatch, log):
    path = tmp_path / "a.clf"
    path.write_text(flaser(np.linspace(1.0, 2.0, 180)))
    if not log:
        scan = laser_scan(0, np.linspace(1.0, 2.0, 180), time_increment=1 / 1800)
        path = write_foreign(tmp_path / "bag", [("/scan", SCAN, 0, scan)])
    T, over = laser("0.1,0.2,0.3,upside-down").T_base_lidar, laser("0.1,0.2,0.3,upside-down").upside_down
    upright, turned = (load_recording(path, T_base_lidar=T, upside_down=down) for down in (False, over))
    np.testing.assert_allclose(turned.T_base_lidar.xyt, [0.1, 0.2, 0.3])
    np.testing.assert_allclose(turned.lidar.angles, -upright.lidar.angles, atol=1e-12)
    assert turned.lidar.time_increment == upright.lidar.time_increment
    np.testing.assert_array_equal(turned.ranges, upright.ranges)
    assert turned.notes == (*upright.notes, "the laser is mounted upside down; its scans were flipped")
    assert not laser("0.1,0.2,0.3").upside_down
    caplog.set_level(logging.INFO, logger="turtlebag")
    monkeypatch.setattr(logging.getLogger("turtlebag"), "propagate", True)
    assert not caplog.messages
    laser("0.1,0.2,180,upside-down")
    assert caplog.messages == ["note: --laser 0.1,0.2,180: yaw 180 rad: is it in degrees?"]


@pytest.mark.parametrize("static", [False, True], ids=["no static transforms", "another frame"])
def test_odometry_on_tf_counts_where_nothing_tells_the_lidar_s_place(tmp_path, static):
    sits = (-0.032, 0.0, 0.172), (0.0, 0.0, 0.0, 1.0)
    messages = [("/tf_static", TF, 0, tf(transform(0, "base_link", "laser", *sits)))] if static else []
    for k in range(11):
        link = transform(k * 10**8, "odom", "base_link", (0.1 * k, 0, 0), (0, 0, 0, 1))
        messages.append(("/tf", TF, k * 10**8, tf(link)))
        messages.append(("/scan", SCAN, k * 10**8, laser_scan(k * 10**8, np.ones(360))))
    recording = load_recording(write_foreign(tmp_path / "bag", messages))
    np.testing.assert_allclose(recording.T_odom_base.x, 0.1 * np.arange(11))
    assert any("odometry from /tf (odom -> base_link)" in note for note in recording.notes)
    assert any("no fixed transform base_link -> base_scan" in note for note in recording.notes)
    assert not any("neither an Odometry topic" in note for note in recording.notes)


def test_of_several_odometries_on_tf_the_one_that_carries_the_lidar_counts(tmp_path):
    sits = (0.1, 0.0, 0.2), (0.0, 0.0, 0.0, 1.0)
    messages = [("/tf_static", TF, 0, tf(transform(0, "base_link", "base_scan", *sits)))]
    for k in range(11):
        other = transform(k * 10**8, "cart_odom", "cart", (0, 0.1 * k, 0), (0, 0, 0, 1))
        link = transform(k * 10**8, "odom", "base_link", (0.1 * k, 0, 0), (0, 0, 0, 1))
        messages.append(("/tf", TF, k * 10**8, tf(other, link)))
        messages.append(("/scan", SCAN, k * 10**8, laser_scan(k * 10**8, np.ones(360))))
    recording = load_recording(write_foreign(tmp_path / "bag", messages))
    np.testing.assert_allclose(recording.T_odom_base.x, 0.1 * np.arange(11))
