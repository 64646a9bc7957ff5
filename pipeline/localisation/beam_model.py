"""Beam model: a measured range against the range that the map predicts (Probabilistic Robotics, 6.3).

Four causes of a reading are mixed, with ROS amcl's weights: the expected obstacle (z_hit), something
nearer (z_short), no return (z_max) and anything at all (z_rand).
"""

from __future__ import annotations

import numpy as np

from turtlebag.datasets.kernels import njit
from turtlebag.datasets.se2 import Array
from turtlebag.pipeline.localisation.beams import Beams, spread
from turtlebag.pipeline.localisation.field import DistanceField, FloatGrid
from turtlebag.pipeline.localisation.parameters import AmclConfig


class BeamModel:
    """Weighs poses by expected ranges; beams without return count as readings of range_max."""

    def __init__(self, config: AmclConfig, field: DistanceField, range_max: float) -> None:
        self._config, self._field, self._range_max = config, field, range_max
        x, y, yaw = (float(value) for value in field.T_map_corner.xyt)
        self._frame = (x, y, yaw, 1.0 / field.resolution)

    def weigh(self, poses: Array, beams: Beams) -> Array:
        """Log weights (n,) of poses (n, 3) in the map frame."""
        c = self._config
        most_silent = max(1, c.max_beams * len(beams.silent_origins) // max(1, beams.total))
        silent = spread(len(beams.silent_origins), most_silent)
        hits = spread(len(beams), c.max_beams - len(silent))
        ways = beams.points[hits] - beams.origins[hits]
        starts = np.concatenate([beams.origins[hits], beams.silent_origins[silent]])
        directions = np.concatenate([ways / beams.ranges[hits, None], beams.silent_directions[silent]])
        measured = np.concatenate([beams.ranges[hits], np.full(len(silent), self._range_max)])
        expected = expected_ranges(
            self._field.distance, self._frame, poses, starts, directions, self._range_max
        )
        p = beam_probability(measured, expected, c, self._range_max)
        if c.aggregation == "cubes":
            return np.log1p((p**3).sum(axis=1))
        return np.log(p).sum(axis=1)


def beam_probability(measured: Array, expected: Array, config: AmclConfig, range_max: float) -> Array:
    """Probability of measured ranges (m,) where (n, m) were expected; range_max means no return."""
    c = config
    p = c.z_hit * np.exp(-0.5 * ((measured - expected) / c.sigma_hit) ** 2)
    p += np.where(measured < expected, c.z_short * c.lambda_short * np.exp(-c.lambda_short * measured), 0.0)
    return p + np.where(measured >= range_max, c.z_max, c.z_rand / range_max)


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
