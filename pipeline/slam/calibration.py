"""What the scans teach about the odometry: its systematic errors, learnt where scans see everything.

In a bare corridor odometry alone measures the way along it, and a wheel radius wrong by 1 % is 20 cm
on 20 m. Where the scans do see all directions (rooms, corners) they measure that error; corrected
odometry then carries through the blind stretches (Censi et al. 2013 calibrate from the same evidence).
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from datasets.se2 import Array, wrap

PRIOR_SCALE, PRIOR_TURN_SCALE, PRIOR_TURN_PER_M = 0.03, 0.03, 0.02
NOISE_M, NOISE_RAD = 0.01, 0.008
LIMIT = 0.2


@dataclass(frozen=True)
class Calibration:
    """Corrected step = (scale * x, scale * y, turn_scale * yaw + turn_per_m * distance)."""

    scale: float = 1.0
    turn_scale: float = 1.0
    turn_per_m: float = 0.0

    def corrected(self, steps: Array) -> Array:
        """Odometry steps (..., 3) with the systematic error taken out."""
        out = np.array(steps, dtype=np.float64)
        out[..., :2] *= self.scale
        # signed by the direction driven: backing up undoes what driving forward did
        out[..., 2] = self.turn_scale * steps[..., 2] + self.turn_per_m * steps[..., 0]
        return out


def calibrate(odometry: Array, matched: Array, trusted: NDArray[np.bool_]) -> Calibration:
    """Fit to steps (n, 3) of odometry and of scan matching; only `trusted` steps (n,) count.

    Ridge regression towards a perfect odometry, reweighted (Cauchy) so that stretches where the
    odometry lies do not bend the fit.
    """
    use = trusted & (np.hypot(odometry[:, 0], odometry[:, 1]) + np.abs(odometry[:, 2]) > 0.02)
    o, m = odometry[use], matched[use]
    if len(o) == 0:
        return Calibration()
    scale = _fit(o[:, :1], m[:, 0], np.array([1.0]), np.array([PRIOR_SCALE]), NOISE_M)
    turn = _fit(
        np.stack([o[:, 2], o[:, 0]], axis=1),
        # the turn itself is small between key scans, its difference to odometry smaller still
        o[:, 2] + wrap(m[:, 2] - o[:, 2]),
        np.array([1.0, 0.0]),
        np.array([PRIOR_TURN_SCALE, PRIOR_TURN_PER_M]),
        NOISE_RAD,
    )
    return Calibration(
        float(np.clip(scale[0], 1.0 - LIMIT, 1.0 + LIMIT)),
        float(np.clip(turn[0], 1.0 - LIMIT, 1.0 + LIMIT)),
        float(np.clip(turn[1], -LIMIT, LIMIT)),
    )


def _fit(a: Array, b: Array, prior: Array, prior_sigma: Array, noise: float) -> Array:
    ridge = np.diag(prior_sigma**-2)
    x: Array = prior
    for _ in range(8):
        residual = (b - a @ x) / noise
        w = 1.0 / (1.0 + (residual / 2.0) ** 2) / noise**2
        x = np.linalg.solve(a.T @ (w[:, None] * a) + ridge, a.T @ (w * b) + ridge @ prior)  # type: ignore[assignment]
    return x
