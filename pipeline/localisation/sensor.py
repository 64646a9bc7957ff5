"""The sensor model: how well each particle explains a scan."""

from __future__ import annotations

import numpy as np

from turtlebag.datasets.se2 import Array
from turtlebag.pipeline.localisation.beams import Beams, spread
from turtlebag.pipeline.localisation.field import DistanceField, hit_probability, sum_over_beams
from turtlebag.pipeline.localisation.parameters import AmclConfig


class LikelihoodField:
    """End points on the likelihood field, probabilities multiplied (Probabilistic Robotics, table 6.3)."""

    def __init__(self, config: AmclConfig, field: DistanceField, range_max: float) -> None:
        self._max_beams = config.max_beams
        distance, factor = field.finer()
        p = hit_probability(distance, config.sigma_hit, config.z_hit, config.z_rand, range_max)
        self._table = np.log(p).astype(np.float32)
        # Padded by max_dist all round, the table's corner is as far from everything as outside is.
        self._outside = float(self._table.min())
        x, y, yaw = (float(value) for value in field.T_map_corner.xyt)
        self._frame = (x, y, yaw, factor / field.resolution)

    def weigh(self, poses: Array, beams: Beams) -> Array:
        """Log weights (n,) of poses (n, 3) in the map frame."""
        points = (beams.points[spread(len(beams), self._max_beams)] * self._frame[3]).astype(np.float32)
        return sum_over_beams(self._table, self._outside, self._frame, poses, points)
