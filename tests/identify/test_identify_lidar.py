"""The lidar's errors by its own readings: rooms of which the noise is known."""

import numpy as np
import pytest

from turtlebag.datasets.se2 import SE2
from turtlebag.datasets.types import LidarSpec, Recording
from turtlebag.pipeline.identify.lidar import lidar_findings
from turtlebag.sim.lidar_errors import LidarUnit
from turtlebag.sim.robots import LidarErrors, load_robot

BASE = load_robot("burger").lidar.errors
LIDAR = LidarSpec(360, 0.0, np.deg2rad(1.0), 0.12, 5.0, scan_time=0.2)


def room(errors, n=300, gaps_s=None, seed=3):
    """Scans of a room of 5 by 4 m from many places in it, with such errors."""
    rng = np.random.default_rng(seed)
    unit = LidarUnit(errors, rng)
    rows = []
    for _ in range(n):
        x, y, yaw = rng.uniform([-1.5, -1.2, -np.pi], [1.5, 1.2, np.pi])
        angles = unit.directions(LIDAR.angles) + yaw
        c, s = np.cos(angles), np.sin(angles)
        to_x, to_y = (np.sign(c) * 2.5 - x) / c, (np.sign(s) * 2.0 - y) / s
        cosine = np.where(to_x < to_y, np.abs(c), np.abs(s))
        ranges = unit.ranges(np.minimum(to_x, to_y))
        rows.append(np.where(unit.comes_back(cosine), ranges, np.inf))
    gaps = np.full(n - 1, 0.2) if gaps_s is None else gaps_s
    stamps = np.concatenate([[0.0], np.cumsum(gaps)])
    return Recording(
        "room", np.round(1e9 * stamps).astype(np.int64), np.array(rows, np.float32), LIDAR, SE2.identity()
    )


def estimates(recording):
    return {one.name: one for one in lidar_findings(recording, BASE).estimates}


def test_noise_and_lost_beams_are_those_of_the_model():
    errors = LidarErrors(
        sigma=0.006, sigma_square=0.003, angle_deg=0.15, resolution=0.001, lost=0.03, grazing=0.12
    )
    found = estimates(room(errors))
    for name in ("sigma", "sigma_square", "angle_deg", "lost", "grazing"):
        low, high = found[name].interval_95
        assert found[name].observable, name
        assert 0.97 * low <= getattr(errors, name) <= 1.03 * high, name
        assert high < 1.6 * low, name
    assert found["resolution"].value == 0.001


def test_what_is_not_there_is_not_observable():
    found = estimates(room(LidarErrors(sigma=0.01)))
    assert not found["angle_deg"].observable
    assert "slanting" in found["angle_deg"].why
    assert not found["grazing"].observable
    assert found["lost"].value < 1e-3
    assert (found["jitter"].value, found["late_spread"].value) == (0.0, 0.0)


def test_jitter_adds_up_and_late_stamps_do_not():
    rng = np.random.default_rng(1)
    late = rng.uniform(0.0, 0.008, 1500)
    gaps = 0.2 * (1.0 + 0.004 * rng.standard_normal(1499)) + np.diff(late)
    found = estimates(room(LidarErrors(), 1500, gaps))
    for name, true in (("jitter", 0.004), ("late_spread", 0.008), ("rate", 5.0)):
        low, high = found[name].interval_95
        assert low <= true <= high, name
        assert high < 2.0 * low, name


@pytest.mark.parametrize("n", [2, 3])
def test_a_few_scans_show_nothing(n):
    found = estimates(room(LidarErrors(), n))
    assert not any(found[name].observable for name in ("sigma", "lost", "jitter", "rate"))
