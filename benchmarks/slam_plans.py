"""Floor plans as segments and circles, carved out of solid."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from turtlebag.datasets.se2 import Array
from turtlebag.sim.raycast import distance_to_point
from turtlebag.sim.shapes import box

CELL = 0.05


class FloorPlan:
    """Free space carved out of solid in 5 cm cells, with boxes and pillars put back."""

    def __init__(self, width: float, height: float) -> None:
        self.solid = np.ones((round(height / CELL), round(width / CELL)), dtype=bool)
        self._circles: list[tuple[float, float, float]] = []
        self._loose: list[Array] = []

    def carve(self, x0: float, y0: float, x1: float, y1: float) -> None:
        """Make a rectangle free."""
        self.solid[_cells(y0, y1), _cells(x0, x1)] = False

    def box(self, x0: float, y0: float, x1: float, y1: float) -> None:
        """Make a rectangle solid."""
        self.solid[_cells(y0, y1), _cells(x0, x1)] = True

    def pillar(self, x: float, y: float, radius: float) -> None:
        """A round obstacle."""
        self._circles.append((x, y, radius))

    def turned_box(self, x: float, y: float, length: float, width: float, yaw: float) -> None:
        """A box at any angle."""
        self._loose.append(box("", (x, y), (length, width), yaw, (0.0, 1.0)).outline(0.0, 0.0)[0])

    def outlines(self) -> tuple[Array, Array]:
        """Segments (n, 4) and circles (m, 3), as rays are cast through."""
        walls = [_edges(self.solid), _edges(self.solid.T)[:, [1, 0, 3, 2]]]
        return np.vstack([*walls, *self._loose]), np.array(self._circles, dtype=float).reshape(-1, 3)

    def clearance(self, xy: Array) -> Array:
        """Distance from points (n, 2) to the nearest outline, (n,) [m]."""
        segments, circles = self.outlines()
        return np.array([distance_to_point(x, y, segments, circles) for x, y in xy])


def _cells(a: float, b: float) -> slice:
    return slice(round(a / CELL), round(b / CELL))


def _edges(solid: NDArray[np.bool_]) -> Array:
    """Boundaries between rows of cells as long segments, (n, 4)."""
    change = np.pad(solid[1:] != solid[:-1], ((0, 0), (1, 1)))
    # Of each row, columns where a run begins and ends in turn.
    row, flip = np.nonzero(change[:, 1:] != change[:, :-1])
    y = (row[::2] + 1) * CELL
    return np.stack([flip[::2] * CELL, y, flip[1::2] * CELL, y], axis=1)
