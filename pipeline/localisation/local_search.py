"""Local search: the pose nearby where scans agree best with the map, in ever finer steps."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from turtlebag.datasets.se2 import Array

# The coarsest step [m, m, rad] is halved this many times.
STEP, HALVINGS = np.array([0.08, 0.08, 0.05]), 2
# A pose and its neighbours a step away, (27, 3).
NEIGHBOURS = np.indices((3, 3, 3)).reshape(3, -1).T - 1.0


def climb(value: Callable[[Array], Array], pose: Array) -> tuple[float, Array]:
    """The highest value near a pose (3,), and its pose; `value` gives that of poses (n, 3), (n,)."""
    best = float(value(pose[None])[0])
    for halved in range(HALVINGS + 1):
        rises = True
        while rises:
            poses = pose + NEIGHBOURS * STEP / 2**halved
            values = value(poses)
            rises = values.max() > best + 1e-9
            if rises:
                best, pose = float(values.max()), poses[values.argmax()]
    return best, pose
