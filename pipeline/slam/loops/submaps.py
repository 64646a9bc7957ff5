"""Submaps of successive key scans, compared by appearance, without a pose.

A submap's descriptor - the distances of its surface points and the angles between their normals -
depends neither on the viewpoint nor on the heading (in the line of scan context and of surflet-pair
histograms, Wahl et al. 2003). Two submaps are correlated over all translations at once by FFT,
at the headings where their histograms of normals agree (Weiss and von Puttkamer 1995).
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import scipy
from numpy.typing import NDArray

from turtlebag.datasets.se2 import SE2, Array, wrapped
from turtlebag.pipeline.slam.scans.clouds import Clouds
from turtlebag.pipeline.slam.scans.correlative import points_in_map

# Keys on each side of a submap's middle one; keys between two middles; with fewer points on surfaces, there
# is no submap.
HALF_KEYS, STRIDE, LEAST_POINTS = 8, 6, 200
# A submap's radius [m]; cell size of its image [m], in which points are blurred by one cell.
REACH_M, RESOLUTION_M = 10.0, 0.25
# Largest shift; the width of an image is that of the submap and the shifts to both sides. [cells]
MOST_SHIFT = 24
CELLS = 2 * (round(REACH_M / RESOLUTION_M) + MOST_SHIFT)
# Bins of the normals' directions, 3 degrees each, and number of peaks of their correlation that are tried.
HEADINGS = 120
HEADING_PEAKS = 4
# The signature is made of this many points, paired, in bins of distance (this many, of this size [m]) and of
# angle.
PAIR_SAMPLE, PAIR_BINS, PAIR_BIN_M, ANGLE_BINS = 160, 24, 0.5, 6


@dataclass(frozen=True, eq=False)
class Submap:
    """Successive keys about a middle one: their poses seen from it (k, 3), signature, directions of the
    normals (HEADINGS,), and the spectrum of the smoothed picture of its points."""

    middle: int
    keys: NDArray[np.int64]
    T_middle_keys: Array
    points: Array
    signature: Array
    directions: Array
    spectrum: NDArray[np.complex64]


def farthest_m() -> float:
    """How far apart submaps may be to be laid on each other [m]."""
    return MOST_SHIFT * RESOLUTION_M


def windows(n_keys: int, broken: NDArray[np.bool_]) -> dict[int, NDArray[np.int64]]:
    """The keys of each submap by its middle one, along the log; none spans a broken step."""
    ends = np.concatenate([[0], np.flatnonzero(broken) + 1, [n_keys]])
    found = {}
    for lo, hi in zip(ends[:-1].tolist(), ends[1:].tolist(), strict=True):
        for middle in range(lo + HALF_KEYS // 2, hi, STRIDE):
            found[middle] = np.arange(max(lo, middle - HALF_KEYS), min(hi, middle + HALF_KEYS + 1))
    return found


def make_submap(
    clouds: Clouds, keys: NDArray[np.int64], T_map_keys: Array, middle: int, chosen: NDArray[np.int64]
) -> Submap | None:
    """The submap of the keys `chosen` around `middle`; None if they see too little."""
    T_middle_keys = (SE2(T_map_keys[middle]).inverse() @ SE2(T_map_keys[chosen])).xyt
    points = points_in_map(clouds.points, clouds.starts, keys[chosen], T_middle_keys)
    normals = np.concatenate(
        [
            clouds.normals[clouds.starts[keys[k]] : clouds.starts[keys[k] + 1]]
            @ np.array([[np.cos(yaw), np.sin(yaw)], [-np.sin(yaw), np.cos(yaw)]])
            for k, yaw in zip(chosen, T_middle_keys[:, 2], strict=True)
        ]
    )
    near = np.linalg.norm(points, axis=1) < REACH_M
    points, normals = points[near], normals[near]
    surface = np.abs(normals).sum(axis=1) > 0.0
    if np.count_nonzero(surface) < LEAST_POINTS:
        return None
    points = _thinned(points[surface], normals[surface])
    points, normals = points[:, :2], points[:, 2:]
    bins = np.floor((np.arctan2(normals[:, 1], normals[:, 0]) + np.pi) / (2 * np.pi) * HEADINGS).astype(int)
    directions = np.bincount(bins % HEADINGS, minlength=HEADINGS).astype(float)
    return Submap(
        middle, chosen, T_middle_keys, points, signature_of(points, normals), directions, spectrum_of(points)
    )


def similarity(query: Submap, others: list[Submap]) -> Array:
    """The share of the query's signature that each of the others has, 0..1 (histogram intersection)."""
    return np.array([float(np.minimum(query.signature, other.signature).sum()) for other in others])


Pictures = dict[int, tuple[NDArray[np.complex64], np.float32]]
"""Of a submap, by heading: the conjugate spectrum of its picture, and how many cells of that are filled."""


