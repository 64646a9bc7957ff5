"""A burger and a walled room, shared by the tests of the planners."""

import numpy as np

from turtlebag.datasets.grid import FREE, OCCUPIED, OccupancyGrid
from turtlebag.datasets.se2 import SE2
from turtlebag.sim.robots import load_robot

BURGER = load_robot("burger").model


def room(rows=40, cols=60, resolution=0.05) -> OccupancyGrid:
    cells = np.full((rows, cols), FREE, dtype=np.int8)
    cells[[0, -1], :] = OCCUPIED
    cells[:, [0, -1]] = OCCUPIED
    return OccupancyGrid(cells, resolution, SE2.from_xyt(-1.0, -0.5, 0.0))
