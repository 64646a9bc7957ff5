"""Bringing a pose to where scans agree best with the map near by: a search over ever finer steps."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from turtlebag.datasets.se2 import Array

# Steps [m, rad], from coarse to fine, and how many of each at most.
STEPS = ((0.08, 0.06), (0.04, 0.03), (0.02, 0.012))
MOST_STEPS = 6
# A pose and its neighbours a step away, (27, 3).
NEIGHBOURS = np.indices((3, 3, 3)).reshape(3, -1).T - 1.0


def climb(value: Callable[[Array], Array], pose: Array) -> tuple[float, Array]:
    """The highest value found near a pose (3,), and where; `value` gives that of poses (n, 3), (n,)."""
    best = float(value(pose[None])[0])
    for step_xy, step_yaw in STEPS:
        for _ in range(MOST_STEPS):
            poses = pose + NEIGHBOURS * (step_xy, step_xy, step_yaw)
            values = value(poses)
            if values.max() <= best + 1e-9:
                break
            best, pose = float(values.max()), poses[values.argmax()]
    return best, pose
