"""Sensor models: how well each particle explains a scan."""

from __future__ import annotations

from typing import Protocol

import numpy as np

from turtlebag.datasets.se2 import Array
from turtlebag.pipeline.localisation.beam_model import BeamModel
from turtlebag.pipeline.localisation.beams import Beams, spread
from turtlebag.pipeline.localisation.field import DistanceField, hit_probability, sum_over_beams
from turtlebag.pipeline.localisation.parameters import AmclConfig


class SensorModel(Protocol):
    """Gives each pose a log weight."""

    def weigh(self, poses: Array, beams: Beams) -> Array:
        """Log weights (n,) of poses (n, 3) in the map frame."""
        ...


class LikelihoodFieldModel:
    """End points on the likelihood field; a beam's probabilities are multiplied, or cubed and summed.

    `product` is Thrun's model, table 6.3. `cubes` is what ROS amcl does: weight 1 + sum of p^3.
    """

    def __init__(self, config: AmclConfig, field: DistanceField, range_max: float) -> None:
        self._cubes = config.aggregation == "cubes"
        self._max_beams = config.max_beams
        distance, factor = field.finer()
        p = hit_probability(distance, config.sigma_hit, config.z_hit, config.z_rand, range_max)
        self._table = (p**3 if self._cubes else np.log(p)).astype(np.float32)
        # Padded by max_dist all round, the table's corner is as far from everything as outside is.
        self._outside = float(self._table.min())
        x, y, yaw = (float(value) for value in field.T_map_corner.xyt)
        self._frame = (x, y, yaw, factor / field.resolution)

    def weigh(self, poses: Array, beams: Beams) -> Array:
        """See SensorModel."""
        points = (beams.points[spread(len(beams), self._max_beams)] * self._frame[3]).astype(np.float32)
        total = sum_over_beams(self._table, self._outside, self._frame, poses, points)
        return np.log1p(total) if self._cubes else total


def make_sensor_model(config: AmclConfig, field: DistanceField, range_max: float) -> SensorModel:
    """The model the configuration names."""
    if config.laser_model_type == "beam":
        return BeamModel(config, field, range_max)
    return LikelihoodFieldModel(config, field, range_max)
