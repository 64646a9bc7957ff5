"""Plain odometry as front end: all corrections are left to loops and refinement."""

from __future__ import annotations

import numpy as np

from turtlebag.datasets.se2 import Array, compose
from turtlebag.pipeline.slam.odometry.front_end import Placed, TrackedLog


class Wheels:
    """Places every scan by the calibrated odometry, which it needs."""

    def __init__(self, tracker: TrackedLog) -> None:
        self._tracker = tracker

    def step(self, points: Array, odometry_step: Array | None, wait_s: float) -> Placed:
        """As in `FrontEnd`; without information from the scan."""
        del wait_s
        assert odometry_step is not None
        pose = compose(self._tracker.pose, odometry_step)
        return Placed(pose, np.zeros((3, 3)), self._tracker.fit(points, pose))