def laid_on(query: Submap, other: Submap, pictures: Pictures) -> tuple[float, Array] | None:
    """The best pose (3,) of the query's middle seen from the other's, with its score 0..1; None if there is
    none.

    `pictures` keeps those of the query for the next other submap.
    """
    inner = query.points[np.linalg.norm(query.points, axis=1) < REACH_M - 2.0]
    headings = likely_turns(query.directions, other.directions)
    if len(inner) == 0 or not headings:
        return None
    if new := [heading for heading in headings if heading not in pictures]:
        pictures.update(_pictures(inner, new))
    # all headings in one transform, because calls cost more than the work
    products = other.spectrum * np.stack([pictures[heading][0] for heading in headings])
    filled = np.array([pictures[heading][1] for heading in headings])
    scores = _windows(scipy.fft.irfft2(products, (CELLS, CELLS)) / filled[:, None, None])
    heading, row, col = np.unravel_index(int(np.argmax(scores)), scores.shape)
    shift = (np.array([col, row]) - MOST_SHIFT) * RESOLUTION_M
    return float(scores[heading, row, col]), np.array([*shift, wrapped(_yaws(headings)[heading])])


def _pictures(points: Array, headings: list[int]) -> Pictures:
    cells = _cells(SE2.from_xyt(0.0, 0.0, _yaws(headings)[:, None]) @ points) % CELLS
    images = np.zeros((len(headings), CELLS, CELLS), dtype=np.float32)
    images[np.arange(len(headings))[:, None], cells[..., 1], cells[..., 0]] = 1.0
    spectra = np.conj(scipy.fft.rfft2(images))
    return dict(zip(headings, zip(spectra, images.sum(axis=(1, 2)), strict=True), strict=True))


def _yaws(headings: list[int]) -> Array:
    return np.array(headings) * 2.0 * np.pi / HEADINGS


def _thinned(points: Array, normals: Array) -> Array:
    """One point and normal per cell, (n, 4); otherwise near walls, hit by many beams, would dominate."""
    _, first = np.unique(_cells(points), axis=0, return_index=True)
    return np.hstack([points[first], normals[first]])


def _cells(points: Array) -> NDArray[np.int64]:
    return np.floor(points / RESOLUTION_M).astype(np.int64)


def spectrum_of(points: Array) -> NDArray[np.complex64]:
    """Spectrum of the picture of points (n, 2): their cells, blurred by a cell."""
    image = np.zeros((CELLS, CELLS), dtype=np.float32)
    cells = _cells(points)
    for dy in (-1, 0, 1):
        for dx in (-1, 0, 1):
            weight = np.float32(np.exp(-0.5 * (dx * dx + dy * dy)))
            row, col = (cells[:, 1] + dy) % CELLS, (cells[:, 0] + dx) % CELLS
            image[row, col] = np.maximum(image[row, col], weight)
    return np.asarray(scipy.fft.rfft2(image))


def signature_of(points: Array, normals: Array) -> Array:
    """Histogram over pairs of points: distance, and angle between the normals; sums to one."""
    stride = max(1, len(points) // PAIR_SAMPLE)
    p, n = points[::stride], normals[::stride]
    i, j = np.triu_indices(len(p), 1)
    distance = np.linalg.norm(p[i] - p[j], axis=1)
    angle = np.arccos(np.clip((n[i] * n[j]).sum(axis=1), -1.0, 1.0))
    a = np.minimum((angle / np.pi * ANGLE_BINS).astype(int), ANGLE_BINS - 1)
    d = np.minimum((distance / PAIR_BIN_M).astype(int), PAIR_BINS - 1)
    counts = np.bincount(d * ANGLE_BINS + a, minlength=PAIR_BINS * ANGLE_BINS).astype(float)
    return np.asarray(counts / max(counts.sum(), 1.0))


def likely_turns(query: Array, other: Array) -> list[int]:
    """Turns of the query (in bins) at which the histograms of normals agree best, and their neighbours."""
    match = scipy.fft.irfft(scipy.fft.rfft(other) * np.conj(scipy.fft.rfft(query)), HEADINGS)
    smooth = match + 0.5 * (np.roll(match, 1) + np.roll(match, -1))
    peaks = np.flatnonzero((smooth >= np.roll(smooth, 1)) & (smooth > np.roll(smooth, -1)))
    peaks = peaks[np.argsort(-smooth[peaks], kind="stable")][:HEADING_PEAKS]
    return sorted({int(p + d) % HEADINGS for p in peaks for d in (-1, 0, 1)})


def _windows(scores: NDArray[np.float32]) -> NDArray[np.float32]:
    """The considered shifts of correlations (n, CELLS, CELLS), no shift in the middle."""
    size = 2 * MOST_SHIFT + 1
    return np.asarray(np.roll(scores, (MOST_SHIFT, MOST_SHIFT), (1, 2))[:, :size, :size])
