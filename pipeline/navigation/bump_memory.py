"""What no lidar sees: noticed when wheels turn and the sweeps stand still, backed off from, kept out of."""

from __future__ import annotations

import numpy as np

from turtlebag.datasets.se2 import SE2, Array
from turtlebag.datasets.types import RobotModel, Twist
from turtlebag.pipeline.navigation.guarded import GuardConfig, SlipWatch
from turtlebag.pipeline.navigation.sensing import Sight
from turtlebag.planners.costmap import Costmap

AHEAD_M = 0.05
"""How far before the leading edge the thing is taken to stand."""
SPACING_M = 0.02
LONGEST_S = 5.0


class Unseen:
    """Watches for slipping wheels; remembers in the map frame what must have stopped them."""

    def __init__(self, model: RobotModel, config: GuardConfig) -> None:
        self._config, self._model = config, model
        self._slip = SlipWatch(config)
        self._points: list[Array] = []
        self._start: SE2 | None = None
        self._away = 0.0
        self._until_ns = 0

    def noticed(self, sight: Sight, T_odom_base: SE2, T_map_odom: SE2, last: Twist) -> bool:
        """Whether a new sweep shows that the robot pushes against something; that is remembered."""
        if self._start is not None or not self._slip.slipping(T_odom_base, sight.hits_odom):
            return False
        ends = self._model.footprint
        edge = ends[:, 0].min() - AHEAD_M if last.v < 0.0 else ends[:, 0].max() + AHEAD_M
        ys = np.arange(ends[:, 1].min(), ends[:, 1].max() + SPACING_M, SPACING_M)
        line = np.stack([np.full(len(ys), edge), ys], axis=1)
        self._points.append(T_map_odom @ (T_odom_base @ line))
        self._start, self._away = T_odom_base, 1.0 if last.v < 0.0 else -1.0
        self._until_ns = sight.stamp_ns + round(LONGEST_S * 1e9)
        return True

    def backing_off(self, now_ns: int, T_odom_base: SE2) -> Twist | None:
        """The command that leads away from it; None when that is over."""
        if self._start is None:
            return None
        driven = float(np.linalg.norm(T_odom_base.xy - self._start.xy))
        if driven >= self._config.back_off or now_ns >= self._until_ns:
            self._start = None
            self._slip.reset()
            return None
        return Twist(self._away * self._config.back_off_v, 0.0)

    def kept_out(self, costmap: Costmap) -> Costmap:
        """The costmap with everything remembered as lethal."""
        if not self._points:
            return costmap
        lethal = np.zeros_like(costmap.lethal)
        cells = np.floor((costmap.T_grid_map @ np.concatenate(self._points)) / costmap.resolution).astype(int)
        inside = np.all((cells >= 0) & (cells < lethal.shape[::-1]), axis=1)
        lethal[cells[inside, 1], cells[inside, 0]] = True
        return costmap.with_lethal(lethal)
