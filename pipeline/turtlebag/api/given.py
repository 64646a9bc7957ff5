"""Paths and poses that are passed to `import turtlebag`."""

from __future__ import annotations

import os
from collections.abc import Sequence

import numpy as np

from turtlebag.datasets.errors import InputError
from turtlebag.datasets.se2 import SE2
from turtlebag.pipeline.stages.requests.options import pose as xyt_of

PathLike = str | os.PathLike[str]
Pose = SE2 | Sequence[float] | np.ndarray
"""x, y [m] and yaw [rad]: three numbers, or an SE2."""


def pose(value: Pose, what: str) -> SE2:
    """A pose from three numbers; InputError names `what` where they are not finite."""
    try:
        return SE2.from_xyt(*xyt_of(value))
    except ValueError as error:
        raise InputError(f"{what}: {error}") from None
