"""The odometry's systematic errors are calibrated by the scans, also if it is wrong for a while."""

import numpy as np
import pytest

from tests.helpers.made_drives import Lie, Sensor, Wheels, make_log, sick
from tests.helpers.made_logs import office_plan, office_route
from turtlebag.datasets.se2 import SE2
from turtlebag.pipeline.slam.odometry.calibration import Calibration, calibrate
from turtlebag.pipeline.slam.scans.clouds import make_clouds

WHEELS = Wheels(scale=-0.02, turn=0.03, bias=0.004)


def calibrated(lies: tuple[Lie, ...] = (), start_error: float = 0.0) -> Calibration:
    log = make_log(
        "calibration", office_plan(1), office_route(2), Sensor(sick(180, 30.0), 0.4), wheels=WHEELS, lies=lies
    )
    recording = log.recording
    clouds = make_clouds(recording, 30.0)
    keys = np.arange(0, len(recording), 2)
    rng = np.random.default_rng(1)
    start = log.truth.poses[keys].xyt + rng.normal(0.0, start_error, (len(keys), 3))
    assert recording.T_odom_base is not None
    return calibrate(clouds, keys, SE2.from_array(start), recording.T_odom_base[keys])


def assert_finds_the_wheels(found: Calibration) -> None:
    assert found.scale == pytest.approx(1.0 / (1.0 + WHEELS.scale), abs=0.003)
    assert found.turn_scale == pytest.approx(1.0 / (1.0 + WHEELS.turn), abs=0.004)
    assert found.turn_per_m == pytest.approx(-WHEELS.bias / (1.0 + WHEELS.turn), abs=0.0015)
    sigma = np.sqrt(np.diag(found.covariance))
    assert abs(found.scale - 1.0 / (1.0 + WHEELS.scale)) < 3.0 * sigma[0] < 0.01
    assert abs(found.turn_scale - 1.0 / (1.0 + WHEELS.turn)) < 3.0 * sigma[1] < 0.01


def test_errors_of_wheel_size_and_track_are_found_by_the_scans_alone():
    found = calibrated(start_error=0.02)
    assert_finds_the_wheels(found)
    assert found.pairs > 60
    # 4 mm and 3 mrad per root metre over a baseline of 1.5 m, plus what a match is wrong by
    assert np.all(found.noise < [0.015, 0.015, 0.01])


def test_stretches_of_lies_are_outvoted():
    assert_finds_the_wheels(calibrated((Lie("reverse", 12.0, 4.0), Lie("slip", 40.0, 5.0))))


def test_without_overlapping_pairs_odometry_is_left_as_it_is():
    log = make_log("calibration", office_plan(1), office_route(2), Sensor(sick(180, 30.0), 0.4))
    clouds = make_clouds(log.recording, 30.0)
    found = calibrate(clouds, np.array([0, 1]), log.truth.poses[[0, 1]], log.truth.poses[[0, 1]])
    assert (found.scale, found.turn_scale, found.turn_per_m, found.pairs) == (1.0, 1.0, 0.0, 0)
    np.testing.assert_allclose(found.covariance, 0.05**2 * np.eye(3))


def test_corrected_steps_undo_the_shares_and_information_falls_with_the_way():
    steps = np.array([[1.0, 0.0, 0.1], [-1.0, 0.0, 0.0], [0.2, 0.0, 0.0]])
    calibration = Calibration(1.1, 0.9, 0.02)
    np.testing.assert_allclose(calibration.corrected(steps)[0], [1.1, 0.0, 0.11])
    np.testing.assert_allclose(calibration.corrected(steps)[1], [-1.1, 0.0, -0.02])
    information = calibration.information(steps)
    assert information.shape == (3, 3, 3)
    assert information[2, 0, 0] > information[1, 0, 0] > information[0, 0, 0]
