"""Push detection: a standing robot keeps its estimate when people walk past, and follows a push."""

import numpy as np
import pytest

from tests.helpers.localisation_room import STILL_LIDAR, T_BASE_LIDAR
from turtlebag.datasets.se2 import SE2
from turtlebag.datasets.types import Scan
from turtlebag.pipeline.localisation.amcl import Amcl
from turtlebag.pipeline.localisation.local_search import climb
from turtlebag.pipeline.localisation.parameters import AmclConfig
from turtlebag.pipeline.localisation.push_detection import changed_share

PLACE = SE2.from_xyt(2.0, 2.0, 0.4)
ODOMETRY = SE2.from_xyt(-3.0, 1.0, 1.9)


def scan_at(room, T_room_base, rng, walker=None):
    """A scan with 1 cm of noise; `walker` (first, count, range) stands in some of the beams."""
    ranges = room.ranges(T_room_base @ T_BASE_LIDAR, STILL_LIDAR.angles, STILL_LIDAR.range_max)
    ranges = ranges + 0.01 * rng.standard_normal(len(ranges))
    if walker is not None:
        beams = (walker[0] + np.arange(walker[1])) % len(ranges)
        ranges[beams] = np.minimum(ranges[beams], walker[2])
    return Scan(0, ranges.astype(np.float32), STILL_LIDAR)


@pytest.fixture
def standing(room):
    """A filter that has driven up to PLACE, turning, and stands there now; the scans' noise."""
    rng = np.random.default_rng(3)
    amcl = Amcl(room.grid(), STILL_LIDAR, T_BASE_LIDAR, AmclConfig(), np.random.default_rng(1))
    amcl.initialise(PLACE, np.diag([0.01, 0.01, 0.01]), ODOMETRY)
    for turn in (0.3, 0.6, 0.3, 0.0):
        step = SE2.from_xyt(0.0, 0.0, turn)
        assert amcl.update(scan_at(room, PLACE @ step, rng), ODOMETRY @ step)
    assert not amcl.update(scan_at(room, PLACE, rng), ODOMETRY)
    return amcl, rng


def error(amcl, T_room_base):
    offset = T_room_base.inverse() @ amcl.T_map_base(ODOMETRY)
    return float(np.hypot(offset.x, offset.y)), abs(float(offset.yaw))


def test_standing_for_a_minute_changes_nothing(room, standing):
    amcl, rng = standing
    pose, cloud = amcl.T_map_odom.xyt.copy(), amcl.particles.xyt
    assert not any(amcl.update(scan_at(room, PLACE, rng), ODOMETRY) for _ in range(300))
    np.testing.assert_array_equal(amcl.T_map_odom.xyt, pose)
    np.testing.assert_array_equal(amcl.particles.xyt, cloud)


@pytest.mark.slow
@pytest.mark.parametrize(("width", "reach"), [(40, 0.6), (150, 0.3), (300, 0.25)])
def test_one_who_walks_past_does_not_move_the_estimate(room, standing, width, reach):
    amcl, rng = standing
    pose, size = amcl.T_map_odom.xyt.copy(), amcl.size
    walks = [scan_at(room, PLACE, rng, (3 * k, width, reach)) for k in range(300)]
    used = sum(amcl.update(scan, ODOMETRY) for scan in walks)
    assert used <= 3
    assert error(amcl, PLACE)[0] < 0.02
    assert np.abs(amcl.T_map_odom.xyt - pose).max() < 0.02
    assert amcl.size > 0.5 * size
    assert amcl.converged


@pytest.mark.slow
@pytest.mark.parametrize(
    "push", [(0.19, 0.0, 0.0), (-0.05, 0.13, 0.0), (0.0, 0.0, 0.35), (0.12, -0.1, -0.2), (0.06, 0.0, 0.0)]
)
@pytest.mark.parametrize("scans", [1, 4, 40])
def test_a_standing_robot_that_is_pushed_is_followed(room, standing, push, scans):
    amcl, rng = standing
    for share in np.linspace(0.0, 1.0, scans + 1)[1:]:
        amcl.update(scan_at(room, PLACE @ SE2(share * np.array(push)), rng), ODOMETRY)
    there = PLACE @ SE2(np.array(push))
    used = [amcl.update(scan_at(room, there, rng), ODOMETRY) for _ in range(25)]
    off, turned = error(amcl, there)
    assert off < 0.03
    assert turned < 0.03
    # Then it stands undisturbed again.
    assert not any(used[-10:])


def test_a_push_of_a_robot_in_company_is_followed(room, standing):
    amcl, rng = standing
    there = PLACE @ SE2.from_xyt(0.15, 0.0, 0.1)
    for k in range(25):
        amcl.update(scan_at(room, there, rng, (170 - k, 60, 0.3)), ODOMETRY)
    assert error(amcl, there)[0] < 0.03


def test_without_the_watch_the_push_would_not_be_noticed(room, standing, monkeypatch):
    amcl, rng = standing
    monkeypatch.setattr("turtlebag.pipeline.localisation.push_detection.DOUBTFUL", 2.0)
    there = PLACE @ SE2.from_xyt(0.19, 0.0, 0.0)
    assert not any(amcl.update(scan_at(room, there, rng), ODOMETRY) for _ in range(25))
    assert error(amcl, there)[0] == pytest.approx(0.19, abs=0.02)


def test_the_changed_share_counts_returns_that_come_and_go():
    before = np.array([1.0, 2.0, 3.0, np.inf, np.inf, np.nan])
    assert changed_share(before + 0.03, before) == 0.0
    assert changed_share(np.array([1.0, 2.1, np.inf, 3.0, np.inf, np.nan]), before) == pytest.approx(0.75)
    assert changed_share(np.full(6, np.inf), np.full(6, np.inf)) == 0.0


def test_climbing_finds_the_peak_to_half_the_last_step():
    peak = np.array([0.31, -0.17, 0.22])
    value, pose = climb(lambda poses: -np.abs((poses - peak) / (0.02, 0.02, 0.012)).max(axis=1), np.zeros(3))
    assert np.all(np.abs(pose - peak) <= np.array([0.01, 0.01, 0.006]) + 1e-9)
    assert value > -0.51
