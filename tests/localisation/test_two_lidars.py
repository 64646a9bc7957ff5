"""The filter with several lidars: each scan is seen from where its own lidar sits."""

import math

import numpy as np
import pytest

from tests.helpers.localisation_room import STILL_LIDAR, T_BASE_LIDAR
from tests.localisation.filter_room import GRID, PLACE, ROOM
from turtlebag.datasets.errors import InputError
from turtlebag.datasets.se2 import SE2
from turtlebag.datasets.types import MountedLidar, Scan
from turtlebag.pipeline.localisation.amcl import Amcl
from turtlebag.pipeline.localisation.localisers import make_localiser
from turtlebag.pipeline.localisation.parameters import AmclConfig

REAR = MountedLidar(STILL_LIDAR, SE2.from_xyt(-0.2, 0.1, math.pi))
LIDARS = MountedLidar(STILL_LIDAR, T_BASE_LIDAR), REAR


def scan_at(pose, sensor):
    T_room_lidar = pose @ LIDARS[sensor].T_base_lidar
    ranges = ROOM.ranges(SE2(T_room_lidar.xyt[None]), STILL_LIDAR.angles, STILL_LIDAR.range_max)
    return Scan(0, ranges.astype(np.float32), STILL_LIDAR, sensor)


def started():
    amcl = Amcl(GRID, STILL_LIDAR, T_BASE_LIDAR, AmclConfig(), np.random.default_rng(3), others=[REAR])
    amcl.initialise(PLACE, np.diag([0.02, 0.02, 0.02]))
    return amcl


def test_scans_of_the_rear_lidar_alone_locate_the_base():
    amcl = started()
    for step in range(6):
        pose = PLACE @ SE2.from_xyt(0.06 * step, 0.0, 0.25 * step)
        amcl.update(scan_at(pose, 1), pose)
    off = pose.inverse() @ amcl.T_map_base(pose)
    assert np.hypot(off.x, off.y) < 0.04
    assert abs(float(off.yaw)) < 0.02
    assert amcl.agreement > 0.8


def test_each_lidar_has_one_scan_used_whenever_the_robot_has_moved():
    amcl, used = started(), []
    for step in range(9):
        pose = PLACE @ SE2.from_xyt(0.3 * (step // 4), 0.0, 0.0)
        used.append(amcl.update(scan_at(pose, step % 2), pose))
    assert used == [True, True, False, False, True, True, False, False, True]


def test_a_localiser_for_one_lidar_is_not_given_two():
    parts = GRID, STILL_LIDAR, T_BASE_LIDAR, AmclConfig(), np.random.default_rng(3)
    assert isinstance(make_localiser("amcl", *parts, [REAR]), Amcl)
    with pytest.raises(InputError, match=r"localiser=mine:One: localises with one lidar.*are of 2"):
        make_localiser("mine:One", *parts, [REAR])
