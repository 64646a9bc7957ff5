"""The lidar's noise model: range errors per unit, per turn and per beam, and lost beams."""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

from turtlebag.datasets.kernels import njit
from turtlebag.datasets.se2 import Array
from turtlebag.sim.robots import LidarErrors

LIMIT = 3.0
"""Errors per unit and per turn are clipped at this many standard deviations, the data sheet's tolerance."""


class LidarUnit:
    """One lidar with its errors: what a unit is off by is drawn here, what a turn is off by with `turn`."""

    def __init__(self, errors: LidarErrors, rng: np.random.Generator) -> None:
        self._errors, self._rng = errors, rng
        self._offset = errors.known_offset + errors.offset * self._draw()
        self._scale = errors.scale * self._draw()
        self._square = errors.known_square + errors.square * self._draw()
        self._speed = errors.speed * self._draw()
        self._turn_scale = 0.0
        self.delay_s = 0.0
        """How much later than its first beam the turn under way will be stamped [s]."""

    def turn(self) -> float:
        """Draw the errors of the next turn of the head; returns its share of the nominal time."""
        errors = self._errors
        jitter = errors.jitter * self._draw()
        self._turn_scale = errors.turn_scale * self._draw()
        self.delay_s = float(self._rng.uniform(*errors.stamp_delay))
        return 1.0 / (1.0 + self._speed + jitter)

    def directions(self, angles: Array) -> Array:
        """Where the beams (n,) really point, for the angles the scan will state [rad]."""
        aside = np.deg2rad(self._errors.angle_deg) * self._rng.standard_normal(len(angles))
        return np.asarray(angles + aside)

    def ranges(self, true: Array) -> Array:
        """Readings (n,) of true distances [m], in whole steps of the resolution; +inf stays."""
        errors, met = self._errors, np.isfinite(true)
        r: Array = np.where(met, true, 0.0)
        white = np.hypot(errors.sigma, errors.sigma_square * r**2) * self._rng.standard_normal(len(r))
        read = r + self._offset + (self._scale + self._turn_scale) * r + self._square * r**2 + white
        if errors.resolution > 0.0:
            read = np.round(read / errors.resolution) * errors.resolution
        return np.asarray(np.where(met, read, np.inf))

    def comes_back(self, cosine: Array) -> NDArray[np.bool_]:
        """Which beams (n,) come back from surfaces they meet at these cosines of the angle to the normal."""
        errors = self._errors
        chance = np.full(len(cosine), 1.0 - errors.lost)
        if errors.grazing > 0.0:
            chance *= 1.0 - np.exp(-cosine / errors.grazing)
        return np.asarray(self._rng.random(len(cosine)) < chance)

    def _draw(self) -> float:
        return float(np.clip(self._rng.standard_normal(), -LIMIT, LIMIT))


@njit(cache=True)
def incidence(
    origins: Array,
    directions: Array,
    ranges: Array,
    hits: NDArray[np.int64],
    segments: Array,
    circles: Array,
) -> Array:
    """Cosine between each beam and the normal of the outline it hit, (n,); 1 where it hit none of them.

    origins and unit directions (n, 2), ranges (n,) [m] and hits (n,) as `raycast.cast` returns them for
    segments (s, 4) and circles (c, 3).
    """
    cosine = np.ones(len(hits))
    for i in range(len(hits)):
        dx, dy, k = directions[i, 0], directions[i, 1], hits[i]
        if 0 <= k < len(segments):
            ex, ey = segments[k, 2] - segments[k, 0], segments[k, 3] - segments[k, 1]
            cosine[i] = abs(dx * ey - dy * ex) / math.hypot(ex, ey)
        elif k >= 0:
            j = k - len(segments)
            cx, cy, radius = circles[j, 0], circles[j, 1], circles[j, 2]
            x, y = origins[i, 0] + ranges[i] * dx - cx, origins[i, 1] + ranges[i] * dy - cy
            cosine[i] = abs(x * dx + y * dy) / radius
    return cosine
