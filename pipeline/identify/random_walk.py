"""Differences of something that wanders, seen through noise: how much there is of each, by likelihood."""

from __future__ import annotations

import numpy as np
import scipy
from numpy.typing import NDArray

from turtlebag.datasets.robust import sigma_by_median
from turtlebag.datasets.se2 import Array

# Evaluations of the likelihood; steps of the logarithms by which its curvature is taken.
ROUNDS, STEP = 120, 0.1


class RandomWalk:
    """Differences y (n,) of successive readings of a random walk, less what a design (n, p) explains.

    Each reading has white noise, so successive differences share it: a covariance with two bands. The walk
    is the sum of `sources` (n, s), and the noise of `readings` (n + 1, r), times a variance each, of which
    `logs` (s + r,) are the logarithms. Differences that are not `good` (n,) say nothing.
    """

    def __init__(
        self, y: Array, design: Array, sources: Array, readings: Array, good: NDArray[np.bool_]
    ) -> None:
        self.y, self.design, self.sources, self.readings = y, design, sources, readings
        rest = y - design @ np.linalg.lstsq(design[good], y[good], rcond=None)[0]
        scale = max(float(sigma_by_median(rest[good])), 1e-6) ** 2
        self._least = np.where(good, 1e-6 * scale, 1e6 * scale + y**2)
        means = np.concatenate([sources.mean(axis=0), readings.mean(axis=0)])
        start = np.log(0.3 * scale / np.maximum(means, 1e-3))
        options = {"maxiter": ROUNDS * len(start)}
        self.logs = np.asarray(
            scipy.optimize.minimize(self._cost, start, method="Nelder-Mead", options=options).x
        )

    def _products(self, logs: Array) -> tuple[Array, float]:
        """[X y]' C^-1 [X y], (p + 1, p + 1), and the logarithm of the covariance's determinant."""
        variances = np.exp(np.clip(logs, -60.0, 10.0))
        s = self.sources.shape[1]
        bands, noise = np.zeros((2, len(self.y))), self.readings @ variances[s:]
        bands[1] = self.sources @ variances[:s] + noise[:-1] + noise[1:] + self._least
        bands[0, 1:] = -noise[1:-1]
        factor = scipy.linalg.cholesky_banded(bands)
        both = np.column_stack([self.design, self.y])
        return both.T @ scipy.linalg.cho_solve_banded((factor, False), both), 2.0 * float(
            np.log(factor[1]).sum()
        )

    def _cost(self, logs: Array) -> float:
        """Minus the logarithm of the restricted likelihood (Patterson and Thompson 1971)."""
        products, determinant = self._products(logs)
        p = len(products) - 1
        h, g = products[:p, :p] + 1e-9 * np.eye(p), products[:p, p]
        left = products[p, p] - g @ np.linalg.solve(h, g)
        return 0.5 * float(determinant + left + np.linalg.slogdet(h)[1])

    def coefficients(self) -> tuple[Array, Array]:
        """Those of the design (p,), and their covariance."""
        products, _ = self._products(self.logs)
        p = len(products) - 1
        covariance = np.linalg.inv(products[:p, :p] + 1e-9 * np.eye(p))
        return np.asarray(covariance @ products[:p, p]), np.asarray(covariance, dtype=np.float64)

    def deviations(self) -> Array:
        """Standard deviations of the logarithms, (s + r,), by the curvature of the likelihood."""
        n = len(self.logs)
        ends = STEP * np.eye(n)
        curvature = np.array([[
            sum(a * b * self._cost(self.logs + a * ends[i] + b * ends[j]) for a in (1, -1) for b in (1, -1))
            for j in range(n)] for i in range(n)
        ]) / (4.0 * STEP**2)  # fmt: skip
        values, vectors = np.linalg.eigh(curvature)
        return np.sqrt(np.diag(vectors @ np.diag(1.0 / np.maximum(values, 1e-3)) @ vectors.T))
