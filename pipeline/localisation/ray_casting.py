"""The ranges that a map predicts."""

from __future__ import annotations

import numpy as np

from turtlebag.datasets.kernels import njit
from turtlebag.datasets.se2 import Array
from turtlebag.pipeline.localisation.field import FloatGrid


@njit(cache=True)
def expected_ranges(
    distance: FloatGrid,
    frame: tuple[float, float, float, float],
    poses: Array,
    starts: Array,
    directions: Array,
    range_max: float,
) -> Array:
    """Range to the first occupied cell's centre (its projection on the beam), (n, m), range_max at most.

    `starts` and unit `directions` (m, 2) are in the base frame; `frame` is the field's corner in the map
    (x, y, yaw) and its cells per metre. Steps are as long as the distance field allows.
    """
    rows, cols = distance.shape
    x0, y0, yaw0, per_metre = frame
    cell = 1.0 / per_metre
    c0, s0 = np.cos(yaw0), np.sin(yaw0)
    out = np.full((len(poses), len(starts)), range_max)
    for i in range(len(poses)):
        dx, dy = poses[i, 0] - x0, poses[i, 1] - y0
        px, py = c0 * dx + s0 * dy, c0 * dy - s0 * dx
        c, s = np.cos(poses[i, 2] - yaw0), np.sin(poses[i, 2] - yaw0)
        for j in range(len(starts)):
            ox, oy = px + c * starts[j, 0] - s * starts[j, 1], py + s * starts[j, 0] + c * starts[j, 1]
            ux = c * directions[j, 0] - s * directions[j, 1]
            uy = s * directions[j, 0] + c * directions[j, 1]
            at = 0.0
            while at < range_max:
                gx, gy = (ox + ux * at) * per_metre, (oy + uy * at) * per_metre
                if gx < 0.0 or gy < 0.0 or gx >= cols or gy >= rows:
                    break
                col, row = int(gx), int(gy)
                d = distance[row, col]
                if d < 0.5 * cell:
                    reached = ((col + 0.5) * cell - ox) * ux + ((row + 0.5) * cell - oy) * uy
                    out[i, j] = min(max(reached, 0.0), range_max)
                    break
                # The nearest centre is at least this far from here, wherever in the cell we are.
                at += max(d - 0.75 * cell, 0.25 * cell)
    return out
