"""A laser that faces another direction than its transform says."""

from dataclasses import replace

import numpy as np
import pytest

from benchmarks.disturb import KINDS
from benchmarks.known_logs import Known
from benchmarks.slam_scores import errors
from tests.helpers.made_drives import Drive, FloorPlan, make_log
from tests.helpers.made_logs import arena, burger_lidar
from turtlebag.datasets.se2 import SE2
from turtlebag.datasets.seeds import stream
from turtlebag.pipeline.slam.mapper import SlamConfig, run_slam
from turtlebag.pipeline.slam.scans.range_noise import range_noise
from turtlebag.pipeline.slam.sensors.mounting import facing, turned_by_deg, ways_of, yaw_error_deg
from turtlebag.pipeline.slam.times.stretches import straight, thinned_scans


@pytest.fixture(scope="module")
def log() -> Known:
    return arena(1, "fast").with_scans(slice(0, 500))


def said_turned(log: Known, degrees: float) -> Known:
    """The log with its laser said to face so many degrees from where it does."""
    x, y, yaw = log.recording.T_base_lidar.xyt
    return log.recorded(T_base_lidar=SE2.from_xyt(x, y, yaw - np.deg2rad(degrees)))


@pytest.mark.parametrize("degrees", [180.0, 90.0, -90.0, -35.0, 10.0])
def test_a_laser_said_to_face_elsewhere_is_turned_back(log, degrees):
    corrected = facing(said_turned(log, degrees).recording)
    np.testing.assert_allclose(corrected.T_base_lidar.xyt, log.recording.T_base_lidar.xyt, atol=1e-9)
    assert f"the laser's yaw is {degrees:.0f} degrees from the recorded mounting" in corrected.notes[-1]


@pytest.mark.slow
def test_laser_turned_by_a_right_angle_makes_the_map_that_it_makes_unturned(log):
    log = log.with_scans(slice(0, 300))
    wrong = said_turned(log, 90.0)
    turned, right = (run_slam(one.recording, SlamConfig()) for one in (wrong, log))
    assert errors(turned.trajectory.poses, log.reference)["worst_m"] < 0.02
    np.testing.assert_allclose(turned.trajectory.poses.xyt, right.trajectory.poses.xyt, atol=0.005)


@pytest.mark.parametrize("kind", ["slipped", "counted back", "jump", "stuck", "mirrored odometry", "bias"])
def test_odometry_that_lies_turns_no_laser(log, kind):
    assert turned_by_deg(KINDS[kind](log, stream(1, kind)).recording) == 0.0


@pytest.mark.parametrize("wrong", [1, 2, 3])
@pytest.mark.parametrize("degrees", [0.0, 35.0])
def test_few_stretches_that_went_wrong_turn_no_laser(wrong, degrees):
    """Of twenty answers one, two or three are sixty degrees off, as when a door opens beside the robot."""
    off_deg = np.where(np.arange(20) < wrong, 60.0, 0.0)
    ways = np.column_stack([np.exp(-1j * np.deg2rad(degrees + off_deg)), np.ones(20)])
    assert yaw_error_deg(ways) == degrees


def test_a_robot_that_winds_along_is_seen_to_go_where_its_wheels_say():
    """Each sweep is bent by a turn of its own, up to 9 degrees of direction over a stretch."""
    plan, x = FloorPlan(8.0, 4.0), np.linspace(1.5, 6.5, 800)
    plan.carve(0.5, 0.5, 7.5, 3.5)
    winding = np.column_stack([x, 2.0 + 0.12 * np.sin(4.0 * np.pi * x)])
    drive = Drive(v=0.18, w=2.0, dv=2.0, dw=10.0, ahead=0.06)
    recording = thinned_scans(make_log("winding", plan, winding, burger_lidar(), drive=drive).recording)
    noise = range_noise(recording, recording.lidar.range_max)
    seen, told = np.array([ways_of(recording, one, noise) for one in straight(recording)]).T
    assert np.quantile(np.abs(np.angle(told / seen, deg=True)), 0.9) < 3.0


def test_turns_that_scans_far_apart_lose_turn_no_laser():
    """A way on a bend lies aside by half the turn: what one side misses of it was taken for the laser's."""
    log = arena(2, "spiral").with_scans(slice(None, None, 5))
    assert turned_by_deg(log.recording) == 0.0
    assert turned_by_deg(said_turned(log, 35.0).recording) == 35.0


def test_without_odometry_or_way_nothing_tells(log):
    r = log.recording
    standing = replace(r, T_odom_base=SE2(np.zeros((len(r), 3))))
    for one in (
        replace(r, T_odom_base=None),
        standing,
        said_turned(log.with_scans(slice(0, 6)), 180.0).recording,
    ):
        assert facing(one) is one
