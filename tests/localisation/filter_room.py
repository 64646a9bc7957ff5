"""A filter in the room of `localisation_room`, and the scan it would see from a pose there."""

import numpy as np

from tests.helpers.localisation_room import LIDAR, STILL_LIDAR, T_BASE_LIDAR, l_shaped_room
from turtlebag.datasets.se2 import SE2
from turtlebag.datasets.types import Scan
from turtlebag.pipeline.localisation.amcl import Amcl
from turtlebag.pipeline.localisation.deskewed_beams import prepare
from turtlebag.pipeline.localisation.parameters import AmclConfig

ROOM = l_shaped_room()
GRID = ROOM.grid()
PLACE = SE2.from_xyt(2.0, 2.0, 0.4)


def made(seed=1, **settings):
    return Amcl(GRID, LIDAR, T_BASE_LIDAR, AmclConfig(**settings), np.random.default_rng(seed))


def scan_at(pose, lidar=STILL_LIDAR):
    ranges = ROOM.ranges(SE2((pose @ T_BASE_LIDAR).xyt[None]), lidar.angles, lidar.range_max)
    return Scan(0, ranges.astype(np.float32), lidar)


def beams_at(pose):
    return prepare(scan_at(pose), T_BASE_LIDAR)
