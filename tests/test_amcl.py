"""The filter as a whole, in a synthetic room, by its errors."""

import numpy as np
import pytest
from localisation_room import LIDAR, T_BASE_LIDAR, drive, l_shaped_room

from datasets.se2 import SE2
from pipeline.localisation.amcl import Amcl
from pipeline.localisation.parameters import AmclConfig

TOUR = [(2.0, 2.0), (4.3, 2.2), (4.3, 0.5), (2.6, 0.5), (0.6, 0.6), (0.6, 2.4), (2.5, 3.4), (2.0, 2.0)]


@pytest.fixture(scope="module")
def room():
    return l_shaped_room()


@pytest.fixture(scope="module")
def log(room):
    return drive(room, TOUR, np.random.default_rng(7))


def make(room, seed=1, **settings):
    return Amcl(room.grid(), LIDAR, T_BASE_LIDAR, AmclConfig(**settings), np.random.default_rng(seed))


def errors(amcl, log):
    """(position, heading) error after each scan, (n, 2)."""
    out = []
    for step in log:
        amcl.update(step.scan, step.T_odom_base, step.T_odom_base_end)
        offset = step.T_room_base.inverse() @ amcl.T_map_base(step.T_odom_base)
        out.append((np.hypot(offset.x, offset.y), abs(float(offset.yaw))))
    return np.array(out)


def rms(values):
    return float(np.sqrt(np.mean(np.square(values))))


def test_tracks_a_drifting_robot(room, log):
    drift = log[-1].T_room_base.inverse() @ log[-1].T_odom_base
    assert np.hypot(drift.x, drift.y) > 0.1
    amcl = make(room)
    amcl.initialise(log[0].T_room_base, np.diag([0.01, 0.01, 0.01]))
    found = errors(amcl, log)[5:]
    assert rms(found[:, 0]) < 0.015
    assert np.degrees(rms(found[:, 1])) < 0.4
    assert amcl.converged


def test_same_seed_same_estimate(room, log):
    runs = []
    for _ in range(2):
        amcl = make(room, seed=5)
        amcl.initialise(log[0].T_room_base)
        errors(amcl, log[:20])
        runs.append((amcl.T_map_odom.xyt, amcl.particles.xyt))
    assert np.array_equal(runs[0][0], runs[1][0])
    assert np.array_equal(runs[0][1], runs[1][1])


def test_refuses_to_work_without_a_pose(room, log):
    amcl = make(room)
    assert not amcl.initialised
    with pytest.raises(ValueError, match="initial pose"):
        amcl.update(log[0].scan, log[0].T_odom_base)
    with pytest.raises(ValueError, match="no pose yet"):
        _ = amcl.T_map_odom


def test_a_robot_at_rest_is_not_updated(room, log):
    amcl = make(room)
    amcl.initialise(log[0].T_room_base)
    assert amcl.update(log[0].scan, log[0].T_odom_base)
    assert not amcl.update(log[0].scan, log[0].T_odom_base)


def test_odometry_that_is_not_finite_is_refused(room, log):
    amcl = make(room)
    amcl.initialise(log[0].T_room_base)
    with pytest.raises(ValueError, match="not finite"):
        amcl.update(log[0].scan, SE2(np.array([np.nan, 0.0, 0.0])))
