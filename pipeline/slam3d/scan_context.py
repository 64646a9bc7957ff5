"""Scan context: a descriptor of a place seen from above, independent of the heading.

Kim and Kim (2018), "Scan Context: Egocentric Spatial Descriptor for Place Recognition": the greatest
height in each ring and sector around the sensor; the rings' means find candidates (they do not turn with
the robot), and the sectors compare them at their best shift.
"""

from __future__ import annotations

import numpy as np
import scipy
from numpy.typing import NDArray

from turtlebag.datasets.se2 import Array

RINGS, SECTORS = 20, 60
FLOOR_M = -0.5
"""Heights count from here, so that the floor differs from nothing seen."""


def descriptor(points: Array, reach: float) -> Array:
    """Greatest height over FLOOR_M of points (n, 3) by ring and sector, (RINGS, SECTORS) [m]."""
    distance = np.hypot(points[:, 0], points[:, 1])
    inside = distance < reach
    ring = (distance[inside] / reach * RINGS).astype(np.int64)
    turn = np.arctan2(points[inside, 1], points[inside, 0]) / (2.0 * np.pi) % 1.0
    sector = np.minimum((turn * SECTORS).astype(np.int64), SECTORS - 1)
    out = np.zeros(RINGS * SECTORS)
    np.maximum.at(out, ring * SECTORS + sector, points[inside, 2] - FLOOR_M)
    return out.reshape(RINGS, SECTORS)


def dissimilarity(a: Array, b: Array) -> float:
    """Distance 0..1 of two descriptors at the best shift of their sectors.

    One minus the mean cosine between the columns that hold something in either.
    """
    norm_a, norm_b = np.linalg.norm(a, axis=0), np.linalg.norm(b, axis=0)
    seen_a, seen_b = norm_a > 0.0, norm_b > 0.0
    # Correlation over all shifts at once: column s + k of a against column s of b.
    products = np.fft.irfft(
        np.fft.rfft(a / np.where(seen_a, norm_a, 1.0), axis=1)
        * np.conj(np.fft.rfft(b / np.where(seen_b, norm_b, 1.0), axis=1)),
        SECTORS,
        axis=1,
    ).sum(axis=0)
    either = np.array([np.count_nonzero(seen_a | np.roll(seen_b, k)) for k in range(SECTORS)])
    return float(1.0 - np.max(products / np.maximum(either, 1)))


class Contexts:
    """Descriptors of places, searched by similarity."""

    def __init__(self, descriptors: list[Array]) -> None:
        self._all = descriptors
        self._ring_keys = np.array([one.mean(axis=1) for one in descriptors]).reshape(-1, RINGS)

    def like(self, index: int, allowed: NDArray[np.int64], count: int, most: float) -> list[int]:
        """The `count` most similar of the `allowed` places, best first; none less similar than `most`."""
        tree = scipy.spatial.cKDTree(self._ring_keys[allowed])
        near = np.atleast_1d(tree.query(self._ring_keys[index], k=min(10 * count, len(allowed)))[1])
        compared = sorted((dissimilarity(self._all[k], self._all[index]), int(k)) for k in allowed[near])
        return [k for distance, k in compared[:count] if distance <= most]
