"""Where two places that look alike would not: what the map itself says that the lidar should see there."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from turtlebag.datasets.se2 import SE2, Array
from turtlebag.pipeline.localisation.field import DistanceField
from turtlebag.pipeline.localisation.ray_casting import expected_ranges

# Beams all round; so many neighbours to each side may stand in for one (edges of things, small errors of
# heading), and ranges so far from all of them [m] are clearly others.
BEAMS, NEIGHBOURS, CLEAR_M = 180, 2, 0.2


def expected_views(field: DistanceField, T_map_lidar: SE2, range_max: float) -> Array:
    """Ranges of `BEAMS` beams all round from each pose (n,), cut at `range_max`: (n, BEAMS)."""
    angle = 2.0 * np.pi * np.arange(BEAMS) / BEAMS
    directions = np.stack([np.cos(angle), np.sin(angle)], axis=1)
    x, y, yaw = (float(value) for value in field.T_map_corner.xyt)
    frame = (x, y, yaw, 1.0 / field.resolution)
    poses = np.ascontiguousarray(T_map_lidar.xyt)
    return expected_ranges(field.distance, frame, poses, np.zeros((BEAMS, 2)), directions, range_max)


def clearly_other(views: Array, others: Array) -> Array:
    """Share (n,) of beams whose range, in two sets of views (n, BEAMS), can be told apart by a lidar."""
    return np.maximum(_beyond(views, others), _beyond(others, views))


def _beyond(views: Array, others: Array) -> Array:
    """Share (n,) of `views`' beams that none of the neighbouring beams in `others` comes near."""
    about = [np.roll(others, k, axis=1) for k in range(-NEIGHBOURS, NEIGHBOURS + 1)]
    low, high = np.min(about, axis=0) - CLEAR_M, np.max(about, axis=0) + CLEAR_M
    return np.asarray(np.mean((views < low) | (views > high), axis=1))


def differences(field: DistanceField, rivals: Sequence[SE2], T_map_lidar: SE2, range_max: float) -> Array:
    """By how much the most unlike two of some rivals differ, as a share of the beams, at each pose (n,).

    `rivals` are motions of the map onto itself: the robot at one of the poses is, under a rival, at
    rival @ pose.
    """
    views = [expected_views(field, rival @ T_map_lidar, range_max) for rival in rivals]
    most = np.zeros(len(T_map_lidar))
    for i, one in enumerate(views):
        for other in views[:i]:
            most = np.maximum(most, clearly_other(one, other))
    return most
