"""Finding a place without any guess: the whole map is searched, over all headings.

The correlation of Olson (2009) over every translation at once is a convolution, so it costs one FFT a
heading. The best distinct peaks are aligned point to line, and the one that explains the scans best
wins - when no other comes near it.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import scipy
from numpy.typing import NDArray

from turtlebag.datasets.se2 import SE2, Array, between
from turtlebag.pipeline.slam.align import FINE_GATE_M, NEIGHBOURS, ROUGH_GATE_M, align
from turtlebag.pipeline.slam.clouds import Clouds
from turtlebag.pipeline.slam.correlative import best_pose, make_field, points_in_map
from turtlebag.pipeline.slam.course import FIELD_KEYS, FIELD_M
from turtlebag.pipeline.slam.submaps import HEADINGS
from turtlebag.pipeline.slam.track import AGREE, AGREE_M

# Cells of the coarse field, and its blur [m].
RESOLUTION_M = 0.2
# So many of the best poses are looked at, this far apart or turned [m], [rad].
PEAKS, PEAK_APART = 6, 0.3
# Share of the scans that a place must explain, and by how much more than any other.
MIN_OVERLAP, RIVAL_OVERLAP = 0.8, 0.08
# Fewer points than this find no place.
LEAST_POINTS = 30


@dataclass(frozen=True, eq=False)
class Place:
    """A pose found in the map, (3,), the share of the scans it explains, and that of the next best."""

    T_map_query: Array
    overlap: float
    rival: float

    @property
    def certain(self) -> bool:
        """Explained well, and by this place only."""
        return self.overlap >= MIN_OVERLAP and self.overlap - self.rival >= RIVAL_OVERLAP


def find_place(
    clouds: Clouds,
    map_keys: NDArray[np.int64],
    T_map_keys: Array,
    query: NDArray[np.int64],
    T_query: Array,
) -> Place | None:
    """Where the scans `query` at poses (q, 3) in a frame of their own lie in the map of `map_keys`.

    The pose found is that of the query's frame in the map; None when the map or the query is empty.
    """
    # seen from the middle of the query, so that the turn tried is about where the points are
    T_query_middle = SE2(T_query[len(query) // 2])
    T_query = (T_query_middle.inverse() @ SE2(T_query)).xyt
    points = points_in_map(clouds.points, clouds.starts, query, T_query)
    seen = int((clouds.starts[map_keys + 1] - clouds.starts[map_keys]).sum())
    if min(len(points), seen) < LEAST_POINTS:
        return None
    found: list[tuple[float, Array]] = []
    for start in _peaks(clouds, map_keys, T_map_keys, points):
        pose, overlap = _settle(clouds, map_keys, T_map_keys, query, T_query, start, points)
        if all(np.hypot(*between(other, pose)[:2]) > AGREE_M for _, other in found):
            found.append((overlap, pose))
    if not found:
        return None
    found.sort(key=lambda pair: -pair[0])
    T_map_query = (SE2(found[0][1]) @ T_query_middle.inverse()).xyt
    return Place(T_map_query, found[0][0], found[1][0] if len(found) > 1 else 0.0)


def agreed_place(places: list[Place]) -> Array | None:
    """The pose (3,) that at least two certain places agree on, or None."""
    certain = [place for place in places if place.certain]
    for k, a in enumerate(certain):
        for b in certain[k + 1 :]:
            apart = between(a.T_map_query, b.T_map_query)
            if np.hypot(apart[0], apart[1]) < AGREE_M and abs(apart[2]) < AGREE:
                return a.T_map_query
    return None


def _peaks(clouds: Clouds, map_keys: NDArray[np.int64], T_map_keys: Array, points: Array) -> list[Array]:
    """The best distinct poses over the whole map and all headings, by correlation on a coarse field."""
    field = make_field(clouds, map_keys, T_map_keys, RESOLUTION_M, RESOLUTION_M)
    reach = int(np.ceil(np.linalg.norm(points, axis=1).max() / RESOLUTION_M)) + 1
    rows, cols = field.values.shape
    shape = (scipy.fft.next_fast_len(rows + 2 * reach, True), scipy.fft.next_fast_len(cols + 2 * reach, True))
    spectrum = scipy.fft.rfft2(field.values.astype(np.float32), shape)
    candidates: list[tuple[float, Array]] = []
    for yaw in np.arange(HEADINGS) * (2.0 * np.pi / HEADINGS):
        cells = np.floor((SE2.from_xyt(0.0, 0.0, yaw) @ points) / RESOLUTION_M).astype(int)
        image = np.zeros(shape, dtype=np.float32)
        # each cell counts once: near walls are hit by many beams and would drown the rest
        image[cells[:, 1] % shape[0], cells[:, 0] % shape[1]] = 1.0
        hits = scipy.fft.irfft2(spectrum * np.conj(scipy.fft.rfft2(image)), shape)[:rows, :cols]
        score = hits / image.sum()
        best = np.argpartition(score.ravel(), -PEAKS)[-PEAKS:]
        for index in best.tolist():
            row, col = divmod(index, cols)
            x, y = field.corner + (np.array([col, row]) + 0.5) * RESOLUTION_M
            candidates.append((float(score[row, col]), np.array([x, y, yaw])))
    candidates.sort(key=lambda pair: -pair[0])
    chosen: list[Array] = []
    for _, pose in candidates:
        apart = [between(other, pose) for other in chosen]
        if all(np.hypot(d[0], d[1]) > PEAK_APART or abs(d[2]) > PEAK_APART for d in apart):
            chosen.append(pose)
            if len(chosen) == PEAKS:
                break
    return chosen


def _settle(
    clouds: Clouds,
    map_keys: NDArray[np.int64],
    T_map_keys: Array,
    query: NDArray[np.int64],
    T_query: Array,
    start: Array,
    points: Array,
) -> tuple[Array, float]:
    """A coarse pose of the query's frame made fine, and the mean overlap of its scans there."""
    sample = points[:: max(1, len(points) // 300)]
    near = np.argsort(np.linalg.norm(T_map_keys[:, :2] - start[:2], axis=1), kind="stable")[:FIELD_KEYS]
    field = make_field(clouds, map_keys[near], T_map_keys[near], FIELD_M, FIELD_M)
    pose, _ = best_pose(field, sample, start, 0.4, 0.06, 0.02)
    middle = len(query) // 2
    overlaps: list[float] = []
    for k in (middle, *range(len(query))):
        at = (SE2(pose) @ SE2(T_query[k])).xyt
        order = np.argsort(np.linalg.norm(T_map_keys[:, :2] - at[:2], axis=1), kind="stable")[:NEIGHBOURS]
        result = align(
            clouds, int(query[k]), at, map_keys[order], T_map_keys[order],
            gate=FINE_GATE_M if overlaps else ROUGH_GATE_M, iterations=0 if overlaps else 15,
        )  # fmt: skip
        if not overlaps:
            pose = (result.T_map_base @ SE2(T_query[k]).inverse()).xyt
        overlaps.append(result.overlap)
    return pose, float(np.mean(overlaps[1:]))
