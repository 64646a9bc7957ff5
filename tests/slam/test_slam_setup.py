"""The sensor set-up by the motion of scans, wheels and gyro."""

from functools import cache

import numpy as np
import pytest

from benchmarks.known_logs import Known
from tests.helpers.made_drives import FloorPlan, Sensor, Wheels, make_log, sick
from tests.helpers.made_logs import arena, office_plan, office_route, rooms, wheels_of
from turtlebag.datasets.se2 import SE2
from turtlebag.datasets.types import ImuLog
from turtlebag.pipeline.slam.check.size import LIDAR, Size, size_of
from turtlebag.pipeline.slam.mapper import SlamConfig, run_slam, track_recording
from turtlebag.pipeline.slam.progress import no_progress
from turtlebag.pipeline.slam.sensors.setup_estimate import Quantity, SensorSetup

NAMES = ("wheel_scale", "turn_scale", "turn_per_m", "lidar_x", "lidar_y", "lidar_yaw")
WRONG = np.array([0.03, -0.02, 0.02])
made = cache(lambda make, *given: make(*given))


def said_elsewhere(log: Known, error: np.ndarray) -> Known:
    """The log that declares its lidar this far from where it is, x, y [m] and yaw."""
    return log.recorded(T_base_lidar=SE2(log.recording.T_base_lidar.xyt - error))


def truth(log: Known, wheels: Wheels) -> np.ndarray:
    turn = 1.0 / (1.0 + wheels.turn)
    return np.array([1.0 / (1.0 + wheels.scale), turn, -wheels.bias * turn, *log.recording.T_base_lidar.xyt])


def setup_of(log: Known) -> SensorSetup:
    return track_recording(log.recording, SlamConfig(), no_progress).setup


def off_by_sigmas(setup: SensorSetup, expected: np.ndarray) -> np.ndarray:
    values, sigmas = (np.array([getattr(setup[name], what) for name in NAMES]) for what in ("value", "sigma"))
    return np.abs(values - expected) / sigmas


def with_gyro(log: Known, scale: float, bias: float) -> Known:
    """The log with a gyro of so many radians a radian, and of this bias [rad/s]."""
    r, t = log.recording, log.times
    times = np.arange(0.0, t[-1], 0.01)
    yaw = np.interp(times, t, np.unwrap(log.reference.yaw))
    rate = np.zeros((len(times), 3))
    rate[:, 2] = np.gradient(yaw, 0.01) / scale + bias
    stamps = r.stamps_ns[0] + np.round(1e9 * times).astype(np.int64)
    return log.recorded(imu=ImuLog(stamps, rate, np.zeros_like(rate)))


@pytest.mark.parametrize("make", [lambda: arena(5, "fast"), lambda: rooms(5)], ids=["arena", "house"])
def test_wheels_and_a_lidar_that_sits_elsewhere_are_found_within_their_intervals(make):
    log = make().with_scans(slice(0, 500))
    setup, right = setup_of(said_elsewhere(log, WRONG)), truth(log, wheels_of(5))
    assert (off_by_sigmas(setup, right) < 3.0).all()
    assert setup["lidar_x"].value == pytest.approx(right[3], abs=0.002)
    assert setup["lidar_yaw"].value == pytest.approx(right[5], abs=0.002)
    assert setup["lidar_x"].declared == pytest.approx(right[3] - WRONG[0])
    assert all(one.observable for one in setup.quantities)


def test_a_gyro_s_scale_and_bias_are_found():
    setup = setup_of(with_gyro(arena(5, "slow").with_scans(slice(0, 500)), 1.02, 0.003))
    assert setup["gyro_scale"].value == pytest.approx(1.02, abs=0.004)
    assert setup["gyro_bias"].value == pytest.approx(0.003, abs=0.001)


def test_what_a_drive_does_not_show_is_not_observable():
    plan = FloorPlan(14.0, 5.0)
    plan.carve(1.0, 1.0, 13.0, 4.0)
    plan.turned_box(5.0, 3.6, 0.5, 0.4, 0.3)
    route, sensor = np.array([(2.0, 2.4), (12.0, 2.4)]), Sensor(sick(360, 20.0), 0.2)
    setup = setup_of(make_log("straight", plan, route, sensor, wheels=Wheels(0.02, 0.02, 0.0)))
    seen = {one.name: one.observable for one in setup.quantities}
    assert seen["wheel_scale"]
    assert not seen["turn_scale"]
    assert not seen["lidar_x"]
    assert not seen["lidar_y"]


def test_a_correction_needs_a_sweep_that_it_makes_sharper():
    log = said_elsewhere(arena(5, "fast").with_scans(slice(0, 500)), np.array([0.08, 0.0, 0.0]))
    session = track_recording(log.recording, SlamConfig(), no_progress)
    assert session.recording.T_base_lidar.x == pytest.approx(-0.032, abs=0.005)
    assert "cm (x)" in session.recording.notes[-1]
    session = track_recording(log.recording, SlamConfig(deskew=False), no_progress)
    assert session.recording.T_base_lidar.x == pytest.approx(-0.112)


def test_a_lidar_that_sits_where_it_is_said_to_sit_is_left_there():
    log = rooms(6).with_scans(slice(0, 500))
    setup = setup_of(log)
    assert setup.lidar_error is None
    assert (off_by_sigmas(setup, truth(log, wheels_of(6))) < 3.0).all()


def test_ranges_too_long_leave_the_size_unknown_and_say_so():
    log = make_log(
        "size", office_plan(1), office_route(2), Sensor(sick(180, 30.0), 0.4), wheels=Wheels(0.0, 0.0)
    )
    long = log.with_ranges(log.recording.ranges * 1.05)
    for one, said in ((log, None), (long, "shape good, size known to 5 %")):
        check = run_slam(one.recording, SlamConfig()).check
        scale = check.as_metrics()["scale"]
        low, high = scale["interval_95"]
        assert low < (1.0 if one is log else 1.0 / 1.05) < high
        assert (scale["said"] is None) == (said is None)
        assert said is None or said in scale["said"]


def test_without_wheels_the_size_is_known_as_well_as_the_lidar_measures():
    assert size_of(SensorSetup()) == Size(1.0, LIDAR, 0.0)
    unseen = Quantity("wheel_scale", 1.1, 0.05, "1", False, 1.0)
    assert size_of(SensorSetup((unseen,))) == Size(1.0, LIDAR, 0.0)


def test_a_setup_is_the_same_after_it_was_stored():
    setup = SensorSetup(
        (Quantity("lidar_x", 0.1, 0.002, "m", True, 0.09), Quantity("gyro_bias", 0.0, 0.1, "rad/s", False))
    )
    assert SensorSetup.of_records(setup.as_records()) == setup
    entry = setup.as_metrics()["sensors"]["lidar_x"]
    assert entry["interval_95"] == pytest.approx([0.1 - 0.00392, 0.1 + 0.00392])
    assert (entry["unit"], entry["observable"], entry["declared"]) == ("m", True, 0.09)
